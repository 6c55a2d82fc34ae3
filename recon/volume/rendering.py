"""Differentiable volume rendering of a signed distance field: pure functions on samples along rays."""

from __future__ import annotations

import torch
from torch import Tensor


def sdf_weights(sdf: Tensor, known: Tensor, sharpness_m: float) -> Tensor:
    """(N, S) distances along N rays -> (N, S) weights that sum to 1 on each ray with a known sample, else 0.

    A bell around the zero crossing: sigmoid(sdf / s) * sigmoid(-sdf / s) with s = `sharpness_m`. Samples behind the
    first surface of the ray (after the distance has gone from positive to negative and up again) get nothing.
    """
    scaled = sdf / sharpness_m
    bell = torch.sigmoid(scaled) * torch.sigmoid(-scaled) * known
    inside = (sdf < 0) & known
    behind = torch.cumsum(inside.int(), 1) > 0
    rising = behind & (sdf > 0)
    hidden = torch.cumsum(rising.int(), 1) > 0
    bell = bell * ~hidden
    return bell / bell.sum(1, keepdim=True).clamp(min=1e-9)


def render_depth(weights: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    """weights (N, S), z (N, S) metres -> expected depth (N,) metres, variance (N,) metres^2."""
    depth = (weights * z).sum(1)
    return depth, (weights * (z - depth[:, None]) ** 2).sum(1)


def render_values(weights: Tensor, values: Tensor) -> Tensor:
    """weights (N, S), values (N, S, C) -> (N, C): expected colour (I-hat of UncLe-SLAM)."""
    return (weights[..., None] * values).sum(1)
