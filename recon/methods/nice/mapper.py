"""The mapper: two-stage optimisation of the scene over a window of frames (METHOD, Mapping)."""

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
from .keyframes import choose_window, overlapping
from .objective import Evaluate, look, mapping_loss
from .poses import tidy, to_matrix, to_seven
from .scene import Scene, Stage
from .views import View, Window
from .weighting import Weighting

MIN_KEYFRAMES_BA = 4  # more than these, and the cameras are moved, too
REFINE_ROUNDS = 5


@dataclass
class Keyframe:
    """A view that is kept, and where it was taken from, (4, 4) float64."""

    view: View
    T_world_camera: np.ndarray


class NiceMapper:
    """Optimises `scene` and the networks of `weighting`. `generator` is of the CPU, `draws` of the device."""

    def __init__(
        self, scene: Scene, weighting: Weighting, camera: Camera, config: MapConfig, evaluate: Evaluate,
        generator: torch.Generator, draws: torch.Generator,
    ) -> None:  # fmt: skip
        self.scene, self.weighting, self.camera, self.evaluate = scene, weighting, camera, evaluate
        self.config, self.settings = config, config.nice_mapping
        self.generator, self.draws = generator, draws
        self.keyframes: list[Keyframe] = []
        self.curves: dict[str, list[float]] = {}
        self.next_keyframe: int | None = None

    def map(self, view: View, T_world_camera: np.ndarray, last: bool) -> dict[int, np.ndarray]:
        """Optimise the scene on a view and its window; returns the poses of frames that bundle adjustment moved."""
        first, settings = not self.keyframes, self.settings
        current = Keyframe(view, T_world_camera)
        frames = [*self._window(current, settings.window), current]
        masks = self._masks(current)
        count = settings.first_iterations if first else settings.iterations
        moves = settings.bundle_adjustment and self.config.tracking.enabled and len(self.keyframes) > MIN_KEYFRAMES_BA
        stages = schedule(count, settings, self.config.nice.reproduce_released_code, self.config.nice.color)
        self._optimise(frames, stages, masks, settings.first_factor if first else 1.0, moves)
        if last and settings.refine and not first:
            self._refine(current)
        if self.next_keyframe is None or view.index >= self.next_keyframe:
            self.keyframes.append(current)
            self.next_keyframe = view.index + settings.keyframe_every
        for name, nats in self.weighting.nats().items():
            self.curves.setdefault(f"noise/{name}", []).append(nats)
        return {frame.view.index: frame.T_world_camera for frame in frames} if moves else {}

    def loss(self, window: Window, poses: Tensor, stage: Stage) -> Tensor:
        """Of fresh random pixels of the window's views at poses (M, 4, 4)."""
        rays = window.draw(self.settings.pixels, self.draws)
        picture = look(rays, poses, self.evaluate, self.scene.bound, stage, self.config.nice)
        return mapping_loss(picture, rays, self.weighting, stage)

    def _window(self, current: Keyframe, size: int) -> list[Keyframe]:
        device = self.scene.device
        poses = torch.from_numpy(np.array([k.T_world_camera for k in self.keyframes])).float().to(device)
        pose = torch.from_numpy(current.T_world_camera).float().to(device)
        seen = overlapping(current.view.depths, pose, poses, self.camera, self.generator)
        return [self.keyframes[k] for k in choose_window(seen, len(self.keyframes), size)]

    def _masks(self, current: Keyframe) -> dict[str, Tensor]:
        pose = torch.from_numpy(current.T_world_camera).float().to(self.scene.device)
        grids = self.scene.grids.items()
        return {name: in_frustum(g.vertices(), current.view.depths, pose, self.camera)[:, None] for name, g in grids}

    def _refine(self, current: Keyframe) -> None:
        """The last frame: all features, twice the window, the colour decoder held."""
        reproduce_released_code, color = self.config.nice.reproduce_released_code, self.config.nice.color
        stages: list[Stage] = ["color" if color else "fine"] * self.settings.iterations
        if reproduce_released_code:
            stages[0] = "middle"
        for _ in range(REFINE_ROUNDS):
            frames = [*self._window(current, 2 * self.settings.window), current]
            self._optimise(frames, stages, {}, 1.0, moves=False, holds_colors=True)

    def _optimise(
        self, frames: list[Keyframe], stages: list[Stage], masks: dict[str, Tensor], factor: float, moves: bool,
        holds_colors: bool = False,
    ) -> None:  # fmt: skip
        """Adam from fresh moments. `masks` (V, 1): features that may change, all where a grid has none."""
        window = Window(
            [frame.view for frame in frames], self.camera, self.weighting.patch_size, self.weighting.color_patch
        )  # fmt: skip
        seven = to_seven(np.array([frame.T_world_camera for frame in frames])).to(self.scene.device)
        oldest = min(range(len(frames)), key=lambda i: frames[i].view.index)
        free = torch.tensor([[float(i != oldest)] for i in range(len(frames))], device=self.scene.device)
        fixed, seven = to_matrix(seven), seven.requires_grad_(moves)
        self.scene.learn(not holds_colors)
        last: Stage = "color" if self.config.nice.color else "fine"
        optimizer = Optimizer(self.scene, self.weighting, seven if moves else None, self.settings, factor, last)
        for stage in stages:
            adjusts = moves and stage == last
            poses = to_matrix(seven * free + seven.detach() * (1 - free)) if adjusts else fixed
            optimizer.step(self.loss(window, poses, stage), stage, masks)
        if moves:
            for frame, pose in zip(frames, to_matrix(seven.detach()), strict=True):
                frame.T_world_camera = tidy(pose)


class Optimizer:
    """One Adam over groups whose step sizes follow the stage."""

    def __init__(
        self, scene: Scene, weighting: Weighting, poses: Tensor | None, settings: NiceMappingConfig, factor: float,
        last: Stage,
    ) -> None:  # fmt: skip
        """`last`: the stage in which poses (M, 7) move."""
        self.tables = {name: grid.table for name, grid in scene.grids.items()}
        groups = {name: [table] for name, table in self.tables.items()}
        groups["decoder"] = list(scene.color_decoder.parameters())
        groups["noise"] = [p for net in weighting.nets().values() for p in net.parameters()]
        groups["poses"] = [] if poses is None else [poses]
        named = [{"params": params, "name": name} for name, params in groups.items() if params]
        self.adam = torch.optim.Adam(named, fused=True)
        self.rates = {stage: learning_rates(settings, stage, factor, last) for stage in ("middle", "fine", "color")}

    def step(self, loss: Tensor, stage: Stage, masks: dict[str, Tensor]) -> None:
        """Down the gradient of `loss`; features outside of `masks` stay as they are."""
        self.adam.zero_grad(set_to_none=True)
        loss.backward()
        for name, mask in masks.items():
            if self.tables[name].grad is not None:
                self.tables[name].grad.mul_(mask)
        for group in self.adam.param_groups:
            group["lr"] = self.rates[stage][group["name"]]
        self.adam.step()


def learning_rates(settings: NiceMappingConfig, stage: Stage, factor: float, last: Stage) -> dict[str, float]:
    """Step size of each group in a stage; poses move in the `last` one, colour or, without colour, fine."""
    later, middle, color = settings.learning_rate * factor, stage == "middle", stage == "color"
    return {
        "middle": settings.learning_rate_middle * factor if middle else later,
        "fine": 0.0 if middle else later,
        "color": later if color else 0.0,
        "decoder": 0.0 if middle else later,
        "noise": 0.0 if middle else settings.learning_rate_noise * factor,
        "poses": settings.learning_rate_pose if stage == last else 0.0,
    }


def schedule(iterations: int, settings: NiceMappingConfig, reproduce_released_code: bool, color: bool) -> list[Stage]:
    """The stage of each step. D5: the paper's fine grid joins after 60 percent of them, the published code's after 40,
    and its colour after 60."""
    return list(
        _stages(
            iterations,
            0.4 if reproduce_released_code else settings.fine_stage_start,
            0.6 if reproduce_released_code else 0.0,
            color,
        )
    )


def _stages(iterations: int, fine_from: float, color_from: float, color: bool) -> Iterator[Stage]:
    for step in range(iterations):
        if step <= int(fine_from * iterations):
            yield "middle"
        elif not color or step <= int(color_from * iterations):
            yield "fine"
        else:
            yield "color"
