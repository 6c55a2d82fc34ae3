"""How well features found by optimisation describe rooms never seen, read by given decoders."""

from __future__ import annotations

import torch
from torch import Tensor

from ..nice.decoders import OccupancyDecoders
from .cubes import CubeBatch, cube_logits, cube_losses

UNSEEN_SEED = 777_000_000  # far from the seeds of trainings


def decoder_scores(
    decoders: OccupancyDecoders,
    device: torch.device,
    *,
    cubes: int = 24,
    steps: int = 96,
    pool: int = 16384,
    seed: int = UNSEEN_SEED,
) -> dict[str, float]:
    """Fit features to cubes of unseen rooms with the decoders frozen; how well unseen places are told solid or free.

    steps: of the features, middle stage first. pool: known places of each cube, half of them near surfaces; a quarter
    is held back. Returns the intersection over union of solids and the share of right answers, each of middle and of
    middle + fine, and the mean logit and the largest occupancy that features near zero have.
    """
    decoders = decoders.frozen(device)
    generator = torch.Generator(device).manual_seed(seed)
    batch = CubeBatch(cubes, pool, steps, generator)
    batch.renew(slice(0, cubes))
    with torch.no_grad():
        points, _ = batch.draw(pool // 4)
        fresh = cube_logits(decoders, points, batch.features(points), generator)[1]
    held_out = batch.places[:, ::4], batch.solid[:, ::4]
    kept = [index for index in range(pool) if index % 4]
    batch.places, batch.solid, batch.pool = batch.places[:, kept], batch.solid[:, kept], len(kept)
    for _ in range(steps):
        fit_step(decoders, batch, 1024)
    with torch.no_grad():
        logits = cube_logits(decoders, held_out[0], batch.features(held_out[0]), generator)
    scores = {"fresh_logit": fresh.mean().item(), "fresh_occupancy": torch.sigmoid(10 * fresh.max()).item()}
    for name, logit in zip(("middle", "fine"), logits, strict=True):
        scores |= {f"{name}_{key}": value for key, value in _agreement(logit > 0, held_out[1] > 0).items()}
    return scores


def fit_step(decoders: OccupancyDecoders, batch: CubeBatch, points: int) -> None:
    """One step of the features of all cubes, the decoders frozen."""
    places, solid = batch.draw(points)
    grids = {name: grid.requires_grad_() for name, grid in batch.grids.values.items()}
    logits = cube_logits(decoders, places, batch.features(places), batch.generator)
    gradients = torch.autograd.grad(cube_losses(logits, solid).sum(), list(grids.values()))
    with torch.no_grad():
        for grid in grids.values():
            grid.requires_grad_(False)
        batch.move(dict(zip(grids, gradients, strict=True)))


def _agreement(predicted: Tensor, true: Tensor) -> dict[str, float]:
    both, either = (predicted & true).sum(), (predicted | true).sum()
    return {"iou": (both / either.clamp(min=1)).item(), "accuracy": (predicted == true).float().mean().item()}
