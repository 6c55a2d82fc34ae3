"""`uncle-paper`, `nice-slam` and `nice-slam-pre` as an `OnlineSystem`: track, map, and extract the surface."""

from __future__ import annotations

from dataclasses import dataclass
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
from ..base import Poses
from ..confidence.models import ConfidenceModels
from ..online import Found
from .bound import backproject, bound_around, bound_of_frames, configured_bound
from .confidence_weighting import ConfidenceWeighting
from .fast import FastEvaluate
from .mapper import Keyframe, NiceMapper
from .objective import Evaluate
from .scene import GridScene
from .surface import ObservedSamples, extract_field
from .tracker import NiceTracker
from .views import PreparedFrame
from .weighting import LaplaceWeighting, UniformWeighting, Weighting


@dataclass(frozen=True)
class OpenScene:
    """What exists as soon as the box of the scene is known."""

    scene: GridScene
    evaluate: Evaluate
    mapper: NiceMapper
    tracker: NiceTracker


class NiceSystem:
    """Feature grids in a box, a mapper and a tracker.

    With given poses the box encloses what all frames see, and is known when mapping begins; with tracked poses it
    begins with the first mapped frame and grows.
    """

    def __init__(self, frames: RunFrames, config: MapConfig, device: torch.device) -> None:
        self.frames, self.config, self.device = frames, config, device
        self.map_every = config.nice_mapping.every
        self.generator = torch.Generator().manual_seed(config.seed)
        self.draws = torch.Generator(device).manual_seed(config.seed)
        self.weighting: Weighting = choose_weighting(config, frames.sensors, frames.camera, self.generator, device)
        self.learns_uncertainty = self.weighting.learns_noise
        self._open_scene: OpenScene | None = None

    @property
    def opened(self) -> OpenScene:
        """Scene, mapper and tracker. Raises RuntimeError before the box is known."""
        if self._open_scene is None:
            raise RuntimeError("the box of the scene is not known yet: call begin(), or map a frame")
        return self._open_scene

    @property
    def scene(self) -> GridScene:
        """The scene; see `opened`."""
        return self.opened.scene

    @property
    def mapper(self) -> NiceMapper:
        """The mapper; see `opened`."""
        return self.opened.mapper

    def begin(self, indices: list[int], on_event: OnEvent) -> None:
        """Find the box of the scene where poses are given."""
        if not self.config.tracking.enabled:
            bound = configured_bound(self.config.nice)
            if bound is None:
                bound = bound_of_frames(self.frames, indices, self._max_depth_m)
            self._open(bound)

    def prepare(self, frame: Frame) -> PreparedFrame:
        """Stack the frame's images, without depths out of range, and compute the weighting's inputs."""
        depths = {sensor: torch.where(depth < self._max_depth_m, depth, 0.0) for sensor, depth in frame.depths.items()}
        frame = Frame(frame.index, frame.timestamp, frame.color, depths, frame.T_world_camera)
        weighting_inputs = self.weighting.weighting_inputs(frame, self.frames.normals)
        return PreparedFrame(frame.index, torch.stack(list(depths.values())), frame.color, weighting_inputs)

    def track(self, frame: Frame, prepared: PreparedFrame, recent: list[np.ndarray]) -> Found:
        """Find the pose of a frame from the last ones."""
        return self.opened.tracker.track(prepared.to(self.device), recent)

    def map(self, frame: Frame, prepared: PreparedFrame, T_world_camera: np.ndarray, last: bool) -> Poses:
        """Optimise the scene on a frame; returns the poses that bundle adjustment moved."""
        if self.config.tracking.enabled:
            self.extend_bound(prepared, T_world_camera)
        return self.mapper.map(prepared.to(self.device), T_world_camera, last)

    def betas(self, frame: Frame, prepared: PreparedFrame) -> dict[str, Tensor]:
        """Error scale of each sensor's depth image, (H, W) metres."""
        return self.weighting.betas(frame, prepared.weighting_inputs.to(self.device))

    def field(self, poses: Poses, on_event: OnEvent) -> NeuralField:
        """The surface where any of a number of evenly spread cameras observed it."""
        voxel_size_m = self.config.fusion.voxel_size_m
        samples = ObservedSamples(SparseGrid(voxel_size_m, self.device), self.scene.bound, self.frames.camera)
        order = sorted(poses)
        count = min(samples.parameters.max_frames, len(order))
        picks = np.unique(np.linspace(0, len(order) - 1, count).astype(int))
        for pick in track_progress(picks, len(picks), "finding observed space", on_event):
            index = order[pick]
            depths = torch.stack([self.frames.depth(index, sensor) for sensor in self.frames.sensors])
            depths = torch.where(depths < self._max_depth_m, depths, 0.0).to(self.device)
            samples.add(depths, torch.from_numpy(poses[index]).float().to(self.device))
        return extract_field(self.scene, samples, self.opened.evaluate, self.config)

    def curves(self) -> dict[str, list[float]]:
        """Mean negative log-likelihoods after each mapped frame, by name, nats."""
        return self.mapper.curves

    def keyframes(self) -> int:
        """Number of keyframes."""
        return len(self.mapper.keyframes)

    def artifacts(self) -> dict[str, Any]:
        """Box, grids, decoders with their origin, h_w, and the keyframes' indices and poses."""
        decoders = self.scene.decoders
        frozen = {name: getattr(decoders, name).state_dict() for name in ("middle", "fine")}
        return self._learned() | {"decoders": {**frozen, "origin": decoders.origin}}

    def state_dict(self) -> dict[str, Any]:
        """What `load_state_dict` continues from, as plain tensors and containers."""
        generators = {"generator": self.generator.get_state(), "draws": self.draws.get_state()}
        if self._open_scene is None:
            return generators
        mapper = {"curves": self.mapper.curves, "next_keyframe": self.mapper.next_keyframe}
        return self._learned() | generators | {"mapper": mapper}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        if "scene" in state:
            self._open(state["scene"]["bound"].cpu())
            self.scene.load_state(state["scene"])
            for name, network in self.weighting.networks().items():
                network.load_state_dict(state["noise"][name])
            self.mapper.curves = dict(state["mapper"]["curves"])
            self.mapper.next_keyframe = state["mapper"]["next_keyframe"]
            for index, pose in state["keyframes"].items():
                view = self.prepare(self.frames[index]).to(self.device)
                self.mapper.keyframes.append(Keyframe(view, np.array(pose)))
        self.generator.set_state(state["generator"].cpu())
        self.draws.set_state(state["draws"].cpu())

    def extend_bound(self, view: PreparedFrame, T_world_camera: np.ndarray) -> None:
        """Make the box of a scene without given poses enclose what a frame sees from a pose (4, 4)."""
        camera = self.frames.camera
        parts = [backproject(depth, camera, T_world_camera, self._max_depth_m) for depth in view.depths]
        points, centre = np.concatenate(parts), T_world_camera[None, :3, 3]
        bound = configured_bound(self.config.nice)
        if bound is None:
            bound = bound_around(points, centre) if len(points) else bound_around(centre, centre)
        if self._open_scene is None:
            self._open(bound)
        elif not self.config.nice.bound:
            self.scene.grow(bound, self.generator)

    def _learned(self) -> dict[str, Any]:
        return {
            "scene": self.scene.to_state(),
            "noise": {name: network.state_dict() for name, network in self.weighting.networks().items()},
            "keyframes": {k.view.index: k.T_world_camera.tolist() for k in self.mapper.keyframes},
        }

    @property
    def _max_depth_m(self) -> float:
        return self.config.fusion.max_depth_m

    def _open(self, bound: Tensor) -> None:
        scene = GridScene(bound, self.config.nice, self.generator, self.device)
        evaluate: Evaluate = FastEvaluate(scene) if self.device.type == "cpu" else scene.values
        shared = (scene, self.weighting, self.frames.camera, self.config, evaluate)
        mapper = NiceMapper(*shared, self.generator, self.draws)
        self._open_scene = OpenScene(scene, evaluate, mapper, NiceTracker(*shared, self.draws))


def choose_weighting(
    config: MapConfig, sensors: tuple[str, ...], camera: Camera, generator: torch.Generator, device: torch.device
) -> Weighting:
    """The weighting that the settings name. Raises ConfigError if a confidence network is missing."""
    if config.nice.weighting == "laplace":
        return LaplaceWeighting(config.nice, sensors, camera, generator, device)
    if config.nice.weighting == "confidence":
        models = ConfidenceModels.load(sensors, config.confidence.files, device)
        return ConfidenceWeighting(config.nice, config.nice_tracking, models, device)
    return UniformWeighting(config.nice, config.nice_tracking)
