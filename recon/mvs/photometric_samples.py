"""Pixels at which photometric depth, every sensor and the map are compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..sensors.noise_model import Residuals


class DepthOffset(Protocol):
    """The part of `BiasModel` that is applied to samples."""

    def offset(self, inputs: Tensor) -> Tensor | float:
        """(N, F) -> (N,) metres to subtract."""
        ...


class SurfaceRays(Protocol):
    """The part of `TsdfSurface` that is compared at the pixels of a view."""

    def depth_along_rays(self, rays: Tensor, T_world_camera: Tensor) -> Tensor:
        """(N, 3) rays of a camera -> (N,) z-depth of the surface, metres, 0 = none."""
        ...


@dataclass(frozen=True)
class PhotometricSamples:
    """N pixels of the reference views.

    sensors: names of the S sensors, in the order of the columns below; view (N,) int64: position of the reference view;
    origins, directions (N, 3): ray in world axes, along which a direction advances by 1 metre of z-depth;
    depth, beta (N,): photometric depth and its Laplace scale, metres; map_depth (N,): z-depth of the map, metres, 0 =
    no surface; sensor_depths (N, S) metres, 0 = no measurement; sensor_inputs (N, S, F) float16: noise model inputs.
    """

    sensors: tuple[str, ...]
    view: Tensor
    origins: Tensor
    directions: Tensor
    depth: Tensor
    beta: Tensor
    map_depth: Tensor
    sensor_depths: Tensor
    sensor_inputs: Tensor

    def __len__(self) -> int:
        return len(self.depth)

    @staticmethod
    def concatenate(parts: Sequence[PhotometricSamples]) -> PhotometricSamples:
        """The samples of several views. Raises ValueError if their sensors differ."""
        sensors = parts[0].sensors
        if any(part.sensors != sensors for part in parts):
            raise ValueError(f"samples of different sensors: {[part.sensors for part in parts]}")
        names = [field.name for field in fields(PhotometricSamples) if field.name != "sensors"]
        columns = {name: torch.cat([getattr(part, name) for part in parts]) for name in names}
        return PhotometricSamples(sensors, **columns)

    def points(self) -> Tensor:
        """(N, 3) point of the map on the ray of each sample, world; the camera centre where the map has no surface."""
        return self.origins + self.map_depth[:, None] * self.directions

    def measured_by(self, sensor: str) -> tuple[Tensor, Tensor]:
        """Depth (N,) metres, 0 = no measurement, and noise model inputs (N, F) float16 of one sensor."""
        column = self.sensors.index(sensor)
        return self.sensor_depths[:, column], self.sensor_inputs[:, column]

    def sensor_residuals(self, sensor: str, bias: DepthOffset | None = None) -> Residuals:
        """How far the measurements of a sensor lie behind photometric depth, whose scale beta is the reference scale.

        `bias` is subtracted from the measurements.
        """
        depth, inputs = self.measured_by(sensor)
        valid = depth > 0
        inputs = inputs[valid]
        metres = (depth - self.depth)[valid] - (bias.offset(inputs.float()) if bias else 0.0)
        return Residuals(metres, inputs, self.beta[valid])

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers; keyword arguments of the constructor."""
        return dict(vars(self))


@dataclass(frozen=True)
class PhotometricDepthImage:
    """depth, beta (H, W) metres, 0 = none, at the size of the recording; T_world_camera (4, 4)."""

    depth: Tensor
    beta: Tensor
    T_world_camera: Tensor


def sample_view(
    view: int,
    image: PhotometricDepthImage,
    depths: Mapping[str, Tensor],
    inputs: Mapping[str, Tensor],
    camera: Camera,
    surface: SurfaceRays,
    count: int,
    seed: int,
) -> PhotometricSamples:
    """Random pixels, at most `count`, of the photometric depth of reference view number `view`.

    depths (H, W) metres and noise model inputs (H, W, F), by sensor, are those of the same frame.
    """
    pixels = image.depth.view(-1).nonzero()[:, 0]
    rng = np.random.default_rng((seed, view))
    pixels = pixels[torch.from_numpy(rng.choice(len(pixels), min(count, len(pixels)), replace=False))]
    rays = camera.rays().view(-1, 3)[pixels]
    T_world_camera = image.T_world_camera
    return PhotometricSamples(
        sensors=tuple(depths),
        view=torch.full((len(pixels),), view),
        origins=T_world_camera[:3, 3].repeat(len(pixels), 1),
        directions=rays @ T_world_camera[:3, :3].T,
        depth=image.depth.view(-1)[pixels],
        beta=image.beta.view(-1)[pixels],
        map_depth=surface.depth_along_rays(rays, T_world_camera).cpu(),
        sensor_depths=torch.stack([depth.view(-1)[pixels] for depth in depths.values()], 1),
        sensor_inputs=torch.stack([inputs[s].view(-1, inputs[s].shape[-1])[pixels] for s in depths], 1).half(),
    )
