"""Weights of the occupancy decoders on disk: our own format, NICE-SLAM's checkpoints, and the shipped ones."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.errors import ConfigError
from ...core.json_values import first_problem
from ...core.tensor_files import read_tensors, save_tensors
from .decoders import LAYERS, Decoder, OccupancyDecoders, fine_decoder, middle_decoder

FORMAT = "uncle occupancy decoders, version 1"
SHIPPED = Path(__file__).parent / "weights" / "decoders.pt"

# A NICE-SLAM checkpoint names the middle decoder "coarse", and the layers as on the right.
_NICE_PREFIX = {"middle": "decoder.coarse.", "fine": "decoder.fine."}
_NICE_NAMES = {"embedding": "embedder._B", "output.weight": "output_linear.weight", "output.bias": "output_linear.bias"}
_NICE_NAMES |= {
    f"{ours}.{layer}.{kind}": f"{theirs}.{layer}.{kind}"
    for ours, theirs in (("hidden", "pts_linears"), ("injection", "fc_c"))
    for layer in range(LAYERS)
    for kind in ("weight", "bias")
}


def save_decoders(path: Path, decoders: OccupancyDecoders) -> None:
    """Write weights and recipe as plain tensors and containers, atomically. Raises RunError."""
    weights = {
        name: {key: value.detach().cpu().clone() for key, value in decoder.state_dict().items()}
        for name, decoder in (("middle", decoders.middle), ("fine", decoders.fine))
    }
    save_tensors(path, {"format": FORMAT, **weights, "recipe": decoders.recipe})


def load_decoders(path: Path) -> OccupancyDecoders:
    """Frozen decoders from a file of `uncle pretrain decoders` or a NICE-SLAM checkpoint (`middle_fine.pt`).

    Never runs code from the file. Raises ConfigError that names what does not fit.
    """
    content = _read(path)
    if content.get("format") == FORMAT:
        states, recipe = {name: content.get(name, {}) for name in _NICE_PREFIX}, content.get("recipe", {})
    elif isinstance(content.get("model"), dict):
        states, recipe = {name: _nice_state(content["model"], name, path) for name in _NICE_PREFIX}, {}
    else:
        raise ConfigError(
            f"{path} holds no decoders: expected a file of `uncle pretrain decoders`, or a NICE-SLAM checkpoint with "
            f"the entry 'model', but it has {_listed(content)}"
        )
    decoders = OccupancyDecoders(middle_decoder(), fine_decoder(), str(path), recipe)
    for name, decoder in (("middle", decoders.middle), ("fine", decoders.fine)):
        _fill(decoder, states[name], name, path)
    return decoders.frozen()


def shipped_decoders() -> OccupancyDecoders:
    """The decoders that come with the package, frozen. Raises ConfigError if this copy has none."""
    if not SHIPPED.exists():
        raise ConfigError(
            "this installation has no pretrained decoders; train them with `uncle pretrain decoders --out decoders.pt` "
            "and pass `--set nice.decoders=decoders.pt`"
        )
    return load_decoders(SHIPPED)


def _read(path: Path) -> dict[str, Any]:
    """The dictionary of a file of tensors and plain numbers, also NumPy's, which ConvONet's checkpoints hold."""
    try:
        content = read_tensors(path, also=_numpy_scalars(), legacy=True)
    except FileNotFoundError as error:
        raise ConfigError(f"there is no file {path}: nice.decoders must name a file of decoders") from error
    except pickle.UnpicklingError as error:
        raise ConfigError(
            f"cannot read {path}: it holds more than tensors and plain values, and running code from a file is not "
            f"safe; load it where you trust it, and save `{{'model': checkpoint['model']}}`"
        ) from error
    except Exception as error:  # of many types
        raise ConfigError(f"cannot read {path}: it is damaged or no PyTorch file ({first_problem(error)})") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{path} holds no decoders: it is a {type(content).__name__}, not a checkpoint")
    return content


def _numpy_scalars() -> list[Any]:
    """Types of a pickled NumPy number, under the module names of NumPy 1 and 2."""
    scalar = np.float64(0).__reduce__()[0]  # the function that a pickled number calls
    kinds = [type(np.dtype(kind)) for kind in (np.float32, np.float64, np.int64)]
    return [scalar, (scalar, "numpy.core.multiarray.scalar"), np.dtype, *kinds]


def _nice_state(model: dict[str, Any], name: str, path: Path) -> dict[str, Any]:
    """Our state of one decoder from a NICE-SLAM model, whose keys start with `decoder.coarse.` or `decoder.fine.`."""
    prefix = _NICE_PREFIX[name]
    weights = {str(key).removeprefix(prefix): value for key, value in model.items() if str(key).startswith(prefix)}
    if not weights:
        raise ConfigError(
            f"{path} has no {name} decoder: no key of its model starts with '{prefix}'; NICE-SLAM keeps both in "
            f"middle_fine.pt (coarse.pt has neither), but this has {_listed(model)}"
        )
    return {ours: weights[theirs] for ours, theirs in _NICE_NAMES.items() if theirs in weights}


def _fill(decoder: Decoder, state: Any, name: str, path: Path) -> None:
    """Copy `state` into `decoder` after checking names, shapes and values. Raises ConfigError."""
    for key, expected in decoder.state_dict().items():
        value = state.get(key) if isinstance(state, dict) else None
        where = f"{path}: the {name} decoder's {key} (NICE-SLAM: {_NICE_NAMES[key]})"
        if not isinstance(value, Tensor):
            raise ConfigError(f"{where} is missing")
        if value.shape != expected.shape:
            raise ConfigError(
                f"{where} has shape {tuple(value.shape)}, expected {tuple(expected.shape)}: five hidden layers of "
                "width 32 on 32 (middle) or 64 (fine) features"
            )
        if not torch.isfinite(value.float()).all():
            raise ConfigError(f"{where} is not finite: the training that wrote it failed")
    decoder.load_state_dict({key: state[key].float() for key in decoder.state_dict()})


def _listed(content: dict[Any, Any], most: int = 5) -> str:
    names = ", ".join(repr(str(key)) for key in list(content)[:most]) or "nothing"
    return names + (f" and {len(content) - most} more" if len(content) > most else "")
