"""Threads that share out work on tensors, each on one core: cheaper than splitting every small product over all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch

T = TypeVar("T")


class Workers:
    """As many as PyTorch has threads."""

    def __init__(self) -> None:
        self.count = max(1, torch.get_num_threads())
        self._pool = ThreadPoolExecutor(self.count, initializer=torch.set_num_threads, initargs=(1,))

    def share(self, work: Callable[[int, Any], T], jobs: Sequence[Any]) -> list[T]:
        """`work(worker, job)` of all jobs, without gradients.

        Each worker has every n-th job, so that sums that it keeps do not depend on who was quicker.
        """

        @torch.no_grad()
        def run(worker: int) -> list[T]:
            return [work(worker, job) for job in jobs[worker :: self.count]]

        if self.count == 1:
            return run(0)
        done = list(self._pool.map(run, range(self.count)))
        torch.set_num_threads(self.count)  # a new worker's setting is everybody's
        return [done[index % self.count][index // self.count] for index in range(len(jobs))]
