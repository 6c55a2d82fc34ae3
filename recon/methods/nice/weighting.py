"""Losses and weights of depth and colour: unit weights (NICE-SLAM) or a learned error scale (UncLe-SLAM).

See docs/uncle-paper.md, Losses. Losses are sums over rays. `residuals` (N, K) metres are |D - D-hat| of N rays and K
sensors; `valid` (N, K) says whether there is a depth and the ray takes part.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor, nn

from ...core.camera import Camera
from ...core.config.nice import NiceConfig, NiceTrackingConfig
from ...core.frame import Frame
from .noise import COLOR_INPUTS, PATCH, NoiseNet, noise_inputs
from .scene import Stage
from .views import Rays

VARIANCE_FLOOR = 1e-10  # metres^2, added to the rendered variance under the root; released code
PIXELS_AT_A_TIME = 1 << 15
COLOR_NETWORK = "color"  # names of networks: this, and "depth/" with the name of the sensor

Normals = Callable[[int, str], Tensor]  # frame index, sensor -> (H, W, 3)


class Weighting(Protocol):
    """How depth and colour errors enter the losses of mapping and tracking.

    patch_size    side of the patch of a sensor's image that the weight of a pixel depends on, pixels
    color_patch   the same of the colour image; 0: none
    learns_noise  whether `betas` returns error scales
    """

    patch_size: int
    color_patch: int
    learns_noise: bool

    def weighting_inputs(self, frame: Frame, normals: Normals) -> Tensor:
        """Per-pixel inputs (K, C, H, W) of the weights, from the images of the K sensors; C may be 0."""

    def depth_loss(self, residuals: Tensor, valid: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """Mapping loss of depth."""

    def color_loss(self, errors: Tensor, colors: Tensor, used: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """Mapping loss of colour; errors (N,) = |I - I-hat| summed over channels, colors (N, 3) measured, used (N,)."""

    def residual_scale(self, spread: Tensor, rays: Rays) -> Tensor:
        """Denominator (N, K) of depth residuals in the tracking loss, metres; spread (N,) = S-hat, metres."""

    def color_factor(self, rays: Rays) -> Tensor | float:
        """Factor (N,) of colour errors in the tracking loss."""

    def betas(self, frame: Frame, weighting_inputs: Tensor) -> dict[str, Tensor]:
        """Error scale of each sensor's depth image, (H, W) metres, 0 where there is no depth."""

    def networks(self) -> dict[str, nn.Module]:
        """Networks that mapping trains, by name."""

    def mean_nll(self) -> dict[str, float]:
        """Mean negative log-likelihood of depth in the last loss, by sensor, nats; waits for the device."""


class UniformWeighting:
    """NICE-SLAM: unit weights of depth, and a fixed weight of colour, which counts in the colour stage only."""

    patch_size, color_patch, learns_noise = 1, 0, False

    def __init__(self, config: NiceConfig, tracking: NiceTrackingConfig) -> None:
        self.config, self.tracking = config, tracking

    def weighting_inputs(self, frame: Frame, normals: Normals) -> Tensor:
        """None: (K, 0, H, W)."""
        height, width = frame.color.shape[:2]
        return torch.zeros(len(frame.depths), 0, height, width)

    def confidence(self, rays: Rays) -> Tensor | float:
        """Factor (N, K) of the residuals."""
        return 1.0

    def depth_loss(self, residuals: Tensor, valid: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """Sum of |D - D-hat|."""
        return (self.confidence(rays) * residuals * valid).sum()

    def color_loss(self, errors: Tensor, colors: Tensor, used: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """Weighted sum of the errors in the colour stage, else 0."""
        return self.config.color_weight * (errors * used).sum() * (stage == "color")

    def residual_scale(self, spread: Tensor, rays: Rays) -> Tensor:
        """S-hat, divided by the confidence."""
        floored = (spread.square() + VARIANCE_FLOOR).sqrt()
        return floored[:, None].expand(-1, rays.depths.shape[1]) / self.confidence(rays)

    def color_factor(self, rays: Rays) -> Tensor | float:
        """A constant."""
        return self.tracking.color_weight

    def betas(self, frame: Frame, weighting_inputs: Tensor) -> dict[str, Tensor]:
        """None: no error scale is learned."""
        return {}

    def networks(self) -> dict[str, nn.Module]:
        """None."""
        return {}

    def mean_nll(self) -> dict[str, float]:
        """None: the loss is no likelihood."""
        return {}


class LaplaceWeighting:
    """UncLe-SLAM: |r| / beta + log beta, with beta = beta_min + softplus(h_w(patch)) per sensor and for colour."""

    color_patch, learns_noise = PATCH, True

    def __init__(
        self, config: NiceConfig, sensors: tuple[str, ...], camera: Camera, generator: torch.Generator,
        device: torch.device,
    ) -> None:  # fmt: skip
        self.config, self.sensors, self.camera = config, sensors, camera
        self.patch_size: int = config.noise_patch
        patch = self.patch_size
        self.depth_networks = [NoiseNet(config.noise_features, generator, patch).to(device) for _ in sensors]
        self.color_network = NoiseNet(COLOR_INPUTS, generator).to(device)
        self._mean_nll: Tensor | None = None

    def weighting_inputs(self, frame: Frame, normals: Normals) -> Tensor:
        """Inputs (K, 2 or 7, H, W) of h_w; see `noise_inputs`."""
        count, released = self.config.noise_features, self.config.reproduce_released_code
        images = [
            noise_inputs(depth, normals(frame.index, sensor), self.camera, count, released)
            for sensor, depth in frame.depths.items()
        ]
        return torch.stack(images)

    def depth_loss(self, residuals: Tensor, valid: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """Unit weights in the middle stage, afterwards the Laplace likelihood without its constant log 2."""
        if stage == "middle":
            return (residuals * valid).sum()
        beta = self.config.beta_min_m + self._softplus(rays)
        loss = (residuals / beta + torch.log(beta)) * valid
        counts = valid.sum(0).clamp(min=1)
        self._mean_nll = (loss.detach().sum(0) / counts) + math.log(2)
        return loss.sum()

    def color_loss(self, errors: Tensor, colors: Tensor, used: Tensor, rays: Rays, stage: Stage) -> Tensor:
        """Laplace likelihood of colour in the colour stage.

        The released code also fits beta to a black image in the fine stage (docs/uncle-paper.md, difference 8).
        """
        if stage == "middle" or (stage == "fine" and not self.config.reproduce_released_code):
            return errors.new_zeros(())
        if stage == "fine":
            errors = colors.sum(1)
        beta = self._color_beta(rays)
        return ((errors / beta + torch.log(beta)) * used).sum()

    @torch.no_grad()
    def residual_scale(self, spread: Tensor, rays: Rays) -> Tensor:
        """S-hat + beta; the released code leaves beta_min out (docs/uncle-paper.md, difference 3)."""
        softplus = self._softplus(rays)
        if self.config.reproduce_released_code:
            return (spread.square() + VARIANCE_FLOOR).sqrt()[:, None] + softplus
        return spread[:, None] + self.config.beta_min_m + softplus

    @torch.no_grad()
    def color_factor(self, rays: Rays) -> Tensor | float:
        """1 / beta of colour."""
        return 1 / self._color_beta(rays)

    @torch.no_grad()
    def betas(self, frame: Frame, weighting_inputs: Tensor) -> dict[str, Tensor]:
        """Beta of every pixel by sensor, (H, W) metres, 0 where there is no depth."""
        betas: dict[str, Tensor] = {}
        patch = self.patch_size
        for sensor, images, network in zip(self.sensors, weighting_inputs, self.depth_networks, strict=True):
            depth = images[0]
            wrapped = torch.nn.functional.pad(images[None], (patch // 2,) * 4, mode="circular")
            patches = torch.nn.functional.unfold(wrapped, patch)[0].T  # (H * W, F * patch^2), feature by feature
            softplus = torch.cat([network(part) for part in patches.split(PIXELS_AT_A_TIME)]).view(depth.shape)
            betas[sensor] = (self.config.beta_min_m + softplus) * (depth > 0)
        return betas

    def networks(self) -> dict[str, nn.Module]:
        """h_w of each sensor and of colour."""
        depth = zip((f"depth/{sensor}" for sensor in self.sensors), self.depth_networks, strict=True)
        return {**dict(depth), COLOR_NETWORK: self.color_network}

    def mean_nll(self) -> dict[str, float]:
        """By sensor, nats; empty before the first fine stage."""
        return {} if self._mean_nll is None else dict(zip(self.sensors, self._mean_nll.tolist(), strict=True))

    def _softplus(self, rays: Rays) -> Tensor:
        """(N, K) beta - beta_min, metres."""
        return torch.stack([net(rays.weighting_inputs[:, k]) for k, net in enumerate(self.depth_networks)], 1)

    def _color_beta(self, rays: Rays) -> Tensor:
        return self.config.beta_min_m + self.color_network(rays.color_patches)
