"""Colour as one more sensor of the map: chosen views, their depth, and how far it can be believed."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import PhotometricConfig, UncertaintyConfig
from ..core.events import OnEvent, ignore, track_progress
from ..core.frame import Frame
from ..run.frames import RunFrames
from ..sensors.noise_model import NoiseModel, Residuals
from ..volume.tsdf_surface import TsdfSurface
from .bias_model import CONFIRMED, REFUTED, BiasModel
from .cost_volume import GreyView
from .multi_view_consistency import cross_view_residual
from .plane_sweep import FEATURES, MIN_SOURCES, PlaneSweepView, choose_sources, plane_sweep_depth

FULL_SIZE_PIXELS = 200_000  # larger images are halved: finer pixels than the map's samples cost time only
SAMPLES = 4000  # pixels of a view that teach
MIN_OBSERVING_VIEWS = 3
MIN_NORMALISED_OFFSET = 1.1 * math.log(
    2
)  # betas: from a surface that is right half of the readings are ln 2 away, give or take
MAX_REGISTRATION_PX = 1.0  # colour that lies further beside its depth is not heard: twice the step of the search
_STATE = (
    "passes", "max_normalised_offset", "frames", "indices", "sources", "poses", "depths", "betas", "samples",
    "confirmed",
)  # fmt: skip
SAMPLES_PER_VIEW = 3000  # pixels of a view at which the sensors are heard, too


class PhotometricDepth:
    """Depth by colour of some views, with the beta of each pixel; metres, (h, w) at the size it works at."""

    def __init__(
        self, camera: Camera, config: PhotometricConfig, uncertainty: UncertaintyConfig, voxel_size_m: float, seed: int
    ) -> None:
        self.voxel_size_m = voxel_size_m
        self.full, self.config, self.uncertainty, self.seed = camera, config, uncertainty, seed
        large = camera.width * camera.height > FULL_SIZE_PIXELS
        self.camera = camera.resized(camera.width // 2, camera.height // 2) if large else camera
        self.passes = 0  # so far
        self.max_normalised_offset = (
            0.0  # of a look: how far the surface is from where it was looked for, median in betas
        )
        self.frames = 0  # that the views stand for
        self.poses: list[Tensor] = []
        self.depths: list[Tensor] = []
        self.betas: list[Tensor] = []
        self.indices: list[int] = []
        self.sources: list[list[int]] = []  # of each view: the frames that it was compared with
        self.samples: dict[str, Tensor] = {}
        self.confirmed = False  # poses and calibration are known to be as exact as it needs

    def look(
        self, frames: RunFrames, poses: dict[int, np.ndarray], surface: TsdfSurface, on_event: OnEvent = ignore
    ) -> float | None:
        """Find the depth of views along the trajectory `poses` around `surface`, and learn how noisy it is.

        Returns the mean negative log-likelihood in nats. None if nothing was found: what it said before still holds,
        and it is not asked again.
        """
        images = self._match(frames, poses, surface, on_event)
        generator = torch.Generator().manual_seed(self.seed)
        noise = NoiseModel(self.uncertainty, generator, FEATURES)
        loss = self._learn(noise, images, generator)
        self.passes = self.config.max_passes if loss is None else self.passes + 1
        if loss is None:
            return None
        self.forget()
        self.frames = len(poses)
        for image in images:
            depth = torch.from_numpy(image.depth)
            self.indices.append(image.index)
            self.sources.append(list(image.sources))
            self.poses.append(torch.from_numpy(image.T_world_camera).float())
            self.depths.append(depth)
            self.betas.append(noise.beta_image(depth, torch.from_numpy(image.features).float()).half())
        moved = [torch.from_numpy(image.moved) for image in images]
        self.max_normalised_offset = max(self.max_normalised_offset, self._surprise(moved))
        return loss

    def needs_another_pass(self) -> bool:
        """Whether colour is known to be exact, and once found the surface where it was not looked for: that moves the
        map and the biases of the sensors, and from there it finds more."""
        return (
            self.confirmed
            and self.max_normalised_offset > MIN_NORMALISED_OFFSET
            and self.passes < self.config.max_passes
        )

    def judge(self, confirmed: float | None) -> None:
        """Be known to be exact, or say nothing, given the share of the views of sensors that agree better with each
        other once they are corrected by what colour says; neither in between, or if None can tell."""
        if confirmed is not None and confirmed <= REFUTED:
            self.forget()
        self.confirmed = confirmed is not None and confirmed >= CONFIRMED

    def forget(self) -> None:
        """Say nothing."""
        self.depths, self.betas, self.poses, self.indices, self.sources, self.samples = [], [], [], [], [], {}

    def sample_view(self, frame: Frame, features: dict[str, Tensor], view: int, surface: TsdfSurface) -> None:
        """Keep what colour, the sensors and the map say at some pixels of a frame that is a view."""
        depth, beta, T_world_camera = self._at_full_size(view)
        pixels = depth.view(-1).nonzero()[:, 0]
        rng = np.random.default_rng((self.seed, view))
        pixels = pixels[torch.from_numpy(rng.choice(len(pixels), min(SAMPLES_PER_VIEW, len(pixels)), replace=False))]
        sensors = torch.stack([image.view(-1)[pixels] for image in frame.depths.values()], 1)
        inputs = torch.stack([image.view(-1, image.shape[-1])[pixels] for image in features.values()], 1)
        told = {"color": depth.view(-1)[pixels], "beta": beta.view(-1)[pixels]}
        told |= {"sensors": sensors, "inputs": inputs.half(), "views": torch.full((len(pixels),), view)}
        rays = self.full.rays().view(-1, 3)[pixels]
        expected = surface.along(rays, T_world_camera).cpu()
        told |= {"expected": expected, "directions": rays @ T_world_camera[:3, :3].T}
        self.samples = {n: torch.cat([self.samples[n], v]) if self.samples else v for n, v in told.items()}

    def origins(self) -> Tensor:
        """(N, 3) where each pixel of the testimony was seen from, world."""
        return torch.stack(self.poses)[self.samples["views"], :3, 3]

    def points(self) -> Tensor:
        """(N, 3) where the map is at each pixel of the testimony, world; at the camera where it is nowhere."""
        return self.origins() + self.samples["expected"][:, None] * self.samples["directions"]

    def against(self, column: int, bias: BiasModel | None = None) -> Residuals:
        """How far the readings of a sensor, without its `bias`, lie beyond what colour says, which errs by its beta."""
        depth = self.samples["sensors"][:, column]
        read = depth > 0
        inputs = self.samples["inputs"][read, column]
        off = (depth - self.samples["color"])[read] - (bias.of(inputs.float()) if bias else 0.0)
        return Residuals(off, inputs, self.samples["beta"][read])

    def readings(self) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """For each view: depth (H, W) and beta (H, W) in metres at the size of the recording, and T_world_camera."""
        for view in range(len(self.depths)):
            yield self._at_full_size(view)

    def _at_full_size(self, view: int) -> tuple[Tensor, Tensor, Tensor]:
        size, images = (self.full.width, self.full.height), (self.depths[view], self.betas[view])
        depth, beta = (cv2.resize(i.float().numpy(), size, interpolation=cv2.INTER_NEAREST) for i in images)
        return torch.from_numpy(depth), torch.from_numpy(beta), self.poses[view]

    def related(self) -> np.ndarray:
        """(V, V) bool: views that were compared with each other, or with the same frame; each with itself."""
        used = [{index, *others} for index, others in zip(self.indices, self.sources, strict=True)]
        return np.array([[not one.isdisjoint(other) for other in used] for one in used])

    @property
    def frames_per_view(self) -> float:
        return self.frames / max(len(self.depths), 1)

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors that `load_state_dict` continues from."""
        return {name: getattr(self, name) for name in _STATE}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in _STATE:
            setattr(self, name, state[name])

    # --- views -------------------------------------------------------------------------------------------------
    def _match(
        self, frames: RunFrames, poses: dict[int, np.ndarray], surface: TsdfSurface, on_event: OnEvent
    ) -> list[PlaneSweepView]:
        chosen = self._choose(poses, surface)
        if len(chosen) <= MIN_SOURCES:
            return []
        views = [GreyView(index, self._grey(frames, index), poses[index]) for index in chosen]
        matrices = np.stack([view.T_world_camera for view in views])

        def work(row: int) -> PlaneSweepView | None:
            prior = surface.depth_from(self.camera, matrices[row])
            if not (prior > 0).any():
                return None
            sources = choose_sources(self.camera, matrices, row, float(np.median(prior[prior > 0])))
            if len(sources) < MIN_SOURCES:
                return None
            return plane_sweep_depth(self.camera, views[row], [views[s] for s in sources], prior)

        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            done = track_progress(pool.map(work, range(len(views))), len(views), "comparing colours", on_event, "views")
            return [image for image in done if image is not None]

    def _choose(self, poses: dict[int, np.ndarray], surface: TsdfSurface) -> list[int]:
        """Frames between which the camera moved or turned enough to show something new; no more than allowed."""
        chosen: list[int] = []
        distance = 1.0
        for index in sorted(poses):
            if chosen:
                step = np.linalg.inv(poses[chosen[-1]]) @ poses[index]
                turn = np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1))
                if (
                    np.linalg.norm(step[:3, 3]) < self.config.min_baseline_ratio * distance
                    and turn < self.config.min_rotation_rad
                ):
                    continue
            chosen.append(index)
            distance = surface.median_depth(self.camera, poses[index]) or distance
        every = -(-len(chosen) // self.config.max_views)
        return chosen[:: max(every, 1)]

    def _grey(self, frames: RunFrames, index: int) -> np.ndarray:
        grey = cv2.cvtColor(frames.color(index).numpy(), cv2.COLOR_RGB2GRAY)
        size = (self.camera.width, self.camera.height)
        small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA) if self.camera is not self.full else grey
        return small.astype(np.float32)

    def _surprise(self, moved: list[Tensor]) -> float:
        """Median in betas of how far the depth of each view `moved`, (h, w) metres, where it can tell samples apart."""
        sure = [(d > 0) & (b < self.voxel_size_m) for d, b in zip(self.depths, self.betas, strict=True)]
        betas = [m[s] / b[s].float() for m, b, s in zip(moved, self.betas, sure, strict=True)]
        return float(torch.cat(betas).median()) if any(map(len, betas)) else 0.0

    # --- noise -------------------------------------------------------------------------------------------------
    def _learn(self, noise: NoiseModel, images: list[PlaneSweepView], generator: torch.Generator) -> float | None:
        rng = np.random.default_rng(self.seed)
        features, residuals = [], []
        for row, image in enumerate(images):
            pixels = np.flatnonzero(image.depth)
            pixels = rng.choice(pixels, min(SAMPLES, len(pixels)), replace=False)
            residual, count = cross_view_residual(self.camera, images, row, pixels)
            kept = count >= MIN_OBSERVING_VIEWS
            features.append(image.features.reshape(-1, len(FEATURES))[pixels[kept]])
            residuals.append(residual[kept])
        if sum(map(len, residuals)) < SAMPLES:
            return None
        inputs = torch.from_numpy(np.concatenate(features))
        off = torch.from_numpy(np.concatenate(residuals)).float()
        return noise.learn(Residuals.against_truth(off, inputs), self.uncertainty.steps_per_pass, generator)
