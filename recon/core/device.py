"""Where tensors live."""

import torch

from .errors import DataError


def choose_device(name: str) -> torch.device:
    """`auto` takes CUDA where there is one. Raises DataError if `cuda` is asked for and missing."""
    if name == "cuda" and not torch.cuda.is_available():
        raise DataError("--device cuda: PyTorch finds no CUDA device here; use --device auto or cpu")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")
