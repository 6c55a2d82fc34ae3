"""What a reading weighs in the losses: as much as any other, as its learned beta allows, or as its confidence.

METHOD, Mapping (loss), Tracking, Baselines. Losses are sums over rays. `residuals` (N, K) metres are |D - D-hat| of K
sensors, `valid` (N, K) whether there is a reading and the ray takes part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor, nn

from ...core.camera import Camera
from ...core.config.nice import NiceConfig, NiceTrackingConfig
from ...core.frame import Frame
from .noise import COLOR_INPUTS, PATCH, NoiseNet, noise_images
from .scene import Stage
from .views import Rays

SPREAD_FLOOR = 1e-10  # metres^2, under the root of the rendered variance

Normals = Callable[[int, str], Tensor]  # frame index, sensor -> (H, W, 3)


class Weighting(Protocol):
    """patch_size, color_patch: pixels along the side of the patch around a pixel that it sees, 0: none of colour."""

    patch_size: int
    color_patch: int
    learns: bool  # whether `betas` says anything

    def weighting_inputs(self, frame: Frame, normals: Normals) -> Tensor:
        """(K, C, H, W): what it sees of the images of the K sensors of a frame, made in the background."""

    def depth_loss(self, residuals: Tensor, valid: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """The mapping loss of depth."""

    def color_loss(self, errors: Tensor, colors: Tensor, used: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """That of colour: errors (N,) |I - I-hat| summed over channels, colors (N, 3) as seen."""

    def spread(self, spread: Tensor, rays: Rays) -> Tensor:
        """Denominator (N, K) of depth in the tracking loss, from the rendered spread S-hat (N,) metres."""

    def color_scale(self, rays: Rays) -> Tensor | float:
        """Factor (N,) of the colour errors in the tracking loss."""

    def betas(self, frame: Frame, weighting_inputs: Tensor) -> dict[str, Tensor]:
        """By sensor (H, W) metres, 0 where there is no reading."""

    def nets(self) -> dict[str, nn.Module]:
        """Networks that mapping trains, by name."""

    def nats(self) -> dict[str, float]:
        """Mean negative log-likelihood of the readings in the last loss, by sensor; waits for the device."""


class UniformWeighting:
    """NICE-SLAM: every reading alike; a fixed weight of colour, which counts in the colour stage alone."""

    patch_size, color_patch, learns = 1, 0, False

    def __init__(self, config: NiceConfig, tracking: NiceTrackingConfig) -> None:
        self.config, self.tracking = config, tracking

    def weighting_inputs(self, frame: Frame, normals: Normals) -> Tensor:
        height, width = frame.color.shape[:2]
        return torch.zeros(len(frame.depths), 0, height, width)

    def confidence(self, rays: Rays) -> Tensor | float:
        """(N, K) factor of the residuals."""
        return 1.0

    def depth_loss(self, residuals: Tensor, valid: Tensor, rays: Rays, stage: Stage) -> Tensor:
        return (self.confidence(rays) * residuals * valid).sum()

    def color_loss(self, errors: Tensor, colors: Tensor, used: Tensor, rays: Rays, stage: Stage) -> Tensor:
        return self.config.color_weight * (errors * used).sum() * (stage == "color")

    def spread(self, spread: Tensor, rays: Rays) -> Tensor:
        floored = (spread.square() + SPREAD_FLOOR).sqrt()
        return floored[:, None].expand(-1, rays.depths.shape[1]) / self.confidence(rays)

    def color_scale(self, rays: Rays) -> Tensor | float:
        return self.tracking.color_weight

    def betas(self, frame: Frame, weighting_inputs: Tensor) -> dict[str, Tensor]:
        return {}

    def nets(self) -> dict[str, nn.Module]:
        return {}

    def nats(self) -> dict[str, float]:
        return {}


class LaplaceWeighting:
    """The paper: |r| / beta + log beta with beta = beta_min + softplus(h_w(patch)), of each sensor and of colour."""

    color_patch, learns = PATCH, True

    def __init__(
        self, config: NiceConfig, sensors: tuple[str, ...], camera: Camera, generator: torch.Generator,
        device: torch.device,
    ) -> None:  # fmt: skip
        self.config, self.sensors, self.camera = config, sensors, camera
        self.patch_size: int = config.noise_patch
        patch = self.patch_size
        self.depth_nets = [NoiseNet(config.noise_features, generator, patch).to(device) for _ in sensors]
        self.color_net = NoiseNet(COLOR_INPUTS, generator).to(device)
        self._nats: Tensor | None = None

    def weighting_inputs(self, frame: Frame, normals: Normals) -> Tensor:
        count, reproduce_released_code = self.config.noise_features, self.config.reproduce_released_code
        images = [
            noise_images(depth, normals(frame.index, sensor), self.camera, count, reproduce_released_code)
            for sensor, depth in frame.depths.items()
        ]
        return torch.stack(images)

    def depth_loss(self, residuals: Tensor, valid: Tensor, rays: Rays, stage: Stage) -> Tensor:
        if stage == "middle":
            return (residuals * valid).sum()
        beta = self.config.beta_min_m + self._raw(rays)
        loss = (residuals / beta + torch.log(beta)) * valid
        counts = valid.sum(0).clamp(min=1)
        self._nats = (loss.detach().sum(0) / counts) + 0.6931472  # log 2: a true likelihood
        return loss.sum()

    def color_loss(self, errors: Tensor, colors: Tensor, used: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """In the fine stage the published code fits beta to an image that is still black (D11); the paper does not."""
        if stage == "middle" or (stage == "fine" and not self.config.reproduce_released_code):
            return errors.new_zeros(())
        if stage == "fine":
            errors = colors.sum(1)
        beta = self._color_beta(rays)
        return ((errors / beta + torch.log(beta)) * used).sum()

    @torch.no_grad()
    def spread(self, spread: Tensor, rays: Rays) -> Tensor:
        raw = self._raw(rays)
        if self.config.reproduce_released_code:  # D3
            return (spread.square() + SPREAD_FLOOR).sqrt()[:, None] + raw
        return spread[:, None] + self.config.beta_min_m + raw

    @torch.no_grad()
    def color_scale(self, rays: Rays) -> Tensor | float:
        return 1 / self._color_beta(rays)

    @torch.no_grad()
    def betas(self, frame: Frame, weighting_inputs: Tensor) -> dict[str, Tensor]:
        found, patch = {}, self.patch_size
        for sensor, images, net in zip(self.sensors, weighting_inputs, self.depth_nets, strict=True):
            depth = images[0]
            wrapped = torch.nn.functional.pad(images[None], (patch // 2,) * 4, mode="circular")
            patches = torch.nn.functional.unfold(wrapped, patch)[0].T  # (H * W, F * patch^2), feature by feature
            raw = torch.cat([net(part) for part in patches.split(1 << 15)]).view(depth.shape)
            found[sensor] = (self.config.beta_min_m + raw) * (depth > 0)
        return found

    def nets(self) -> dict[str, nn.Module]:
        return {**dict(zip(self.sensors, self.depth_nets, strict=True)), " color": self.color_net}

    def nats(self) -> dict[str, float]:
        return {} if self._nats is None else dict(zip(self.sensors, self._nats.tolist(), strict=True))

    def _raw(self, rays: Rays) -> Tensor:
        return torch.stack([net(rays.weighting_inputs[:, k]) for k, net in enumerate(self.depth_nets)], 1)

    def _color_beta(self, rays: Rays) -> Tensor:
        return self.config.beta_min_m + self.color_net(rays.color_patches)
