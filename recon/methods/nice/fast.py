"""What a scene says along rays, on a CPU: the mathematics of `Scene.values` without the work that changes nothing.

- Rays are taken in parts that fit the cache, on all cores.
- A ray is followed from front to back and left once no more than `PASSED` of it goes on.
- Frozen decoders remember which ReLUs were open, and nothing else, for the gradient.
- Samples whose logit has a gradient below `FLAT` send none on: Adam would not feel it beside its epsilon of 1e-8. Where
  only a camera is moved, whose gradient is one sum, all but a thousandth of the whole is sent on.
- Colour is decoded where a sample makes up more than `FAINT` of its ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from . import kernels
from .decoders import CHANNELS, OCCUPANCY_SLOPE
from .frozen import FrozenDecoder
from .grids import FeatureGrid
from .rays import TINY, ray_weights
from .scene import OUTSIDE_LOGIT, Scene, Stage, Values
from .workers import Workers

PASSED = 1e-8
FLAT = 1e-9
LOST_SHARE = 1e-3
FAINT = 1e-4
BEHIND_LOGIT = -100.0  # of samples that no light reaches: they take no part
RAYS = 384  # at a time
SAMPLES = 4096  # at a time, of colour
SEGMENTS = 4  # of a ray; after each, rays that have ended are left
NAMES = ("middle", "fine", "color")


class _Grid:
    """A grid as the compiled loops take it."""

    def __init__(self, grid: FeatureGrid) -> None:
        self.table = grid.table.detach().numpy()
        self.place = (grid.low.numpy(), (1 / grid.pitch).numpy(), np.array(grid.shape))

    def lookup(self, points: Tensor) -> Tensor:
        """(N, 3) -> (N, 32)."""
        found = torch.empty(len(points), CHANNELS)
        kernels.lookup(points.numpy(), self.table, *self.place, found.numpy())
        return found

    def scatter(self, points: Tensor, gradient: Tensor, of_table: np.ndarray) -> None:
        """Add the gradient (N, 32) of what was found to that of the table."""
        kernels.scatter(points.numpy(), gradient.contiguous().numpy(), *self.place, of_table)

    def add_slopes(self, points: Tensor, gradient: Tensor, of_points: Tensor) -> None:
        """Add to the gradient (N, 3) of the points."""
        kernels.add_slopes(points.numpy(), self.table, gradient.contiguous().numpy(), *self.place, of_points.numpy())


@dataclass
class _Seen:
    """Samples (n,) of all, their points (n, 3), and the open ReLUs (5, n, 32) of each decoder by name."""

    samples: Tensor
    points: Tensor
    opened: dict[str, Tensor]

    def only(self, chosen: Tensor) -> _Seen:
        """Those `chosen` (m,); `index_select` takes a third of the time of an index in brackets."""
        words = {name: masks.view(torch.int64) for name, masks in self.opened.items()}
        opened = {name: masks.index_select(1, chosen).view(torch.uint8) for name, masks in words.items()}
        return _Seen(self.samples.index_select(0, chosen), self.points.index_select(0, chosen), opened)


class FastEvaluate:
    """`Scene.values` of a scene on the CPU; grids may be replaced and the colour decoder trained between calls."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.middle, self.fine = FrozenDecoder(scene.decoders.middle), FrozenDecoder(scene.decoders.fine)
        self.workers = Workers()

    def __call__(self, points: Tensor, stage: Stage) -> Values:
        """points (R, S, 3), metres, along R rays, front to back."""
        tables = [self.scene.grids[name].table for name in NAMES]
        colored = stage == "color"
        weights = list(self.scene.color_decoder.parameters()) if colored else []
        logits, colors = _Along.apply(self, stage, points, *tables, *weights)
        return Values(logits, colors if colored else None)

    def grid(self, name: str) -> _Grid:
        return _Grid(self.scene.grids[name])

    def follow(self, points: Tensor, stage: Stage, keep: bool, worker: int, rays: range) -> tuple[Tensor, list[_Seen]]:
        """Some rays of points (R, S, 3) -> logits (r, S), and what was seen if `keep`."""
        first, length = rays.start, points.shape[1]
        points = points[rays.start : rays.stop]
        logits = torch.full(points.shape[:2], BEHIND_LOGIT)
        alive, passing = torch.arange(len(points)), torch.ones(len(points))
        seen = []
        step = -(-length // SEGMENTS)
        for start in range(0, length, step):
            end = min(start + step, length)
            whole = len(alive) == len(points)
            part = (points if whole else points.index_select(0, alive))[:, start:end].reshape(-1, 3)
            found, opened = self.logits(part, stage)
            found = found.view(len(alive), -1)
            logits[slice(None) if whole else alive, start:end] = found
            if keep:
                samples = (first + alive)[:, None] * length + torch.arange(start, end)
                seen.append(_Seen(samples.view(-1), part, opened))
            passing = passing * (1 - torch.sigmoid(OCCUPANCY_SLOPE * found) + TINY).prod(1)
            left = passing > PASSED
            if not bool(left.all()):
                alive, passing = alive[left], passing[left]
            if not len(alive):
                break
        return logits, seen

    def logits(self, points: Tensor, stage: Stage) -> tuple[Tensor, dict[str, Tensor]]:
        """(N, 3) -> logits (N,), open ReLUs by decoder."""
        middle = self.grid("middle").lookup(points)
        logits, opened = self.middle.values(points, middle)
        masks = {"middle": opened}
        if stage != "middle":
            features = torch.cat([self.grid("fine").lookup(points), middle], 1)
            more, masks["fine"] = self.fine.values(points, features)
            logits = logits + more
        logits = logits[:, 0].contiguous()
        kernels.fill_outside(points.numpy(), *self.scene.bound.numpy(), np.float32(OUTSIDE_LOGIT), logits.numpy())
        return logits, masks

    def colors(self, points: Tensor, decoder: FrozenDecoder, worker: int, samples: Tensor) -> tuple[Tensor, Tensor]:
        """Colours (n, 3) of samples (n,) of points (N, 3), and the open ReLUs of the decoder."""
        places = points[samples]
        return decoder.values(places, self.grid("color").lookup(places))


class _Along(torch.autograd.Function):
    """evaluate, stage, points (R, S, 3), the grids' tables, weights of the colour decoder -> logits, colours."""

    @staticmethod
    def forward(ctx, evaluate: FastEvaluate, stage: Stage, points: Tensor, *learned: Tensor):
        points = points.detach().contiguous()
        work = partial(evaluate.follow, points, stage, any(ctx.needs_input_grad))
        size = max(RAYS, SAMPLES // points.shape[1])
        parts = [range(start, start + size) for start in range(0, len(points), size)]
        done = evaluate.workers.share(work, parts)
        logits = torch.cat([part for part, _ in done])
        ctx.evaluate, ctx.stage, ctx.points = evaluate, stage, points
        ctx.seen = [seen for _, parts in done for seen in parts]
        if stage != "color":
            return logits, torch.zeros(0)
        colors = torch.zeros(points.shape)
        ctx.decoder = FrozenDecoder(evaluate.scene.color_decoder, 3)
        ctx.visible = (ray_weights(logits) > FAINT).view(-1).nonzero()[:, 0].split(SAMPLES)
        found = evaluate.workers.share(partial(evaluate.colors, points.view(-1, 3), ctx.decoder), ctx.visible)
        for samples, (part, _) in zip(ctx.visible, found, strict=True):
            colors.view(-1, 3)[samples] = part
        ctx.opened = [opened for _, opened in found]
        return logits, colors

    @staticmethod
    def backward(ctx, of_logits: Tensor, of_colors: Tensor):
        gradients = Gradients(ctx.evaluate, ctx.points, ctx.needs_input_grad[2:])
        gradients.add_logits(ctx.seen, of_logits.reshape(-1))
        if ctx.stage == "color":
            of_colors = of_colors.reshape(-1, 3)
            if any(ctx.needs_input_grad[6:]):
                gradients.learn_colors(ctx.visible, ctx.decoder, of_colors)
            else:
                gradients.add_colors(ctx.visible, ctx.opened, ctx.decoder, of_colors)
        return None, None, *gradients.collected()


class Gradients:
    """Sums of gradients, by worker: of the points, three tables, and the weights of the colour decoder."""

    def __init__(self, evaluate: FastEvaluate, points: Tensor, wanted: tuple[bool, ...]) -> None:
        """wanted: whether each of these, in this order, is asked for."""
        self.evaluate, self.wanted, self.points = evaluate, wanted, points
        self.of_points = torch.zeros(points.shape).view(-1, 3) if wanted[0] else None
        self.asked = {name for name, asked in zip(NAMES, wanted[1:4], strict=True) if asked}
        self.tables: dict[str, list[np.ndarray]] = {}
        self.weights: list[Tensor] = []

    def add_logits(self, seen: list[_Seen], of_logits: Tensor) -> None:
        """From that of the logits (N,)."""
        flat = FLAT if self.asked else LOST_SHARE * float(of_logits.abs().mean())
        names = seen[0].opened if seen else ()
        self._open(names)
        decoders = {"middle": self.evaluate.middle, "fine": self.evaluate.fine}

        def back(worker: int, seen: _Seen) -> None:
            given = of_logits.index_select(0, seen.samples)
            chosen = (given.abs() > flat).nonzero()[:, 0]
            if len(chosen) < len(given):
                seen, given = seen.only(chosen), given[chosen]
            for name in names:
                found = decoders[name].gradients(seen.opened[name], given[:, None], self._moving(seen.points))
                self._pass_on(worker, name, seen.samples, seen.points, *found)

        self.evaluate.workers.share(back, seen)

    def add_colors(
        self, visible: tuple[Tensor, ...], opened: list[Tensor], decoder: FrozenDecoder, given: Tensor
    ) -> None:
        """From that of the colours (N, 3), with a decoder that stands still."""
        self._open(("color",))

        def back(worker: int, part: tuple[Tensor, Tensor]) -> None:
            samples, masks = part
            points = self.points.view(-1, 3)[samples]
            found = decoder.gradients(masks, given[samples], self._moving(points))
            self._pass_on(worker, "color", samples, points, *found)

        self.evaluate.workers.share(back, list(zip(visible, opened, strict=True)))

    def learn_colors(self, visible: tuple[Tensor, ...], decoder: FrozenDecoder, given: Tensor) -> None:
        """The same with a decoder that learns."""
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
        """In the order of the inputs; None where nothing was asked for or nothing came."""
        points = None if self.of_points is None else self.of_points.view(self.points.shape)
        tables = [torch.from_numpy(sum(own[1:], own[0])) if (own := self.tables.get(name)) else None for name in NAMES]
        return [points, *tables, *(self.weights or [None] * (len(self.wanted) - 4))]

    def _open(self, names) -> None:
        for name in self.asked.intersection(names):
            table = self.evaluate.grid(name).table
            self.tables[name] = [np.zeros_like(table) for _ in range(self.evaluate.workers.count)]

    def _moving(self, points: Tensor) -> Tensor | None:
        return points if self.of_points is not None else None

    def _pass_on(
        self, worker: int, name: str, samples: Tensor, points: Tensor, of_features: Tensor, of_points: Tensor | None
    ) -> None:
        grid = self.evaluate.grid(name)
        if name in self.tables:
            grid.scatter(points, of_features, self.tables[name][worker])
        if of_points is not None and self.of_points is not None:
            grid.add_slopes(points, of_features, of_points)
            self.of_points.index_add_(0, samples, of_points)  # its own samples: nobody else writes there
