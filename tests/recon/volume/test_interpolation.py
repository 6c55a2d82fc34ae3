"""The quick weighted sum against PyTorch's own."""

import torch
from torch.nn.functional import embedding_bag
from uncle.recon.volume.interpolation import weighted_rows


def random_problem() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    table = torch.randn(20, 4, dtype=torch.float64, generator=generator)
    rows = torch.randint(20, (50, 8), generator=generator)  # rows repeat within and between sums
    return table, rows, torch.rand(50, 8, dtype=torch.float64, generator=generator)


def test_values_and_gradients_agree_with_embedding_bag():
    table, rows, weights = random_problem()
    ours, theirs = table.clone().requires_grad_(), table.clone().requires_grad_()
    found = weighted_rows(ours, rows, weights)
    expected = embedding_bag(rows, theirs, mode="sum", per_sample_weights=weights)
    torch.testing.assert_close(found, expected)
    (found**2).sum().backward()
    (expected**2).sum().backward()
    torch.testing.assert_close(ours.grad, theirs.grad)


def test_gradient_by_finite_differences():
    table, rows, weights = random_problem()
    assert torch.autograd.gradcheck(lambda t: weighted_rows(t, rows, weights).sin(), table.requires_grad_())


def test_nothing_to_sum():
    table, rows, weights = random_problem()
    table.requires_grad_()
    weighted_rows(table, rows[:0], weights[:0]).sum().backward()
    assert (table.grad == 0).all()
