"""Weighted sums of table rows, with a backward pass that is fast on a CPU and on a GPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag


class _WeightedRows(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, table: Tensor, rows: Tensor, weights: Tensor) -> Tensor:
        ctx.save_for_backward(rows, weights)
        ctx.size = len(table)
        return embedding_bag(rows, table, mode="sum", per_sample_weights=weights)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        rows, weights = ctx.saved_tensors
        spread = (weights[..., None] * grad[:, None]).view(-1, grad.shape[1])
        # One addition per corner; PyTorch's own dense backward sorts all corners first, which takes longer.
        return grad.new_zeros(ctx.size, grad.shape[1]).index_add_(0, rows.view(-1), spread), None, None


def weighted_rows(table: Tensor, rows: Tensor, weights: Tensor) -> Tensor:
    """table (R, C), rows (N, K) int64, weights (N, K) -> (N, C): sum over k of weights * table[rows].

    Differentiable in the table only.
    """
    result: Tensor = _WeightedRows.apply(table, rows, weights)  # type: ignore[no-untyped-call]
    return result
