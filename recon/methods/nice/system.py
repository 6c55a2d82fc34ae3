"""`uncle-paper`, `nice-slam` and their kin as a system for the shared loop."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.map_config import MapConfig
from ...core.events import OnEvent, track_progress
from ...core.frame import Frame
from ...run.frames import RunFrames
from ...volume.neural_field import NeuralField
from ...volume.sparse_grid import SparseGrid
from ..confidence.models import ConfidenceModels
from ..online import Found, Poses
from .bound import around, bound_of, points_of, set_bound
from .fast import FastEvaluate
from .mapper import Keyframe, NiceMapper
from .objective import Evaluate
from .scene import Scene
from .surface import Seen, field_of
from .tracker import NiceTracker
from .views import View
from .weighting import LaplaceWeighting, UniformWeighting, Weighting

MAX_VIEWS = 150  # asked which samples they see


class NiceSystem:
    """Feature grids in a box, a mapper and a tracker."""

    def __init__(self, frames: RunFrames, config: MapConfig, device: torch.device) -> None:
        self.frames, self.config, self.device = frames, config, device
        self.map_every = config.nice_mapping.every
        self.generator = torch.Generator().manual_seed(config.seed)
        self.draws = torch.Generator(device).manual_seed(config.seed)
        camera = frames.camera
        self.weighting: Weighting = choose_weighting(config, frames.sensors, camera, self.generator, device)
        self.learns_uncertainty = self.weighting.learns
        self.scene: Scene | None = None
        self.evaluate: Evaluate | None = None
        self.mapper: NiceMapper | None = None
        self.tracker: NiceTracker | None = None

    def begin(self, indices: list[int], on_event: OnEvent) -> None:
        """With given poses the box is that of all they see; a tracked one starts with the first frame."""
        if not self.config.tracking.enabled:
            bound = set_bound(self.config.nice)
            self._open(bound_of(self.frames, indices, self._reach) if bound is None else bound)

    def prepare(self, frame: Frame) -> View:
        """Readings out of range are none."""
        near = {sensor: torch.where(depth < self._reach, depth, 0.0) for sensor, depth in frame.depths.items()}
        frame = Frame(frame.index, frame.timestamp, frame.color, near, frame.T_world_camera)
        weighting_inputs = self.weighting.weighting_inputs(frame, self.frames.normals)
        return View(frame.index, torch.stack(list(near.values())), frame.color, weighting_inputs)

    def track(self, frame: Frame, prepared: View, recent: list[np.ndarray]) -> Found:
        found = self.tracker.track(prepared.to(self.device), recent)
        return found

    def map(self, frame: Frame, prepared: View, T_world_camera: np.ndarray, last: bool) -> Poses:
        self._reach_to(prepared, T_world_camera)
        return self.mapper.map(prepared.to(self.device), T_world_camera, last)

    def betas(self, frame: Frame, prepared: View) -> dict[str, Tensor]:
        return self.weighting.betas(frame, prepared.weighting_inputs.to(self.device))

    def field(self, poses: Poses, on_event: OnEvent) -> NeuralField:
        """The surface where any of up to `MAX_VIEWS` cameras looked."""
        seen = Seen(SparseGrid(self.config.fusion.voxel_size_m, self.device), self.scene.bound, self.frames.camera)
        order = sorted(poses)
        picks = np.unique(np.linspace(0, len(order) - 1, min(MAX_VIEWS, len(order))).astype(int))
        for pick in track_progress(picks, len(picks), "finding what was seen", on_event):
            index = order[pick]
            depths = torch.stack([self.frames.depth(index, sensor) for sensor in self.frames.sensors])
            depths = torch.where(depths < self._reach, depths, 0.0).to(self.device)
            seen.add(depths, torch.from_numpy(poses[index]).float().to(self.device))
        return field_of(self.scene, seen, self.evaluate, self.config)

    def curves(self) -> dict[str, list[float]]:
        return self.mapper.curves

    def keyframes(self) -> int:
        return len(self.mapper.keyframes)

    def artifacts(self) -> dict[str, Any]:
        """Box, grids, decoders with their origin, h_w, and the keyframes' indices and poses."""
        decoders = self.scene.decoders
        frozen = {name: getattr(decoders, name).state_dict() for name in ("middle", "fine")}
        return self._learned() | {"decoders": {**frozen, "origin": decoders.origin}}

    def state_dict(self) -> dict[str, Any]:
        generators = {"generator": self.generator.get_state(), "draws": self.draws.get_state()}
        if self.scene is None:
            return generators
        mapper = {"curves": self.mapper.curves, "next_keyframe": self.mapper.next_keyframe}
        return self._learned() | generators | {"mapper": mapper}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        if "scene" in state:
            self._open(state["scene"]["bound"].cpu())
            self.scene.load_state(state["scene"])
            for name, net in self.weighting.nets().items():
                net.load_state_dict(state["noise"][name])
            self.mapper.curves = dict(state["mapper"]["curves"])
            self.mapper.next_keyframe = state["mapper"]["next_keyframe"]
            for index, pose in state["keyframes"].items():
                view = self.prepare(self.frames[index]).to(self.device)
                self.mapper.keyframes.append(Keyframe(view, np.array(pose)))
        self.generator.set_state(state["generator"].cpu())
        self.draws.set_state(state["draws"].cpu())

    def _learned(self) -> dict[str, Any]:
        return {
            "scene": self.scene.to_state(),
            "noise": {name: net.state_dict() for name, net in self.weighting.nets().items()},
            "keyframes": {k.view.index: k.T_world_camera.tolist() for k in self.mapper.keyframes},
        }

    @property
    def _reach(self) -> float:
        return self.config.fusion.max_depth_m

    def _open(self, bound: Tensor) -> None:
        self.scene = Scene(bound, self.config.nice, self.generator, self.device)
        self.evaluate = FastEvaluate(self.scene) if self.device.type == "cpu" else self.scene.values
        parts = (self.scene, self.weighting, self.frames.camera, self.config, self.evaluate)
        self.mapper = NiceMapper(*parts, self.generator, self.draws)
        self.tracker = NiceTracker(*parts, self.draws)

    def _reach_to(self, view: View, T_world_camera: np.ndarray) -> None:
        """Open the box at the first frame of a tracked run, and enlarge it when a camera sees beyond."""
        if not self.config.tracking.enabled:
            return
        parts = [points_of(depth, self.frames.camera, T_world_camera, self._reach) for depth in view.depths]
        points, centre = np.concatenate(parts), T_world_camera[None, :3, 3]
        bound = set_bound(self.config.nice)
        if bound is None:
            bound = around(points, centre) if len(points) else around(centre, centre)
        if self.scene is None:
            self._open(bound)
        elif not self.config.nice.bound:
            self.scene.grow(bound, self.generator)


def choose_weighting(config: Any, sensors: tuple[str, ...], camera: Camera, generator: torch.Generator,
                     device: torch.device) -> Weighting:  # fmt: skip
    """The weighting that `config` (a `MapConfig`) asks for. Raises ConfigError."""
    if config.nice.weighting == "laplace":
        return LaplaceWeighting(config.nice, sensors, camera, generator, device)
    if config.nice.weighting == "confidence":
        from .confidence_weighting import ConfidenceWeighting  # which is made of `UniformWeighting`

        models = ConfidenceModels.load(sensors, config.confidence.files, device)
        return ConfidenceWeighting(config.nice, config.nice_tracking, models, device)
    return UniformWeighting(config.nice, config.nice_tracking)
