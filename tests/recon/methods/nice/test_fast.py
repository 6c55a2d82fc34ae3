"""The quick paths against plain PyTorch: grid_sample over dense volumes, every sample, autograd through everything."""

import numpy as np
import pytest
import torch
from torch.nn.functional import grid_sample
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.nice import NiceConfig, NiceTrackingConfig
from uncle.recon.methods.nice import fast, kernels
from uncle.recon.methods.nice.decoders import color_decoder, fine_decoder, middle_decoder
from uncle.recon.methods.nice.fast import FastEvaluate
from uncle.recon.methods.nice.frozen import FrozenDecoder
from uncle.recon.methods.nice.objective import mapping_loss, render_rays, tracking_loss
from uncle.recon.methods.nice.poses import to_pose_matrix
from uncle.recon.methods.nice.rays import render_depth
from uncle.recon.methods.nice.scene import GridScene
from uncle.recon.methods.nice.views import Rays
from uncle.recon.methods.nice.weighting import LaplaceWeighting, UniformWeighting
from uncle.recon.methods.nice.workers import Workers

CPU = torch.device("cpu")
STAGES = ("middle", "fine", "color")


def make_scene(loudness: float = 0.7) -> GridScene:
    """Random features that make some rays end at once and others never."""
    bound = torch.tensor([[-2.0, -2.0, -1.0], [2.0, 2.0, 2.0]])
    scene = GridScene(bound, NiceConfig(decoders="random"), torch.Generator().manual_seed(0), CPU)
    generator = torch.Generator().manual_seed(1)
    for grid in scene.grids.values():
        grid.table = torch.randn(grid.table.shape, generator=generator) * loudness
    scene.unfreeze()
    return scene


def plain_values(scene: GridScene, points: torch.Tensor, stage: str):
    """The oracle: what the published code computes, with its layout of the volumes."""
    low, high = scene.bound
    flat = points.reshape(-1, 3)
    places = (2 * (flat - low) / (high - low) - 1)[None, None, None]

    def read(name: str) -> torch.Tensor:
        grid = scene.grids[name]
        volume = grid.table.view(1, *grid.shape, 32).permute(0, 4, 3, 2, 1)
        return grid_sample(volume, places, padding_mode="border", align_corners=True)[0, :, 0, 0].T

    middle = read("middle")
    logits = scene.decoders.middle(flat, middle)[:, 0]
    if stage != "middle":
        logits = logits + scene.decoders.fine(flat, torch.cat([read("fine"), middle.detach()], 1))[:, 0]
    outside = ((flat < low) | (flat > high)).any(1)
    logits = torch.where(outside, 100.0, logits).view(points.shape[:2])
    colors = scene.color_decoder(flat, read("color"))[:, :3].view(points.shape) if stage == "color" else None
    return fast.FieldValues(logits, colors)


def make_rays(count: int = 150) -> Rays:
    generator = torch.Generator().manual_seed(2)
    x, y, colors = (torch.rand(count, n, generator=generator) for n in (1, 1, 3))
    directions = torch.cat([x - 0.5, y - 0.5, torch.ones(count, 1)], 1)
    depths = 0.3 + 1.2 * torch.rand(count, 2, generator=generator)
    depths[::7, 0] = 0.0
    weighting_inputs, patches = (
        torch.rand(count, 2, 50, generator=generator),
        torch.rand(count, 75, generator=generator),
    )
    return Rays(torch.arange(count) % 2, directions, depths, colors, lambda: weighting_inputs, lambda: patches)


SEVEN = torch.tensor([[1.0, 0.02, -0.01, 0.03, 0.1, 0.0, -0.5], [0.9, -0.1, 0.2, 0.0, 0.0, 0.2, -0.4]])


def close(ours: torch.Tensor, theirs: torch.Tensor, tolerance: float) -> None:
    assert (ours - theirs).abs().max() <= tolerance * theirs.abs().max() + 1e-7


@pytest.mark.parametrize("stage", STAGES)
def test_values_are_those_of_the_oracle(stage):
    scene, rays = make_scene(), make_rays()
    points = torch.rand(300, 20, 3, generator=torch.Generator().manual_seed(3)) * 5 - 2.5  # some beyond the box
    z = torch.linspace(0.1, 2.0, 20).expand(300, 20)
    expected = plain_values(scene, points, stage)
    plain = scene.values(points, stage)
    torch.testing.assert_close(plain.logits, expected.logits, atol=2e-4, rtol=1e-4)
    ours = FastEvaluate(scene)(points, stage)
    ends = torch.cumsum(torch.log1p(-torch.sigmoid(10 * expected.logits)), 1)
    before = torch.cat([torch.zeros(300, 1), ends[:, :-1]], 1) > np.log(fast.PRUNING.min_transmittance)
    torch.testing.assert_close(ours.logits[before], expected.logits[before], atol=2e-4, rtol=1e-4)
    seen, wanted = render_depth(ours.logits, z), render_depth(expected.logits, z)
    torch.testing.assert_close(seen.depth, wanted.depth, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(seen.variance, wanted.variance, atol=1e-4, rtol=1e-3)
    if stage == "color":
        blend = [(r.weights[..., None] * v.colors).sum(1) for r, v in ((seen, ours), (wanted, expected))]
        torch.testing.assert_close(*blend, atol=2e-3, rtol=1e-3)
    assert rays.depths.shape == (150, 2)


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("moves", [False, True])
def test_gradients_of_the_mapping_loss(stage, moves):
    scene = make_scene(0.5)
    rays = make_rays()
    weighting = LaplaceWeighting(
        scene.config, ("a", "b"), Camera(8, 6, 9.0, 9.0, 4.0, 3.0), torch.Generator().manual_seed(4), CPU
    )
    learned = [scene.grids[name].table for name in STAGES[: STAGES.index(stage) + 1]]
    learned += list(scene.color_decoder.parameters()) if stage == "color" else []
    learned += [p for net in weighting.depth_networks for p in net.parameters()] if stage != "middle" else []
    results = []
    for evaluate in (FastEvaluate(scene), scene.values, lambda p, s: plain_values(scene, p, s)):
        seven = SEVEN.clone().requires_grad_(moves)
        rendered = render_rays(rays, to_pose_matrix(seven), evaluate, scene.bound, stage, scene.config)
        loss = mapping_loss(rendered, rays, weighting, stage)
        results.append([loss.detach(), *torch.autograd.grad(loss, [*learned, *([seven] if moves else [])])])
    for ours, plain, oracle in zip(*results, strict=True):
        close(plain, oracle, 2e-4)
        close(ours, oracle, 3e-3)


@pytest.mark.parametrize("weighting", ["uniform", "laplace"])
def test_gradient_of_the_tracking_loss(weighting):
    scene, rays = make_scene(0.5), make_rays()
    scene.freeze()
    camera = Camera(8, 6, 9.0, 9.0, 4.0, 3.0)
    judge = (
        UniformWeighting(scene.config, NiceTrackingConfig()) if weighting == "uniform"
        else LaplaceWeighting(scene.config, ("a", "b"), camera, torch.Generator().manual_seed(4), CPU)
    )  # fmt: skip
    found = []
    for evaluate in (FastEvaluate(scene), lambda p, s: plain_values(scene, p, s)):
        seven = SEVEN.clone().requires_grad_()
        rendered = render_rays(rays, to_pose_matrix(seven), evaluate, scene.bound, "color", scene.config)
        found.append(torch.autograd.grad(tracking_loss(rendered, rays, judge, False), seven)[0])
    close(*found, 5e-3)


def test_what_lies_behind_a_wall_is_not_asked():
    """A solid sample ends its ray: the segments after it are not evaluated, and get no gradient."""
    scene = make_scene()
    evaluate = FastEvaluate(scene)
    points = torch.zeros(1, 40, 3)
    points[0, :, 0] = torch.linspace(0.0, 1.0, 40)
    points[0, 3] = 9.0  # outside the box is solid
    logits = evaluate(points, "fine").logits[0]
    assert (logits[:10] > -50).all()
    assert (logits[10:] == fast.BEHIND_LOGIT).all()


@pytest.mark.parametrize(("make", "outputs"), [(middle_decoder, 1), (fine_decoder, 1), (color_decoder, 3)])
def test_a_frozen_decoder_is_the_decoder(make, outputs):
    decoder = make(torch.Generator().manual_seed(1)).requires_grad_(False)
    generator = torch.Generator().manual_seed(2)
    points = (torch.randn(50, 3, generator=generator) * 3).requires_grad_()
    features = torch.randn(50, decoder.features, generator=generator).requires_grad_()
    given = torch.randn(50, outputs, generator=generator)
    expected = decoder(points, features)[:, :outputs]
    of_points, of_features = torch.autograd.grad(expected, (points, features), given)
    frozen = FrozenDecoder(decoder, outputs)
    values, opened = frozen.values(points.detach(), features.detach())
    close(values, expected.detach(), 1e-5)
    ours, moved = frozen.gradients(opened, given, points.detach())
    close(ours, of_features[:, :32], 1e-5)
    close(moved, of_points, 1e-4)
    assert frozen.gradients(opened, given, None)[1] is None


def test_a_decoder_that_learns():
    decoder = color_decoder(torch.Generator().manual_seed(1))
    generator = torch.Generator().manual_seed(2)
    points = torch.randn(60, 3, generator=generator).requires_grad_()
    features = torch.randn(60, 32, generator=generator).requires_grad_()
    given = torch.randn(60, 3, generator=generator)
    inputs = (features, points, *decoder.parameters())
    expected = torch.autograd.grad(decoder(points, features)[:, :3], inputs, given)
    of_features, of_points, learned = FrozenDecoder(decoder, 3).learn(points.detach(), features.detach(), given)
    for ours, theirs in zip([of_features, of_points, *learned], expected, strict=True):
        assert ours.shape == theirs.shape
        close(ours, theirs, 1e-4)


def test_sine_and_cosine():
    angles = np.concatenate([np.linspace(-1500, 1500, 100_001), [0.0]]).astype(np.float32)
    for kernel, exact in ((kernels.sine, np.sin), (kernels.cosine, np.cos)):
        found = np.empty_like(angles)
        kernel(angles, found)
        np.testing.assert_allclose(found, exact(angles.astype(np.float64)), atol=3e-7)


def test_workers_keep_the_order():
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        workers = Workers()
        assert workers.share(lambda worker, job: (worker, 2 * job), range(7)) == [(i % 3, 2 * i) for i in range(7)]
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(threads)
