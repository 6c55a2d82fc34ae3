"""Rays with depths, their error scales and weights: what the refinement fits the field to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ...mvs.photometric_samples import PhotometricSamples
from ...sensors.noise_model import START_BETA_M, NoiseModel
from .ray_buffer import Rays


@dataclass(frozen=True)
class RayBatch:
    """N rays with the measurements of K sources along each.

    origins, directions (N, 3) in world axes, a direction advances by 1 metre of z-depth; depths (N, K) metres, 0 = no
    measurement; betas (N, K) metres; reliability (K,): weight factor of each source; colors (N, 3) uint8 RGB, None if
    the colour of the surface is not to be fitted.
    """

    origins: Tensor
    directions: Tensor
    depths: Tensor
    betas: Tensor
    reliability: Tensor
    colors: Tensor | None = None

    def __len__(self) -> int:
        return len(self.depths)

    def at(self, rows: Tensor) -> RayBatch:
        """Some `rows` (B,)."""
        colors = None if self.colors is None else self.colors[rows]
        return RayBatch(
            self.origins[rows], self.directions[rows], self.depths[rows], self.betas[rows], self.reliability, colors
        )


def sensor_rays(rays: Rays, noise: Mapping[str, NoiseModel], reliability: Mapping[str, float]) -> RayBatch:
    """Keyframe rays with the current noise models; the sources are the sensors of `rays`.

    After bias correction these betas are too large: they describe measurements as recorded. The weight of photometric
    depth beside a biased sensor is larger accordingly.
    """
    betas = [_betas(noise[sensor], *rays.measured_by(sensor)) for sensor in rays.sensors]
    factors = rays.depths.new_tensor([reliability[sensor] for sensor in rays.sensors])
    return RayBatch(rays.origins, rays.directions, rays.depths, torch.stack(betas, 1), factors, rays.colors)


def photometric_rays(samples: PhotometricSamples, device: torch.device) -> RayBatch:
    """Rays of the photometric samples; the only source is photometric depth."""
    return RayBatch(
        origins=samples.origins.to(device),
        directions=samples.directions.to(device),
        depths=samples.depth[:, None].to(device),
        betas=samples.beta.float()[:, None].to(device),
        reliability=torch.ones(1, device=device),
    )


def _betas(model: NoiseModel, depth: Tensor, inputs: Tensor) -> Tensor:
    """(N,) metres; `START_BETA_M` without inputs, as the uncertainty is off."""
    known = inputs.shape[-1] > 0
    return model.beta_image(depth, inputs.float()) if known else torch.full_like(depth, START_BETA_M)
