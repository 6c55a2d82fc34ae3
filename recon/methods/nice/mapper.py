"""The mapper: optimisation of the scene in stages, over a window of frames (docs/uncle-paper.md, Mapping)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.map_config import MapConfig
from ...core.config.nice import NiceMappingConfig
from .frustum import in_frustum
from .keyframes import choose_window, overlapping_keyframes
from .objective import Evaluate, mapping_loss, render_rays
from .poses import to_pose_matrix, to_pose_vector, to_rigid
from .scene import GridScene, Stage
from .views import PreparedFrame, Window
from .weighting import Weighting

# Constants of the released code of NICE-SLAM and UncLe-SLAM.
MIN_KEYFRAMES_BA = 4  # bundle adjustment needs more keyframes than these
REFINE_ROUNDS = 5


@dataclass
class Keyframe:
    """A kept frame and its pose (4, 4) float64."""

    view: PreparedFrame
    T_world_camera: np.ndarray


class NiceMapper:
    """Optimises `scene` and the networks of `weighting`.

    `generator` is a generator of the CPU, `draws` one of the scene's device. `curves`: mean negative log-likelihood
    after each mapped frame, by "noise/<sensor>".
    """

    def __init__(
        self, scene: GridScene, weighting: Weighting, camera: Camera, config: MapConfig, evaluate: Evaluate,
        generator: torch.Generator, draws: torch.Generator,
    ) -> None:  # fmt: skip
        self.scene, self.weighting, self.camera, self.evaluate = scene, weighting, camera, evaluate
        self.config, self.settings = config, config.nice_mapping
        self.generator, self.draws = generator, draws
        self.keyframes: list[Keyframe] = []
        self.curves: dict[str, list[float]] = {}
        self.next_keyframe: int | None = None

    def map(self, view: PreparedFrame, T_world_camera: np.ndarray, last: bool) -> dict[int, np.ndarray]:
        """Optimise the scene on a frame and its window; returns the poses that bundle adjustment moved, by frame."""
        first, settings = not self.keyframes, self.settings
        current = Keyframe(view, T_world_camera)
        frames = [*self._window(current, settings.window), current]
        masks = self._masks(current)
        count = settings.first_iterations if first else settings.iterations
        adjusts = settings.bundle_adjustment and self.config.tracking.enabled and len(self.keyframes) > MIN_KEYFRAMES_BA
        stages = schedule(count, settings, self.config.nice.reproduce_released_code, self.config.nice.color)
        self._optimise(frames, stages, masks, settings.first_factor if first else 1.0, adjusts)
        if last and settings.refine and not first:
            self._refine(current)
        if self.next_keyframe is None or view.index >= self.next_keyframe:
            self.keyframes.append(current)
            self.next_keyframe = view.index + settings.keyframe_every
        for name, nll in self.weighting.mean_nll().items():
            self.curves.setdefault(f"noise/{name}", []).append(nll)
        return {frame.view.index: frame.T_world_camera for frame in frames} if adjusts else {}

    def loss(self, window: Window, poses: Tensor, stage: Stage) -> Tensor:
        """Mapping loss of newly drawn pixels of the window's frames at poses (M, 4, 4)."""
        rays = window.draw(self.settings.pixels, self.draws)
        rendered = render_rays(rays, poses, self.evaluate, self.scene.bound, stage, self.config.nice)
        return mapping_loss(rendered, rays, self.weighting, stage)

    def _window(self, current: Keyframe, size: int) -> list[Keyframe]:
        device = self.scene.device
        poses = torch.from_numpy(np.array([k.T_world_camera for k in self.keyframes])).float().to(device)
        pose = torch.from_numpy(current.T_world_camera).float().to(device)
        overlapping = overlapping_keyframes(current.view.depths, pose, poses, self.camera, self.generator)
        return [self.keyframes[k] for k in choose_window(overlapping, len(self.keyframes), size)]

    def _masks(self, current: Keyframe) -> dict[str, Tensor]:
        """Of each grid the features (V, 1) that the current frame may change."""
        pose = torch.from_numpy(current.T_world_camera).float().to(self.scene.device)
        depths = current.view.depths
        return {
            name: in_frustum(grid.vertices(), depths, pose, self.camera)[:, None]
            for name, grid in self.scene.grids.items()
        }

    def _refine(self, current: Keyframe) -> None:
        """Optimise all features on twice the window with the colour decoder held, after the last frame.

        The released code begins each round in the middle stage (docs/uncle-paper.md, difference 10).
        """
        stages: list[Stage] = ["color" if self.config.nice.color else "fine"] * self.settings.iterations
        if self.config.nice.reproduce_released_code:
            stages[0] = "middle"
        for _ in range(REFINE_ROUNDS):
            frames = [*self._window(current, 2 * self.settings.window), current]
            self._optimise(frames, stages, {}, 1.0, adjusts=False, holds_colors=True)

    def _optimise(
        self, frames: list[Keyframe], stages: list[Stage], masks: dict[str, Tensor], factor: float, adjusts: bool,
        holds_colors: bool = False,
    ) -> None:  # fmt: skip
        """A step for each of `stages`, with a new Adam. `masks` (V, 1): features that may change, all where missing."""
        weighting = self.weighting
        views = [frame.view for frame in frames]
        window = Window(views, self.camera, weighting.patch_size, weighting.color_patch)
        vectors = to_pose_vector(np.array([frame.T_world_camera for frame in frames])).to(self.scene.device)
        oldest = min(range(len(frames)), key=lambda i: frames[i].view.index)
        free = torch.tensor([[float(i != oldest)] for i in range(len(frames))], device=self.scene.device)
        fixed, vectors = to_pose_matrix(vectors), vectors.requires_grad_(adjusts)
        self.scene.unfreeze(colors=not holds_colors)
        last: Stage = "color" if self.config.nice.color else "fine"
        optimizer = StageOptimizer(self.scene, weighting, vectors if adjusts else None, self.settings, factor, last)
        for stage in stages:
            poses = fixed
            if adjusts and stage == last:
                poses = to_pose_matrix(vectors * free + vectors.detach() * (1 - free))
            optimizer.step(self.loss(window, poses, stage), stage, masks)
        if adjusts:
            for frame, pose in zip(frames, to_pose_matrix(vectors.detach()), strict=True):
                frame.T_world_camera = to_rigid(pose)


class StageOptimizer:
    """One Adam over groups of parameters whose step sizes follow the stage."""

    def __init__(
        self, scene: GridScene, weighting: Weighting, poses: Tensor | None, settings: NiceMappingConfig, factor: float,
        last: Stage,
    ) -> None:  # fmt: skip
        """poses (M, 7), which move in the stage `last`, or None; factor of all step sizes but theirs."""
        self.tables = {name: grid.table for name, grid in scene.grids.items()}
        groups = {name: [table] for name, table in self.tables.items()}
        groups["decoder"] = list(scene.color_decoder.parameters())
        groups["noise"] = [p for net in weighting.networks().values() for p in net.parameters()]
        groups["poses"] = [] if poses is None else [poses]
        named = [{"params": params, "name": name} for name, params in groups.items() if params]
        self.adam = torch.optim.Adam(named, fused=True)
        self.rates = {stage: learning_rates(settings, stage, factor, last) for stage in ("middle", "fine", "color")}

    def step(self, loss: Tensor, stage: Stage, masks: dict[str, Tensor]) -> None:
        """One step on `loss`; features outside of `masks` do not change."""
        self.adam.zero_grad(set_to_none=True)
        loss.backward()
        for name, mask in masks.items():
            gradient = self.tables[name].grad
            if gradient is not None:
                gradient.mul_(mask)
        for group in self.adam.param_groups:
            group["lr"] = self.rates[stage][group["name"]]
        self.adam.step()


def learning_rates(settings: NiceMappingConfig, stage: Stage, factor: float, last: Stage) -> dict[str, float]:
    """Step size of each group in a stage; poses move in the stage `last`: colour or, without colour, fine."""
    later, middle, color = settings.learning_rate * factor, stage == "middle", stage == "color"
    return {
        "middle": settings.learning_rate_middle * factor if middle else later,
        "fine": 0.0 if middle else later,
        "color": later if color else 0.0,
        "decoder": 0.0 if middle else later,
        "noise": 0.0 if middle else settings.learning_rate_noise * factor,
        "poses": settings.learning_rate_pose if stage == last else 0.0,
    }


def schedule(iterations: int, settings: NiceMappingConfig, released: bool, color: bool) -> list[Stage]:
    """The stage of each step; `released`: that of the released code (docs/uncle-paper.md, difference 5)."""
    fine_start, color_start = (0.4, 0.6) if released else (settings.fine_stage_start, 0.0)
    return list(_stages(iterations, fine_start, color_start, color))


def _stages(iterations: int, fine_start: float, color_start: float, color: bool) -> Iterator[Stage]:
    for step in range(iterations):
        if step <= int(fine_start * iterations):
            yield "middle"
        elif not color or step <= int(color_start * iterations):
            yield "fine"
        else:
            yield "color"
