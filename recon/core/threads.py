"""Compiled loops over independent rows, shared out to threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import torch


def share_out(work: Callable[[slice], None], count: int) -> None:
    """`work(rows)` on contiguous parts of `count` rows at the same time, as many as PyTorch has threads.

    Only loops that let go of the interpreter gain by it. `work` must not share out anything itself.
    """
    threads = torch.get_num_threads()
    parts = max(1, min(threads, count))
    edges = [count * part // parts for part in range(parts + 1)]
    rows = [slice(start, stop) for start, stop in pairwise(edges)]
    if parts == 1:
        work(rows[0])
    else:
        list(_pool(threads).map(work, rows))


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads)
