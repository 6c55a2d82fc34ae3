"""Adam against the one of torch."""

import torch
from uncle.recon.core.adam import Adam


def loss_of(parameters: list[torch.Tensor], step: int) -> torch.Tensor:
    first, second = parameters
    loss = ((first - 3) ** 2).sum() * (1 + step % 3)
    return loss + (second.abs() ** 1.5).sum() if step % 2 else loss  # the second has no gradient in every other step


def start() -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return [
        torch.randn(4, 3, generator=generator).requires_grad_(),
        torch.randn(5, generator=generator).requires_grad_(),
    ]


def moved_by(optimizer, parameters, steps, set_rate):
    for step in steps:
        for parameter in parameters:
            parameter.grad = None
        loss_of(parameters, step).backward()
        set_rate(step)
    return [parameter.detach() for parameter in parameters]


def rate(step: int) -> float:
    return 0.05 * 0.97**step


def test_goes_where_torch_goes():
    theirs, ours = start(), start()
    reference, optimizer = torch.optim.Adam(theirs), Adam(ours)

    def their_step(step):
        reference.param_groups[0]["lr"] = rate(step)
        reference.step()

    expected = moved_by(reference, theirs, range(60), their_step)
    found = moved_by(optimizer, ours, range(60), lambda step: optimizer.step(rate(step)))
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-7)
    assert (found[0] - start()[0]).abs().min() > 0.1


def test_goes_on_from_a_saved_state():
    whole, broken = start(), start()
    one, first = Adam(whole), Adam(broken)
    expected = moved_by(one, whole, range(20), lambda step: one.step(rate(step)))
    moved_by(first, broken, range(9), lambda step: first.step(rate(step)))
    second = Adam(broken)
    second.load_state_dict(first.state_dict())
    found = moved_by(second, broken, range(9, 20), lambda step: second.step(rate(step)))
    assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))


def test_forgets_gradients():
    parameters = start()
    optimizer = Adam(parameters)
    loss_of(parameters, 1).backward()
    optimizer.zero_grad()
    before = [parameter.detach().clone() for parameter in parameters]
    optimizer.step(1.0)
    assert all(torch.equal(a, b) for a, b in zip(before, parameters, strict=True))
    assert not optimizer.moments
