"""The decoder network against its formula, written out with numbers; gradients; counts."""

import numpy as np
import pytest
import torch
from uncle.recon.methods.nice.decoders import color_decoder, fine_decoder, middle_decoder, random_decoders


@pytest.mark.parametrize(
    ("make", "parameters"), [(middle_decoder, 15_800), (fine_decoder, 20_920), (color_decoder, 15_899)]
)
def test_parameter_counts(make, parameters):
    assert sum(value.numel() for value in make().parameters()) == parameters


@pytest.mark.parametrize("make", [middle_decoder, fine_decoder, color_decoder])
def test_values_follow_the_formula(make):
    decoder = make(torch.Generator().manual_seed(1))
    generator = torch.Generator().manual_seed(2)
    points, features = torch.randn(3, 3, generator=generator), torch.randn(3, decoder.features, generator=generator)
    weights = {key: value.double().numpy() for key, value in decoder.state_dict().items()}
    for point, feature, value in zip(points, features, decoder(points, features), strict=True):
        p, c = point.double().numpy(), feature.double().numpy()
        e = np.sin([p @ weights["embedding"][:, k] for k in range(93)])
        h = e
        for i in range(5):
            if i == 3:
                h = np.concatenate([e, h])
            h = np.maximum(weights[f"hidden.{i}.weight"] @ h + weights[f"hidden.{i}.bias"], 0)
            h = h + weights[f"injection.{i}.weight"] @ c + weights[f"injection.{i}.bias"]
        expected = weights["output.weight"] @ h + weights["output.bias"]
        np.testing.assert_allclose(value.detach().numpy(), expected, rtol=1e-4, atol=1e-4)


def test_the_embedding_is_as_wide_as_stated():
    scale = middle_decoder(torch.Generator().manual_seed(0)).embedding.std()
    assert scale.item() == pytest.approx(25.0, rel=0.1)


def test_a_seed_fixes_the_weights():
    first, again, other = (random_decoders(seed).fine.embedding for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_the_fine_logit_is_a_residual_that_leaves_the_middle_features_alone():
    decoders = random_decoders(0)
    points, middle, fine = torch.rand(5, 3), torch.rand(5, 32, requires_grad=True), torch.rand(5, 32)
    residual = decoders.fine(points, torch.cat([fine, middle], dim=-1))[:, 0]
    coarse = decoders.logits(points, middle)
    torch.testing.assert_close(decoders.logits(points, middle, fine), coarse + residual)
    (alone,) = torch.autograd.grad(coarse.sum(), middle)
    (together,) = torch.autograd.grad(decoders.logits(points, middle, fine).sum(), middle)
    assert alone.abs().sum() > 0
    torch.testing.assert_close(together, alone)


def test_frozen_decoders_ask_for_no_gradient():
    decoders = random_decoders(0).frozen()
    assert not any(p.requires_grad for network in (decoders.middle, decoders.fine) for p in network.parameters())
