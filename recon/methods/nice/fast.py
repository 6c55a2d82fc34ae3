"""Values of a scene along rays on a CPU: `GridScene.values` without the work that changes (nearly) nothing.

- Rays are taken in parts that fit the cache, on all cores.
- A ray is followed from front to back and left once its transmittance is negligible.
- Frozen decoders keep which ReLUs were open, and nothing else, for the gradient.
- Samples whose logit has a negligible gradient send none on: Adam would not notice it beside its epsilon of 1e-8.
  Where only a camera is moved, whose gradient is one sum, all but a thousandth of the whole is sent on.
- Colour is decoded where a sample has a weight that matters.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from . import kernels
from .decoders import CHANNELS, OCCUPANCY_SLOPE
from .frozen import FrozenDecoder
from .grids import FeatureGrid
from .rays import TINY, ray_weights
from .scene import OUTSIDE_LOGIT, FieldValues, GridScene, Stage
from .workers import Workers

BEHIND_LOGIT = -100.0  # of samples that are not evaluated: their weight is 0
RAYS_AT_A_TIME = 384
SAMPLES_AT_A_TIME = 4096
SEGMENTS = 4  # of a ray; after each, rays that have ended are left
GRIDS = ("middle", "fine", "color")


@dataclass(frozen=True)
class PruningParameters:
    """What is negligible: transmittance of a ray; gradient of a logit, absolute where features are optimised and as a
    ratio of the mean where only poses are; weight of a sample whose colour is decoded."""

    min_transmittance: float = 1e-8
    min_gradient: float = 1e-9
    min_gradient_ratio: float = 1e-3
    min_color_weight: float = 1e-4


PRUNING = PruningParameters()


class _GridArrays:
    """A grid as the compiled loops take it."""

    def __init__(self, grid: FeatureGrid) -> None:
        self.table = grid.table.detach().numpy()
        self.place = (grid.low.numpy(), (1 / grid.pitch).numpy(), np.array(grid.shape))

    def lookup(self, points: Tensor) -> Tensor:
        """Features (N, 32) at points (N, 3)."""
        features = torch.empty(len(points), CHANNELS)
        kernels.lookup(points.numpy(), self.table, *self.place, features.numpy())
        return features

    def scatter(self, points: Tensor, gradient: Tensor, of_table: np.ndarray) -> None:
        """Add to the gradient of the table, from that (N, 32) of the features."""
        kernels.scatter(points.numpy(), gradient.contiguous().numpy(), *self.place, of_table)

    def add_slopes(self, points: Tensor, gradient: Tensor, of_points: Tensor) -> None:
        """Add to the gradient (N, 3) of the points, from that (N, 32) of the features."""
        kernels.add_slopes(points.numpy(), self.table, gradient.contiguous().numpy(), *self.place, of_points.numpy())


@dataclass
class _EvaluatedSamples:
    """Evaluated samples: numbers (n,), points (n, 3), and the open ReLUs (5, n, 32) of each decoder by name."""

    samples: Tensor
    points: Tensor
    opened: dict[str, Tensor]

    def select(self, chosen: Tensor) -> _EvaluatedSamples:
        """The `chosen` (m,) ones; `index_select` takes a third of the time of an index in brackets."""
        words = {name: masks.view(torch.int64) for name, masks in self.opened.items()}
        opened = {name: masks.index_select(1, chosen).view(torch.uint8) for name, masks in words.items()}
        return _EvaluatedSamples(self.samples.index_select(0, chosen), self.points.index_select(0, chosen), opened)


class FastEvaluate:
    """`GridScene.values` of a scene on the CPU; grids may be replaced and the colour decoder trained between calls."""

    def __init__(self, scene: GridScene, pruning: PruningParameters = PRUNING) -> None:
        self.scene, self.pruning = scene, pruning
        self.middle, self.fine = FrozenDecoder(scene.decoders.middle), FrozenDecoder(scene.decoders.fine)
        self.workers = Workers()

    def __call__(self, points: Tensor, stage: Stage) -> FieldValues:
        """Field at points (R, S, 3), metres, along R rays, front to back."""
        tables = [self.scene.grids[name].table for name in GRIDS]
        colored = stage == "color"
        weights = list(self.scene.color_decoder.parameters()) if colored else []
        logits, colors = _FieldAlongRays.apply(self, stage, points, *tables, *weights)
        return FieldValues(logits, colors if colored else None)

    def grid(self, name: str) -> _GridArrays:
        """A grid as the compiled loops take it."""
        return _GridArrays(self.scene.grids[name])

    def follow(
        self, points: Tensor, stage: Stage, keep: bool, worker: int, rays: range
    ) -> tuple[Tensor, list[_EvaluatedSamples]]:
        """Logits (r, S) of some rays of points (R, S, 3), and the samples that were evaluated, if `keep`."""
        first, length = rays.start, points.shape[1]
        points = points[rays.start : rays.stop]
        logits = torch.full(points.shape[:2], BEHIND_LOGIT)
        alive, transmittance = torch.arange(len(points)), torch.ones(len(points))
        evaluated = []
        step = -(-length // SEGMENTS)
        for start in range(0, length, step):
            end = min(start + step, length)
            whole = len(alive) == len(points)
            part = (points if whole else points.index_select(0, alive))[:, start:end].reshape(-1, 3)
            values, opened = self.logits(part, stage)
            values = values.view(len(alive), -1)
            logits[slice(None) if whole else alive, start:end] = values
            if keep:
                samples = (first + alive)[:, None] * length + torch.arange(start, end)
                evaluated.append(_EvaluatedSamples(samples.view(-1), part, opened))
            transmittance = transmittance * (1 - torch.sigmoid(OCCUPANCY_SLOPE * values) + TINY).prod(1)
            left = transmittance > self.pruning.min_transmittance
            if not bool(left.all()):
                alive, transmittance = alive[left], transmittance[left]
            if not len(alive):
                break
        return logits, evaluated

    def logits(self, points: Tensor, stage: Stage) -> tuple[Tensor, dict[str, Tensor]]:
        """Logits (N,) at points (N, 3), and the open ReLUs by decoder."""
        middle = self.grid("middle").lookup(points)
        logits, opened = self.middle.values(points, middle)
        masks = {"middle": opened}
        if stage != "middle":
            features = torch.cat([self.grid("fine").lookup(points), middle], 1)
            residual, masks["fine"] = self.fine.values(points, features)
            logits = logits + residual
        logits = logits[:, 0].contiguous()
        low, high = self.scene.bound.numpy()
        kernels.fill_outside(points.numpy(), low, high, np.float32(OUTSIDE_LOGIT), logits.numpy())
        return logits, masks

    def colors(self, points: Tensor, decoder: FrozenDecoder, worker: int, samples: Tensor) -> tuple[Tensor, Tensor]:
        """Colours (n, 3) of samples (n,) of points (N, 3), and the open ReLUs of the decoder."""
        places = points[samples]
        return decoder.values(places, self.grid("color").lookup(places))


class _FieldAlongRays(torch.autograd.Function):
    """Logits and colours from evaluate, stage, points (R, S, 3), the grids' tables, weights of the colour decoder."""

    @staticmethod
    def forward(
        ctx: Any, evaluate: FastEvaluate, stage: Stage, points: Tensor, *learned: Tensor
    ) -> tuple[Tensor, Tensor]:
        points = points.detach().contiguous()
        work = partial(evaluate.follow, points, stage, any(ctx.needs_input_grad))
        size = max(RAYS_AT_A_TIME, SAMPLES_AT_A_TIME // points.shape[1])
        parts = [range(start, start + size) for start in range(0, len(points), size)]
        done = evaluate.workers.share(work, parts)
        logits = torch.cat([part for part, _ in done])
        ctx.evaluate, ctx.stage, ctx.points = evaluate, stage, points
        ctx.evaluated = [samples for _, parts in done for samples in parts]
        if stage != "color":
            return logits, torch.zeros(0)
        colors = torch.zeros(points.shape)
        ctx.decoder = FrozenDecoder(evaluate.scene.color_decoder, 3)
        weights = ray_weights(logits) > evaluate.pruning.min_color_weight
        ctx.visible = weights.view(-1).nonzero()[:, 0].split(SAMPLES_AT_A_TIME)
        decoded = evaluate.workers.share(partial(evaluate.colors, points.view(-1, 3), ctx.decoder), ctx.visible)
        for samples, (part, _) in zip(ctx.visible, decoded, strict=True):
            colors.view(-1, 3)[samples] = part
        ctx.opened = [opened for _, opened in decoded]
        return logits, colors

    @staticmethod
    def backward(ctx: Any, of_logits: Tensor, of_colors: Tensor) -> tuple[Tensor | None, ...]:
        gradients = Gradients(ctx.evaluate, ctx.points, ctx.needs_input_grad[2:])
        gradients.add_logits(ctx.evaluated, of_logits.reshape(-1))
        if ctx.stage == "color":
            of_colors = of_colors.reshape(-1, 3)
            if any(ctx.needs_input_grad[6:]):
                gradients.learn_colors(ctx.visible, ctx.decoder, of_colors)
            else:
                gradients.add_colors(ctx.visible, ctx.opened, ctx.decoder, of_colors)
        return None, None, *gradients.collected()


class Gradients:
    """Sums of gradients, by worker: of the points, three tables, and the weights of the colour decoder.

    Every method adds what follows from one output; `collected` returns the sums.
    """

    def __init__(self, evaluate: FastEvaluate, points: Tensor, wanted: tuple[bool, ...]) -> None:
        """wanted: whether each of these, in this order, is needed."""
        self.evaluate, self.wanted, self.points = evaluate, wanted, points
        self.of_points = torch.zeros(points.shape).view(-1, 3) if wanted[0] else None
        self.wanted_tables = {name for name, needed in zip(GRIDS, wanted[1:4], strict=True) if needed}
        self.tables: dict[str, list[np.ndarray]] = {}
        self.weights: list[Tensor] = []

    def add_logits(self, evaluated: list[_EvaluatedSamples], of_logits: Tensor) -> None:
        """Add what follows from the gradient of the logits (N,)."""
        pruning = self.evaluate.pruning
        if self.wanted_tables:
            negligible = pruning.min_gradient
        else:
            negligible = pruning.min_gradient_ratio * float(of_logits.abs().mean())
        names = evaluated[0].opened if evaluated else ()
        self._open(names)
        decoders = {"middle": self.evaluate.middle, "fine": self.evaluate.fine}

        def back(worker: int, part: _EvaluatedSamples) -> None:
            given = of_logits.index_select(0, part.samples)
            chosen = (given.abs() > negligible).nonzero()[:, 0]
            if len(chosen) < len(given):
                part, given = part.select(chosen), given[chosen]
            for name in names:
                gradients = decoders[name].gradients(part.opened[name], given[:, None], self._if_moving(part.points))
                self._pass_on(worker, name, part.samples, part.points, *gradients)

        self.evaluate.workers.share(back, evaluated)

    def add_colors(
        self, visible: tuple[Tensor, ...], opened: list[Tensor], decoder: FrozenDecoder, given: Tensor
    ) -> None:
        """Add what follows from the gradient of the colours (N, 3), with fixed weights of the decoder."""
        self._open(("color",))

        def back(worker: int, part: tuple[Tensor, Tensor]) -> None:
            samples, masks = part
            points = self.points.view(-1, 3)[samples]
            gradients = decoder.gradients(masks, given[samples], self._if_moving(points))
            self._pass_on(worker, "color", samples, points, *gradients)

        self.evaluate.workers.share(back, list(zip(visible, opened, strict=True)))

    def learn_colors(self, visible: tuple[Tensor, ...], decoder: FrozenDecoder, given: Tensor) -> None:
        """Add what follows from the gradient of the colours (N, 3), the weights of the decoder included."""
        self._open(("color",))
        grid = self.evaluate.grid("color")

        def back(worker: int, samples: Tensor) -> list[Tensor]:
            points = self.points.view(-1, 3)[samples]
            of_features, of_points, learned = decoder.learn(points, grid.lookup(points), given[samples])
            self._pass_on(worker, "color", samples, points, of_features, of_points)
            return learned

        parts = self.evaluate.workers.share(back, visible)
        self.weights = [torch.stack(column).sum(0) for column in zip(*parts, strict=True)]

    def collected(self) -> list[Tensor | None]:
        """Sums in the order of the inputs; None where none is needed or there is none."""
        points = None if self.of_points is None else self.of_points.view(self.points.shape)
        tables = [self._table_sum(name) for name in GRIDS]
        weights: Sequence[Tensor | None] = self.weights or [None] * (len(self.wanted) - 4)
        return [points, *tables, *weights]

    def _table_sum(self, name: str) -> Tensor | None:
        by_worker = self.tables.get(name)
        return torch.from_numpy(sum(by_worker[1:], by_worker[0])) if by_worker else None

    def _open(self, names: Iterable[str]) -> None:
        """Make room for the sums of these tables, if they are needed."""
        for name in self.wanted_tables.intersection(names):
            table = self.evaluate.grid(name).table
            self.tables[name] = [np.zeros_like(table) for _ in range(self.evaluate.workers.count)]

    def _if_moving(self, points: Tensor) -> Tensor | None:
        return points if self.of_points is not None else None

    def _pass_on(
        self, worker: int, name: str, samples: Tensor, points: Tensor, of_features: Tensor, of_points: Tensor | None
    ) -> None:
        grid = self.evaluate.grid(name)
        if name in self.tables:
            grid.scatter(points, of_features, self.tables[name][worker])
        if of_points is not None and self.of_points is not None:
            grid.add_slopes(points, of_features, of_points)
            self.of_points.index_add_(0, samples, of_points)  # no other worker has these samples
