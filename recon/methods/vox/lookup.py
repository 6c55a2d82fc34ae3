"""Trilinear interpolation of rows of a table, differentiable in the table and in the place."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag


class _Trilinear(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, table: Tensor, rows: Tensor, fractions: Tensor) -> Tensor:
        ctx.save_for_backward(table, rows, fractions)
        return embedding_bag(rows, table, mode="sum", per_sample_weights=corner_weights(fractions))

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, None, Tensor | None]:
        table, rows, fractions = ctx.saved_tensors
        to_table = to_place = None
        if ctx.needs_input_grad[0]:
            spread = (corner_weights(fractions)[..., None] * grad[:, None]).view(-1, grad.shape[1])
            to_table = torch.zeros_like(table).index_add_(0, rows.view(-1), spread)
        if ctx.needs_input_grad[2]:
            pull = (table[rows] * grad[:, None]).sum(-1).view(-1, 2, 2, 2)  # what more of each corner would do
            x, y, z = (torch.stack([1 - part, part], -1) for part in fractions.unbind(-1))
            along_x = ((pull[:, 1] - pull[:, 0]) * y[:, :, None] * z[:, None, :]).sum((1, 2))
            along_y = ((pull[:, :, 1] - pull[:, :, 0]) * x[:, :, None] * z[:, None, :]).sum((1, 2))
            along_z = ((pull[..., 1] - pull[..., 0]) * x[:, :, None] * y[:, None, :]).sum((1, 2))
            to_place = torch.stack([along_x, along_y, along_z], -1)
        return to_table, None, to_place


def corner_weights(fractions: Tensor) -> Tensor:
    """(N, 3) places within a voxel, 0..1 -> (N, 8) weights of its corners, in the order of `grid.CORNERS`."""
    x, y, z = torch.stack([1 - fractions, fractions], -1).unbind(1)  # each (N, 2): low and high side
    return (x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]).reshape(-1, 8)


def trilinear(table: Tensor, rows: Tensor, fractions: Tensor) -> Tensor:
    """table (R, C), rows (N, 8) int64 in the order of `grid.CORNERS`, fractions (N, 3) in 0..1 -> (N, C)."""
    return _Trilinear.apply(table, rows, fractions)
