"""Scores of the error scale (beta maps) of one sensor of a run against its true error."""

from __future__ import annotations

import numpy as np

from ..core.errors import DataError
from ..core.events import OnEvent, track_progress
from ..core.frame import GROUND_TRUTH_SENSOR
from ..run.frames import RunFrames
from .uncertainty_calibration import DEFAULT_PARAMETERS, UncertaintyMetrics, evaluate_uncertainty


def score_uncertainty(
    frames: RunFrames, sensor: str, seed: int, on_event: OnEvent, max_measurements: int | None = None
) -> UncertaintyMetrics:
    """Score the beta maps of `sensor` in the pixels that have a depth, a beta and a true depth.

    At most `max_measurements` (default: that of the parameters) are drawn, equally many from each frame. Raises
    DataError if there are none.
    """
    limit = max_measurements or DEFAULT_PARAMETERS.max_measurements
    indices = [index for index in range(len(frames)) if frames.run.beta_path(sensor, index).is_file()]
    rng = np.random.default_rng(seed)
    per_frame = -(-limit // max(1, len(indices)))
    depths, errors, betas = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    for index in track_progress(indices, len(indices), f"uncertainty, {sensor}", on_event):
        depth = frames.depth(index, sensor).numpy().ravel()
        true_depth = frames.depth(index, GROUND_TRUTH_SENSOR).numpy().ravel()
        beta = frames.beta(index, sensor).numpy().ravel()
        valid = np.flatnonzero((depth > 0) & (true_depth > 0) & (beta > 0))
        chosen = rng.permutation(valid)[:per_frame]
        depths.append(depth[chosen])
        errors.append(depth[chosen] - true_depth[chosen])
        betas.append(beta[chosen])
    error, beta = np.concatenate(errors), np.concatenate(betas)
    if len(error) == 0:
        raise DataError(f"no pixel of {sensor} has both a beta and a true depth")
    return evaluate_uncertainty(
        error, beta, np.concatenate(depths), quantiles=_error_quantiles(frames, sensor), max_measurements=limit,
        seed=seed,
    )  # fmt: skip


def _error_quantiles(frames: RunFrames, sensor: str) -> dict[str, float] | None:
    """The calibrated quantiles that the map stage recorded for `sensor`, in betas."""
    record = frames.run.load_manifest().stages.get("map")
    quantiles = record.facts.get("error_quantiles_in_beta", {}) if record is not None else {}
    return quantiles.get(sensor)
