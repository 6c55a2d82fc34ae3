"""Cubes of samples, with a halo: what the weighting network sees at once."""

from __future__ import annotations

import torch
from torch import Tensor

from ...volume.sparse_grid import BLOCK
from .network import HALO

BRICK = 2 * BLOCK  # samples along the side, without the halo


def brick_samples(bricks: Tensor) -> Tensor:
    """(B, 3) bricks -> (B, 20, 20, 20, 3) int64 samples in them and in the halo around."""
    steps = torch.arange(-HALO, BRICK + HALO, device=bricks.device)
    inner = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1)
    return bricks[:, None, None, None] * BRICK + inner


def inner_part(values: Tensor) -> Tensor:
    """(B, 20, 20, 20) -> (B, 16, 16, 16): without the halo."""
    return values[:, HALO:-HALO, HALO:-HALO, HALO:-HALO]
