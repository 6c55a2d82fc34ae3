"""What was read along rays, how noisy each reading is and what it counts: what the refinement fits the field to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ...mvs.photometric_depth import PhotometricDepth
from ...sensors.noise_model import START_BETA_M, NoiseModel
from .ray_buffer import RayBuffer


@dataclass(frozen=True)
class RayBatch:
    """N rays with readings of K sources along each.

    origins, directions (N, 3) world, a direction goes 1 metre of depth far; depths (N, K) metres, 0 = no reading;
    betas (N, K) metres; worth (K,) readings of colour that one of each source counts as; colors (N, 3) uint8 RGB, None:
    the rays say nothing of the colour of the surface.
    """

    origins: Tensor
    directions: Tensor
    depths: Tensor
    betas: Tensor
    worth: Tensor
    colors: Tensor | None = None

    def __len__(self) -> int:
        return len(self.depths)

    def at(self, rows: Tensor) -> RayBatch:
        """Those of some `rows` (B,)."""
        colors = None if self.colors is None else self.colors[rows]
        fields = (self.origins, self.directions, self.depths, self.betas)
        return RayBatch(*(values[rows] for values in fields), self.worth, colors)

    @staticmethod
    def of_sensors(rays: RayBuffer, noise: Mapping[str, NoiseModel], worth: Mapping[str, float]) -> RayBatch:
        """Of the pixels of the keyframes, by what the noise models say now."""
        depths = rays["depths"]
        betas = [
            _betas(model, depths[:, column], rays["features"][:, column]) for column, model in enumerate(noise.values())
        ]
        counts = depths.new_tensor([worth[sensor] for sensor in noise])
        return RayBatch(rays["origins"], rays["directions"], depths, torch.stack(betas, 1), counts, rays["colors"])

    @staticmethod
    def of_color(witness: PhotometricDepth, device: torch.device) -> RayBatch:
        """Of the pixels at which the witness, which says something, was confronted with the sensors and the map."""
        told = witness.samples
        columns = (witness.origins(), told["directions"], told["color"][:, None], told["beta"].float()[:, None])
        return RayBatch(*(values.to(device) for values in columns), torch.ones(1, device=device))


def _betas(model: NoiseModel, depth: Tensor, features: Tensor) -> Tensor:
    """(N,) metres; `START_BETA_M` where nothing is known of the pixels, since the uncertainty is off."""
    known = features.shape[-1] > 0
    return model.beta_image(depth, features.float()) if known else torch.full_like(depth, START_BETA_M)
