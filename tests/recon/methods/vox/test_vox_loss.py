"""Rendering and loss against a slow implementation: one ray and one sample at a time."""

import math

import pytest
import torch
from torch import Tensor
from uncle.recon.methods.vox import rendering
from uncle.recon.methods.vox.losses import Counts, Targets, vox_loss, without_outliers
from uncle.recon.methods.vox.rendering import bell_weights, render

T = 0.05


def slow_weights(sdf: list[Tensor], z: list[float]) -> list[Tensor]:
    """The weights of one ray."""
    bell = [1 / (1 + torch.exp(-s / T)) * 1 / (1 + torch.exp(s / T)) for s in sdf]
    change = next((i for i in range(len(sdf) - 1) if sdf[i] * sdf[i + 1] < 0), None)
    if change is not None:
        bell = [b if z[i] < z[change] + T else 0 * b for i, b in enumerate(bell)]
    return [b / sum(bell) for b in bell]


def slow_sample(scene, point: Tensor, voxel: int) -> tuple[Tensor, Tensor]:
    """Distance and colour at one place, written out."""
    model, place = scene.model, point / 0.2
    embedding = 0
    for row in model.voxels.corner_rows[voxel].tolist():
        gap = (place - model.voxels.corners.blocks[row]).abs()
        embedding = embedding + (1 - gap).prod() * model.embeddings[row]
    d = model.decoder
    hidden = torch.relu(d.second.weight @ torch.relu(d.first.weight @ embedding + d.first.bias) + d.second.bias)
    out = d.out.weight @ hidden + d.out.bias
    color = d.color_out.weight @ torch.relu(d.color_first.weight @ out[1:] + d.color_first.bias) + d.color_out.bias
    return out[0], 1 / (1 + torch.exp(-color))


def slow_loss(scene) -> Tensor:
    """The loss of all rays, one by one, by the formulas of docs/baselines.md."""
    color, depth, free, near = [], [], [], []
    for ray in range(len(scene.origins)):
        columns = scene.samples.there[ray].nonzero()[:, 0].tolist()
        if not columns:
            continue
        z = [float(scene.samples.z[ray, c]) for c in columns]
        found = [
            slow_sample(scene, scene.origins[ray] + scene.directions[ray] * at, int(scene.samples.voxels[ray, c]))
            for at, c in zip(z, columns, strict=True)
        ]
        weights = slow_weights([s for s, _ in found], z)
        image = sum(w * rgb for w, (_, rgb) in zip(weights, found, strict=True))
        rendered = sum(w * at for w, at in zip(weights, z, strict=True))
        color += [*(image - scene.targets.colors[ray]).abs()]
        for reading in scene.targets.depths[ray].tolist():
            if reading == 0:
                continue
            depth.append((rendered - reading).abs())
            free += [(s - 1) ** 2 for (s, _), at in zip(found, z, strict=True) if at < reading - T]
            near += [(at + T * s - reading) ** 2 for (s, _), at in zip(found, z, strict=True) if abs(at - reading) <= T]
    pairs = len(free) + len(near)
    assert min(len(free), len(near)) > 100
    mean = {name: sum(v) / len(v) for name, v in (("color", color), ("depth", depth))}
    shares = 10 * sum(free) / pairs * len(near) / pairs + 5000 * sum(near) / pairs * len(free) / pairs
    return 0.5 * mean["color"] + mean["depth"] + shares


def fast_loss(scene) -> Tensor:
    rendered = render(scene.model, scene.points(), scene.samples)
    counts = Counts.of(scene.samples, scene.targets, T)
    return vox_loss(rendered, scene.samples, scene.targets, counts, scene.model.config)


def test_loss_and_gradients_are_those_of_the_slow_implementation(wall, monkeypatch):
    monkeypatch.setattr(rendering, "MIN_COLOR_WEIGHT", 0.0)
    learned = [wall.model.embeddings, *wall.model.decoder.parameters()]
    slow, fast = slow_loss(wall), fast_loss(wall)
    assert float(slow.detach()) > 1
    torch.testing.assert_close(fast, slow)
    expected, found = torch.autograd.grad(slow, learned), torch.autograd.grad(fast, learned)
    for a, b in zip(found, expected, strict=True):
        assert b.abs().max() > 0
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-8)


def test_colours_that_nobody_sees_are_not_missed(wall):
    """The samples left out of the colour head change what is rendered by less than they weigh."""
    whole = slow_loss(wall)
    assert float(fast_loss(wall).detach()) == pytest.approx(float(whole.detach()), abs=1e-3)


def test_parts_of_a_batch_sum_to_its_loss(wall):
    counts = Counts.of(wall.samples, wall.targets, T)
    total = torch.zeros((), dtype=torch.float64)
    for first in range(0, 40, 16):
        part = wall.samples.of_rays(first, first + 16)
        ray, z, _ = part.packed()
        points = wall.origins[first : first + 16][ray] + wall.directions[first : first + 16][ray] * z[:, None]
        targets = wall.targets[first : first + 16]
        total += vox_loss(render(wall.model, points, part), part, targets, counts, wall.model.config)
    torch.testing.assert_close(total, fast_loss(wall))


def test_sensors_weigh_alike(wall):
    """Two sensors, the same readings in another order: the same loss."""
    before = fast_loss(wall)
    t = wall.targets
    wall.targets = Targets(t.colors, t.depths.flip(1), t.valid.flip(1))
    torch.testing.assert_close(fast_loss(wall), before)


def test_a_plane_is_rendered_where_it_is_and_what_is_behind_is_cut():
    z = torch.arange(0.9, 1.3, 0.01, dtype=torch.float64).expand(2, -1)
    sdf = (1.0 - z) / T
    sdf = torch.where(z > 1.15, 0.0 * z, sdf)  # another surface 15 cm behind the first
    weights = bell_weights(sdf, z, torch.ones_like(z, dtype=torch.bool), T)
    torch.testing.assert_close(weights.sum(1), torch.ones(2, dtype=torch.float64))
    assert not weights[z > 1.06].any()
    assert float((weights[0] * z[0]).sum()) == pytest.approx(1.0, abs=2e-3)
    peak = weights[0].max() / weights[0][(z[0] - 0.98).abs().argmin()]
    assert float(peak) == pytest.approx(0.25 * (2 + math.exp(8) + math.exp(-8)), rel=0.02)  # s = 0.4: s / t = 8


def test_a_ray_without_a_surface_is_not_cut():
    z = torch.tensor([[1.0, 1.1, 1.2]])
    there = torch.tensor([[True, True, False]])
    weights = bell_weights(torch.full((1, 3), 0.02), z, there, T)
    torch.testing.assert_close(weights, torch.tensor([[0.5, 0.5, 0.0]]))


def test_readings_far_from_what_is_rendered_are_left_out():
    depths = torch.tensor([[1.0, 1.02], [1.01, 1.5], [1.03, 0.0]])
    targets = Targets(torch.zeros(3, 3), depths, depths > 0)
    kept = without_outliers(targets, torch.ones(3), 10.0)  # errors 0, 2, 1, 50, 3 cm: the median is 2
    assert kept.valid.tolist() == [[True, True], [True, False], [True, False]]
