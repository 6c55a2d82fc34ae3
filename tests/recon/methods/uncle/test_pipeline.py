"""The passes of the reconstruction, and what a checkpoint holds of it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.methods.uncle.pipeline import Reconstruction, reconstruct
from uncle.recon.methods.uncle.state import ReconstructionState, start
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.frames import RunFrames

QUICK = ["fusion.voxel_size_m=0.1", "field.iterations=0", "uncertainty.steps_per_pass=2", "keyframes.rays=300"]


def reconstructed(run, path: Path, *settings: str, on_beta=lambda *_: None, **kwargs: Any) -> Reconstruction:
    config = make_config("uncle", [*QUICK, *settings], sensors=("noisy",), device="cpu", **kwargs)
    frames = RunFrames(run, ("noisy",))
    return reconstruct(frames, list(range(0, 12, 2)), config, Checkpoint(path, ""), on_beta)


def test_every_pass_counts_every_measurement_once(make_mappable_run, tmp_path):
    """The last pass replaces the ones before: no sample has more observations than there are frames and sensors."""
    betas: dict[int, torch.Tensor] = {}
    result = reconstructed(
        make_mappable_run(("noisy",)), tmp_path / "c.pt", "fusion.passes=2",
        on_beta=lambda index, sensor, beta: betas.update({index: beta}),
    )  # fmt: skip
    counts = result.state.mapper.volume.counts()
    assert counts.max() <= 6
    assert counts.max() >= 3
    assert sorted(betas) == sorted(result.poses) == list(range(0, 12, 2))
    assert {"pass_1", "pass_2", "pass_3", "learning"} <= set(result.seconds)


def test_facts_are_plain_values_by_sensor(make_mappable_run, tmp_path):
    facts = reconstructed(make_mappable_run(("noisy",)), tmp_path / "c.pt").facts()
    assert facts["keyframes"] >= 1
    assert facts["sensor_reliability"] == {"noisy": 1.0}
    assert facts["sensor_weight_share"] == {"noisy": 1.0}
    assert facts["bias_corrected_sensors"] == []
    assert set(facts["error_quantiles_in_beta"]) <= {"noisy"}


# --- checkpoint --------------------------------------------------------------------------------------------------
# The cached surface, and the lookup table of the grid, which is made anew from its blocks.
IGNORED = {"_surface", "_index"}


def attributes(value: Any, path: str = "", seen: set[int] | None = None) -> Iterator[tuple[str, Any]]:
    """Dotted name and value of everything that a part of the state holds, down to tensors and numbers."""
    seen = set() if seen is None else seen
    if isinstance(value, torch.Generator):
        yield path, value.get_state()
    elif isinstance(value, torch.Tensor | np.ndarray | int | float | str | None):
        yield path, value
    elif isinstance(value, dict | list | tuple | set):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from attributes(item, f"{path}[{key!r}]", seen)
    elif hasattr(value, "__dict__") and type(value).__module__.startswith(("uncle", "torch.nn")):
        if id(value) in seen:
            return
        seen.add(id(value))
        for name in vars(value):  # in the order of definition: an object met twice keeps its first path
            if name in IGNORED:
                continue
            yield from attributes(vars(value)[name], f"{path}.{name}", seen)


def same(first: Any, second: Any) -> bool:
    if isinstance(first, torch.Tensor):
        return isinstance(second, torch.Tensor) and torch.equal(first, second)
    if isinstance(first, np.ndarray):
        return isinstance(second, np.ndarray) and np.array_equal(first, second, equal_nan=True)
    return first == second or (first != first and second != second)


def differences(first: ReconstructionState, second: ReconstructionState) -> list[str]:
    """Names of the attributes that differ, or that only one of the two has."""
    ours, theirs = dict(attributes(first)), dict(attributes(second))
    missing = set(ours) ^ set(theirs)
    return sorted(missing | {name for name in set(ours) & set(theirs) if not same(ours[name], theirs[name])})


@pytest.mark.parametrize("settings", [["photometric.max_passes=2"], ["tracking.enabled=true"]], ids=["given", "track"])
def test_a_restored_state_has_the_same_attributes(make_mappable_run, tmp_path, settings):
    """Every attribute of every part, so that none is forgotten in a checkpoint."""
    run = make_mappable_run(("noisy",))
    result = reconstructed(run, tmp_path / "c.pt", "fusion.min_observations=1", *settings)
    frames, config = RunFrames(run, ("noisy",)), result.state.config
    restored = start(frames, config)
    fresh = differences(result.state, restored)
    assert any(".volume.sums" in name for name in fresh)  # the comparison sees what is inside
    assert any("noise.models" in name for name in fresh)
    assert any("error_quantiles" in name for name in fresh)
    assert any("progress.poses" in name for name in fresh)
    saved = Checkpoint(tmp_path / "c.pt", "").load()
    restored.load_state_dict(saved["state"])
    assert set(differences(result.state, restored)) <= {name for name in fresh if "progress.seconds" in name}
