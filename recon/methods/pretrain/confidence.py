"""Training of the confidence network of a sensor; docs/baselines.md, `nice-slam-pre`."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, conv2d

from ...core.errors import ConfigError, DataError
from ...core.events import OnEvent, Progress, ignore
from ...core.files import DEPTH_UNITS_PER_M
from ..confidence.network import SMALLEST_SIDE, ConfidenceNetwork, channels_last
from .depth_pairs import DepthPairs

NEAREST_M, FARTHEST_M = 0.05, 12.3  # true depths that count
BORDER_PX = 10
MAX_LOSS = 10.0
_CHECKS = 20  # validations in a training
_WARM_UP = 50  # steps: RMSprop's first ones are many times too large, and could kill the last ReLU
_SOBEL = torch.tensor([[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]]) / 8


@dataclass(frozen=True)
class ConfidenceTraining:
    """How long and how fast; RMSprop's alpha 0.95, eps 1e-7, momentum 0.9 are the reference's.

    Its weight decay of 0.01 is left out: the gradients of a loss in metres are smaller than that, and the first layers
    fade to nothing. The reference takes whole images of 512 pixels, batch 2, 16 batches a step, and 1e-5 for up to 1000
    epochs; these defaults see fewer pixels in larger steps that shrink to a tenth.
    """

    steps: int = 1500
    batch: int = 8
    crop_px: int = 96
    accumulate: int = 1
    learning_rate: float = 5e-5
    penalty: float = 0.015  # lambda; RoutedFusion's, effective. SenFuNet: 0.06
    seed: int = 0
    max_seconds: float = math.inf  # ends earlier, and with another result on another machine


@dataclass(frozen=True)
class TrainedConfidence:
    """network; loss of the pixels held back at each check; steps that were made."""

    network: ConfidenceNetwork
    validation: list[float]
    steps: int

    def recipe(self, pairs: DepthPairs, settings: ConfidenceTraining) -> dict[str, Any]:
        """What the network was made with, for its file: plain numbers and strings."""
        facts = {"frames": len(pairs), "recordings": len(set(pairs.scene.tolist())), "steps_made": self.steps}
        return asdict(settings) | facts | {"validation": [round(loss, 5) for loss in self.validation]}


def confidence_loss(s: Tensor, reading: Tensor, truth: Tensor, mask: Tensor, penalty: float) -> Tensor:
    """Mean over the pixels of `mask` of exp(-s) (|D - D_gt| + |grad D - grad D_gt|_1) + penalty * s, at most 10.

    All (N, 1, H, W): s >= 0, depths in metres, mask bool. Gradients are Sobel / 8, taken where a pixel and its eight
    neighbours are in the mask. RoutedFusion's loss, with the measured depth in place of the depth of its other head.
    """
    error = (reading - truth) * mask
    kernels = torch.stack([_SOBEL, _SOBEL.T])[:, None].to(error)
    whole = avg_pool2d(mask.float(), 3, stride=1, padding=1) > 1 - 1e-4
    slope = conv2d(error, kernels, padding=1).abs().sum(1, keepdim=True) * whole
    each = torch.exp(-s) * (error.abs() + slope) + penalty * s
    return ((each * mask).sum() / mask.sum().clamp(min=1)).clamp(max=MAX_LOSS)


def train_confidence(
    pairs: DepthPairs, settings: ConfidenceTraining, device: str = "cpu", on_event: OnEvent = ignore
) -> TrainedConfidence:
    """A network for the sensor of `pairs`: of all checks the one with the best loss on frames held back.

    Those are the frames of the last recording, or the last fifth where there is only one. Raises DataError.
    """
    images = _Images(pairs, settings, device)
    network = channels_last(ConfidenceNetwork(torch.Generator().manual_seed(settings.seed)).to(device))
    optimizer = torch.optim.RMSprop(network.parameters(), lr=settings.learning_rate, alpha=0.95, eps=1e-7, momentum=0.9)
    best, best_state, history = math.inf, copy.deepcopy(network.state_dict()), []
    stage, began, share, step = f"training {pairs.sensor}", time.monotonic(), 0.0, 0
    while share < 1:
        on_event(Progress(stage, step, settings.steps, "steps"))
        for group in optimizer.param_groups:
            group["lr"] = settings.learning_rate * (1 - 0.9 * share) * min(1.0, (step + 1) / _WARM_UP)
        for _ in range(settings.accumulate):
            loss = confidence_loss_of(network, images.batch(), settings.penalty)
            (loss / settings.accumulate).backward()
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        step += 1
        share, before = max(step / settings.steps, (time.monotonic() - began) / settings.max_seconds), share
        if int(share * _CHECKS) > int(before * _CHECKS):
            history.append(images.validation_loss(network))
            if history[-1] < best:
                best, best_state = history[-1], copy.deepcopy(network.state_dict())
    on_event(Progress(stage, settings.steps, settings.steps, "steps"))
    network.load_state_dict(best_state)
    return TrainedConfidence(network.cpu(), history, step)


def confidence_loss_of(network: ConfidenceNetwork, batch: tuple[Tensor, Tensor, Tensor], penalty: float) -> Tensor:
    """The loss of a network on (reading, truth, mask)."""
    reading, truth, mask = batch
    return confidence_loss(network(reading), reading, truth, mask, penalty)


class _Images:
    """Measurements and truth on the device, those held back apart; draws crops."""

    def __init__(self, pairs: DepthPairs, settings: ConfidenceTraining, device: str) -> None:
        height, width = pairs.truth.shape[1:]
        self.settings, self.side = settings, min(settings.crop_px, height, width)
        if self.side < SMALLEST_SIDE or min(height, width) <= 2 * BORDER_PX:
            raise ConfigError(f"images of {width} x {height} px in crops of {self.side}: too small to learn from")
        held = held_out(pairs.scene)
        if held.all():
            raise DataError("two frames are needed at least: one to learn from and one to check on")
        self.reading = torch.from_numpy(pairs.reading).to(device)
        self.truth = torch.from_numpy(pairs.truth).to(device)
        self.train, self.held = np.flatnonzero(~held).tolist(), np.flatnonzero(held).tolist()
        self.inside = torch.zeros(height, width, dtype=torch.bool, device=device)
        self.inside[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
        self.generator = torch.Generator().manual_seed(settings.seed)

    def batch(self) -> tuple[Tensor, Tensor, Tensor]:
        """Random crops of random frames: reading, truth (B, 1, S, S) metres, mask."""
        return self._cut(*self._draw(self.train, self.settings.batch, self.generator))

    @torch.no_grad()
    def validation_loss(self, network: ConfidenceNetwork) -> float:
        """Mean over fixed crops of the frames held back."""
        generator = torch.Generator().manual_seed(1)
        losses = []
        for _ in range(8):
            crops = self._cut(*self._draw(self.held, self.settings.batch, generator))
            losses.append(confidence_loss_of(network, crops, self.settings.penalty))
        return float(torch.stack(losses).mean())

    def _draw(
        self, frames: list[int], count: int, generator: torch.Generator
    ) -> tuple[list[int], list[int], list[int]]:
        height, width = self.inside.shape
        picks = torch.randint(len(frames), (count,), generator=generator).tolist()
        rows = torch.randint(height - self.side + 1, (count,), generator=generator).tolist()
        columns = torch.randint(width - self.side + 1, (count,), generator=generator).tolist()
        return [frames[pick] for pick in picks], rows, columns

    def _cut(self, frames: list[int], rows: list[int], columns: list[int]) -> tuple[Tensor, Tensor, Tensor]:
        def crops(image_of: Callable[[int], Tensor]) -> Tensor:
            parts = [
                image_of(f)[y : y + self.side, x : x + self.side] for f, y, x in zip(frames, rows, columns, strict=True)
            ]
            return torch.stack(parts)[:, None]

        reading = crops(lambda frame: self.reading[frame]).float() / DEPTH_UNITS_PER_M
        truth = crops(lambda frame: self.truth[frame]).float() / DEPTH_UNITS_PER_M
        mask = crops(lambda frame: self.inside) & (reading > 0) & (truth >= NEAREST_M) & (truth <= FARTHEST_M)
        return reading, truth, mask


def held_out(scene: np.ndarray) -> np.ndarray:
    """(N,) bool of frames that nothing is learned from: the last recording, or the last fifth of a single one."""
    if scene.max() > scene.min():
        return scene == scene.max()
    return np.arange(len(scene)) >= len(scene) - max(1, len(scene) // 5)
