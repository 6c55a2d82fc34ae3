"""Training of SenFuNet's networks for a pair of sensors; docs/baselines.md, `senfunet`."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from ...core.events import OnEvent, Progress, ignore
from ...volume.sparse_grid import unique_blocks
from ..senfunet.blending import fused_distance, single_sensor, weighting_inputs
from ..senfunet.bricks import BRICK, brick_samples, inner_part
from ..senfunet.models import SenfunetModel
from ..senfunet.sensor_grid import SensorGrid, Update, ray_samples
from .senfunet_scenes import Scene

BOTH_WEIGHT, SINGLE_WEIGHT, OUTLIER_WEIGHT = 6.0, 0.01, 10.0
REFERENCE_TRUNCATION_M = 0.05  # distances are scaled as if this were the truncation, so that the weights above hold
OUTLIER_SHARE = 0.8  # of the truncation: 0.04 m of 0.05 m
RESET_SHARE = 0.01
MAX_GRADIENT = 1.0


@dataclass(frozen=True)
class SenfunetTraining:
    """How long and how fast, with Adam. The reference: 1e-4, 20 frames a step, steps of the learning rate; these
    defaults make fewer and larger steps that shrink to a tenth."""

    frames: int = 600
    accumulate: int = 4
    learning_rate: float = 2e-3
    bricks: int = 16
    seed: int = 0
    max_seconds: float = math.inf  # ends earlier, and with another result on another machine


@dataclass(frozen=True)
class TrainedSenfunet:
    """model; the loss of each step; mean errors, metres, in the scene that nothing was learned from, by name."""

    model: SenfunetModel
    losses: list[float]
    errors: dict[str, float]
    frames: int

    def recipe(self, scenes: Sequence[Scene], settings: SenfunetTraining) -> dict[str, Any]:
        """What the networks were made with, for their file."""
        facts = {"scenes": len(scenes), "frames_seen": self.frames}
        return asdict(settings) | facts | {name: round(error, 5) for name, error in self.errors.items()}


def train_senfunet(
    scenes: Sequence[Scene], sensors: tuple[str, str], settings: SenfunetTraining, device: str = "cpu",
    on_event: OnEvent = ignore,
) -> TrainedSenfunet:  # fmt: skip
    """Networks for `sensors`. The last of several scenes is only measured.

    Scene after scene, from empty maps: each frame is fused, with gradient through its own features, and the samples of
    some bricks around it are compared with the true distance.
    """
    generator = torch.Generator().manual_seed(settings.seed)
    model = SenfunetModel.fresh(sensors, scenes[0].truth.voxel_size_m, generator).to(device)
    parameters = [values for network in model.networks() for values in network.parameters()]
    optimizer = torch.optim.Adam(parameters, lr=settings.learning_rate)
    learned = list(scenes[:-1]) or list(scenes)
    stage, began, share, done, losses = f"training {'+'.join(sensors)}", time.monotonic(), 0.0, 0, []
    while share < 1:
        scene = learned[int(torch.randint(len(learned), (1,), generator=generator))]
        maps = PairMaps(scene, model, device)
        for index in torch.randperm(len(scene), generator=generator).tolist():
            on_event(Progress(stage, done, settings.frames))
            if float(torch.rand((), generator=generator)) < RESET_SHARE:
                maps.clear()
            loss = maps.learn(index, settings.bricks, generator)
            if loss is not None:
                (loss / settings.accumulate).backward()
                losses.append(float(loss.detach()))
            done += 1
            if done % settings.accumulate == 0:
                clip_grad_norm_(parameters, MAX_GRADIENT)
                for group in optimizer.param_groups:
                    group["lr"] = settings.learning_rate * (1 - 0.9 * share)
                optimizer.step()
                optimizer.zero_grad(set_to_none=True)
            share = max(done / settings.frames, (time.monotonic() - began) / settings.max_seconds)
            if share >= 1:
                break
    on_event(Progress(stage, settings.frames, settings.frames))
    errors = measure(scenes[-1], model, device)
    return TrainedSenfunet(model.to("cpu"), losses, errors, done)


@torch.no_grad()
def measure(scene: Scene, model: SenfunetModel, device: str = "cpu", bricks: int = 400) -> dict[str, float]:
    """Fuse a scene and compare with the truth where both sensors read something: mean errors in metres of each sensor,
    of the mean of both, and of the learned fusion; and how many right and wrong single measurements are kept."""
    maps = PairMaps(scene, model, device)
    for index in range(len(scene)):
        maps.apply(maps.updates(index))
    chosen = maps.observed_bricks()
    chosen = chosen[torch.randperm(len(chosen), generator=torch.Generator().manual_seed(0))[:bricks]]
    parts = [maps.samples(part) for part in chosen.split(16)]
    alpha, first, second, w1, w2, truth = (torch.cat([part[i] for part in parts]) for i in range(6))
    both, scale = (w1 > 0) & (w2 > 0), maps.truth.truncation_m
    fused = fused_distance(alpha, first, second, w1, w2)
    named = {model.sensors[0]: first, model.sensors[1]: second, "mean": (first + second) / 2, "learned": fused}
    errors = {f"error_{name}_m": float((sdf - truth)[both].abs().mean()) for name, sdf in named.items()}
    for mask, own, sdf in zip(single_sensor(w1, w2), (alpha, 1 - alpha), (first, second), strict=True):
        wrong = is_outlier(sdf[mask], truth[mask], scale)
        kept = own[mask] > 0.5
        for name, group in (("right", ~wrong), ("wrong", wrong)):
            errors[f"{name}_kept"] = errors.get(f"{name}_kept", 0.0) + float((kept & group).sum())
            errors[f"{name}_alone"] = errors.get(f"{name}_alone", 0.0) + float(group.sum())
    return errors


def senfunet_loss(
    alpha: Tensor, first: Tensor, second: Tensor, weight_1: Tensor, weight_2: Tensor, truth: Tensor, truncation_m: float
) -> Tensor:
    """6 |sdf - truth| where both sensors have measurements, and 0.01 |own share - right| where one has; (N,) each.

    A sample of one sensor is wrong if its error exceeds 0.8 of the truncation, with the wrong sign; wrong ones have ten
    times the weight. Distances are scaled to the reference's truncation of 0.05 m. The source is SenFuNet.
    """
    both = (weight_1 > 0) & (weight_2 > 0)
    scale = REFERENCE_TRUNCATION_M / truncation_m
    error = (alpha * first + (1 - alpha) * second - truth).abs() * scale
    loss = BOTH_WEIGHT * _mean(error[both])
    for mask, own, sdf in zip(single_sensor(weight_1, weight_2), (alpha, 1 - alpha), (first, second), strict=True):
        wrong = is_outlier(sdf[mask], truth[mask], truncation_m)
        miss = torch.where(wrong, OUTLIER_WEIGHT * own[mask], 1 - own[mask])
        loss = loss + SINGLE_WEIGHT * _mean(miss)
    return loss


def is_outlier(sdf: Tensor, truth: Tensor, truncation_m: float) -> Tensor:
    """Distances that are far off and say the wrong side."""
    return ((sdf - truth).abs() > OUTLIER_SHARE * truncation_m) & (sdf * truth < 0)


class PairSamples(NamedTuple):
    """N samples of both maps, in the order of `senfunet_loss`; all (N,) float32.

    alpha             share of the first sensor, 0..1
    first, second     signed distances of the sensors, metres
    weight_1, weight_2   their numbers of measurements, 0 = none
    truth             true signed distances, metres
    """

    alpha: Tensor
    first: Tensor
    second: Tensor
    weight_1: Tensor
    weight_2: Tensor
    truth: Tensor


class PairMaps:
    """The maps of both sensors over the box of a scene's true distances."""

    def __init__(self, scene: Scene, model: SenfunetModel, device: str) -> None:
        self.scene, self.model, self.device, self.truth = scene, model, device, scene.truth
        self.shape = torch.tensor(self.truth.steps.shape, device=device)
        self.first = torch.from_numpy(self.truth.first).to(device)
        self.steps = torch.from_numpy(self.truth.steps).to(device).view(-1)
        self.maps = [SensorGrid(self.steps.numel(), device) for _ in model.sensors]
        self._rays = scene.camera.rays(device)

    def clear(self) -> None:
        """Remove all measurements from both maps."""
        for sensor_map in self.maps:
            sensor_map.clear()

    def learn(self, index: int, bricks: int, generator: torch.Generator) -> Tensor | None:
        """Fuse a frame; the loss of some bricks around its measurements, None if it has no measurement in the box."""
        updates = self.updates(index)
        touched = [self._bricks(update.rows) for update in updates if len(update.rows)]
        if not touched:
            return None
        distinct = unique_blocks(torch.cat(touched))
        chosen = distinct[torch.randperm(len(distinct), generator=generator)[:bricks].to(self.device)]
        loss = senfunet_loss(*self.samples(chosen, updates), self.truth.truncation_m)
        self.apply(updates)
        return loss

    def updates(self, index: int) -> list[Update]:
        """What each map becomes with a frame."""
        pose = torch.from_numpy(self.scene.T_world_camera[index]).float().to(self.device)
        color = self.scene.color(index).to(self.device).float().permute(2, 0, 1)[None] / 255
        before = round(self.truth.truncation_m / self.truth.voxel_size_m)
        made = []
        for sensor, sensor_map in zip(self.model.sensors, self.maps, strict=True):
            depth = self.scene.depth(index, sensor).to(self.device)
            samples = ray_samples(depth, self._rays, pose, self.truth.voxel_size_m, before)
            features = self.model.features[sensor](depth[None, None], color)[0].permute(1, 2, 0)
            rows = self.rows(samples.voxels)
            made.append(sensor_map.with_measurements(rows, samples.sdf, features.reshape(-1, 4)[samples.pixels]))
        return made

    def apply(self, updates: list[Update]) -> None:
        """Store `updates`, one for each map, without gradient."""
        for sensor_map, update in zip(self.maps, updates, strict=True):
            sensor_map.apply(update)

    def rows(self, samples: Tensor) -> Tensor:
        """(..., 3) int64 samples -> (...) rows, -1 outside of the box."""
        local = samples - self.first
        inside = ((local >= 0) & (local < self.shape)).all(-1)
        flat = (local[..., 0] * self.shape[1] + local[..., 1]) * self.shape[2] + local[..., 2]
        return torch.where(inside, flat, -1)

    def observed_bricks(self) -> Tensor:
        """(B, 3) bricks with a measurement."""
        rows = ((self.maps[0].weight > 0) | (self.maps[1].weight > 0)).nonzero()[:, 0]
        return self._bricks(rows)

    def samples(self, bricks: Tensor, updates: list[Update] | None = None) -> PairSamples:
        """The samples in `bricks` (B, 3), as if `updates` were applied, with their gradient."""
        rows = self.rows(brick_samples(bricks))
        at, there = rows.clamp(min=0), rows >= 0
        features, distances, weights = [], [], []
        for number, sensor_map in enumerate(self.maps):
            values = [sensor_map.features[at], sensor_map.tsdf[at], sensor_map.weight[at]]
            if updates is not None:
                values = _patched(values, at, updates[number], sensor_map)
            features.append(values[0] * there[..., None])
            distances.append(inner_part(values[1]))
            weights.append(values[2] * there)
        alpha = self.model.weighting(weighting_inputs((features[0], features[1]), (weights[0], weights[1])))
        truth = self.steps[inner_part(at)].float() * (self.truth.truncation_m / 127)
        inner = [inner_part(weight) for weight in weights]
        return PairSamples(*(part.reshape(-1) for part in (alpha, *distances, *inner, truth)))

    def _bricks(self, rows: Tensor) -> Tensor:
        """Distinct bricks (B, 3) of rows."""
        y_z = self.shape[1] * self.shape[2]
        local = torch.stack([rows // y_z, rows // self.shape[2] % self.shape[1], rows % self.shape[2]], -1)
        return unique_blocks(torch.div(local + self.first, BRICK, rounding_mode="floor"))


def _patched(values: list[Tensor], at: Tensor, update: Update, sensor_map: SensorGrid) -> list[Tensor]:
    """Gathered features, distances and weights, those of `update.rows` replaced by the new ones."""
    slot = sensor_map.slots(update.rows)[at]  # 0 = not updated
    fresh = slot > 0
    place = (slot[fresh] - 1,)
    new = (update.features, update.tsdf, update.weight)
    return [old.index_put((fresh,), table[place]) for old, table in zip(values, new, strict=True)]


def _mean(values: Tensor) -> Tensor:
    return values.sum() / max(1, values.numel())
