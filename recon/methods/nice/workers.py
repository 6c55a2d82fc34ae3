"""Threads that share work on tensors, each with one core: cheaper than splitting every small product over all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch

T = TypeVar("T")


class Workers:
    """A pool of as many threads as PyTorch uses."""

    def __init__(self) -> None:
        self.count = max(1, torch.get_num_threads())
        self._pool = ThreadPoolExecutor(self.count)

    def share(self, work: Callable[[int, Any], T], jobs: Sequence[Any]) -> list[T]:
        """Results of `work(worker, job)` for all jobs, in order, without gradients.

        Each worker takes every n-th job, so sums that it keeps do not depend on which one was quicker.
        """

        @torch.no_grad()
        def run(worker: int) -> list[T]:
            # Each time: the number is one for all threads of MKL, and products that are split differ from run to run.
            torch.set_num_threads(1)
            return [work(worker, job) for job in jobs[worker :: self.count]]

        if self.count == 1:
            return run(0)
        done = list(self._pool.map(run, range(self.count)))
        torch.set_num_threads(self.count)
        return [done[index % self.count][index // self.count] for index in range(len(jobs))]
