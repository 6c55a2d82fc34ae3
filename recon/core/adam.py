"""Adam (Kingma and Ba 2015), step for step as in torch.optim, whose first use loads a compiler for a second or two."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

DECAY = (0.9, 0.999)  # of the means of the gradient and of its square
_TINY = 1e-8


@dataclass(frozen=True)
class Moments:
    """Running means of the gradient of a parameter and of its square, and how often it had one."""

    first: Tensor
    second: Tensor
    steps: int = 0


class Adam:
    """The optimiser of `parameters`; each call of `step` is given the step size."""

    def __init__(self, parameters: Iterable[Tensor]) -> None:
        self.parameters = list(parameters)
        self.moments: dict[int, Moments] = {}  # by position in `parameters`; of those that ever had a gradient

    def zero_grad(self) -> None:
        """Clear the gradients."""
        for parameter in self.parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """One step of about `rate` in each number that has a gradient."""
        for place, parameter in enumerate(self.parameters):
            if parameter.grad is not None:
                self._move(place, parameter, parameter.grad, rate)

    def _move(self, place: int, parameter: Tensor, gradient: Tensor, rate: float) -> None:
        past = self.moments.get(place) or Moments(torch.zeros_like(parameter), torch.zeros_like(parameter))
        now = Moments(past.first, past.second, past.steps + 1)
        now.first.lerp_(gradient, 1 - DECAY[0])
        now.second.mul_(DECAY[1]).addcmul_(gradient, gradient, value=1 - DECAY[1])
        spread = (now.second.sqrt() / math.sqrt(1 - DECAY[1] ** now.steps)).add_(_TINY)
        parameter.addcdiv_(now.first, spread, value=-rate / (1 - DECAY[0] ** now.steps))
        self.moments[place] = now

    def state_dict(self) -> dict[int, dict[str, Any]]:
        """Plain tensors and numbers that `load_state_dict` continues from."""
        return {place: dict(vars(moments)) for place, moments in self.moments.items()}

    def load_state_dict(self, state: dict[int, dict[str, Any]]) -> None:
        """Continue from the moments that `state_dict` of an optimiser of equal parameters returned."""
        for place, past in state.items():
            first, second = (past[name].to(self.parameters[place].device) for name in ("first", "second"))
            self.moments[place] = Moments(first, second, past["steps"])
