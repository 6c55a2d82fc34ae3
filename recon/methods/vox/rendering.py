"""Rendering of rays by the bell around the surface: depth, colour and distances."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .model import VoxModel
from .sampling import Samples

MIN_COLOR_WEIGHT = 1e-4  # the colour of samples with less weight in their ray is not computed


@dataclass(frozen=True)
class Rendered:
    """depth (N,) metres and color (N, 3) in 0..1 of rays; sdf (N, S), truncations, of their samples (0: no sample)."""

    depth: Tensor
    color: Tensor
    sdf: Tensor


def bell_weights(sdf: Tensor, z: Tensor, there: Tensor, truncation_m: float) -> Tensor:
    """sdf (N, S) truncations, z (N, S) metres, there (N, S) -> (N, S) weights that sum to 1 on rays with samples.

    sigmoid(s / t) sigmoid(-s / t), cut where t has gone by since the first change of sign, normalised.
    Where the sign never changes, nothing is cut. Only existing samples count, and they come first.
    """
    bell = torch.sigmoid(sdf / truncation_m) * torch.sigmoid(-sdf / truncation_m)
    with torch.no_grad():
        before = sdf > 0
        change = (before[:, 1:] != before[:, :-1]) & there[:, 1:]
        first = change.int().argmax(1, keepdim=True) if sdf.shape[1] > 1 else z.new_zeros(len(z), 1, dtype=torch.int64)
        end = torch.where(change.any(1, keepdim=True), z.gather(1, first) + truncation_m, torch.inf)
        kept = there & (z < end)
    bell = bell * kept
    return bell / bell.sum(1, keepdim=True).clamp(min=1e-9)


def render(model: VoxModel, points: Tensor, samples: Samples) -> Rendered:
    """Render rays at `samples`, the M existing of which lie at world points (M, 3), metres.

    Differentiable in the points and in the model. Colour is computed only for samples with a noticeable weight.
    """
    if not len(points):
        empty = samples.z.new_zeros(len(samples.z))
        return Rendered(empty, empty[:, None].expand(-1, 3), samples.z.new_zeros(samples.z.shape))
    ray, _, ids = samples.packed()
    embedding = model.embed(points, ids)
    with model.precision():
        hidden = model.decoder.trunk(embedding)
        distance = model.decoder.distance(hidden)
    sdf = samples.pad(distance.to(embedding.dtype))
    weights = bell_weights(sdf, samples.z, samples.there, model.config.truncation_m)
    own = weights.view(-1)[samples.index]
    seen = (own.detach() > MIN_COLOR_WEIGHT).nonzero()[:, 0]
    with model.precision():
        rgb = model.decoder.color(hidden[seen])
    rgb = rgb.to(own.dtype) * own[seen, None]
    color = rgb.new_zeros(len(weights), 3).index_add(0, ray[seen], rgb)
    return Rendered((weights * samples.z).sum(1), color, sdf)
