"""The `uncertainty` stage: what a map learned about its sensors, as numbers and as pictures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import ConfigError, DataError
from ..core.events import OnEvent, Warn, ignore
from ..core.files import write_bytes
from ..core.frame import GROUND_TRUTH_SENSOR
from ..core.json_values import to_plain
from ..evaluation.noise_curves import BetaSamples, collect_beta_samples, noise_curves
from ..evaluation.sensor_frames import estimated_sensors
from ..evaluation.sensor_summary import SensorUncertainty, sensor_weight_summary, summarise_sensor
from ..evaluation.sensor_uncertainty import score_uncertainty
from ..evaluation.uncertainty_calibration import UncertaintyMetrics
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.lock import writing_to
from ..visualization.report_charts import noise_chart, reliability_chart, uncertainty_calibration_chart
from ..visualization.sensor_pictures import draw_sensors
from .base import StageSummary

STAGE = "uncertainty"


@dataclass(frozen=True, kw_only=True)
class UncertaintySummary(StageSummary):
    """`sensors` by name; sensors without beta maps or without a true depth are in `skipped` with the reason."""

    run: str
    sensors: dict[str, SensorUncertainty]
    skipped: dict[str, str]
    pictures: tuple[str, ...]


def uncertainty_run(
    run: RunDirectory,
    out: Path,
    sensors: Sequence[str] = (),
    frame: int | None = None,
    *,
    seed: int = 0,
    on_event: OnEvent = ignore,
) -> UncertaintySummary:
    """Summarise the uncertainty of all sensors of a map, or of `sensors`, and draw it into the folder `out`.

    For each sensor these are drawn: depth, beta and true error of a few frames, or of `frame`; noise against depth and
    incidence angle; and, where the true depth is known, the calibration. Raises RunError (no map of the present frames,
    in use by another process), ConfigError (no such sensor or frame), DataError (no uncertainty was learned).
    """
    with writing_to(run, out, STAGE, on_event):
        return _summarise(run, out, sensors, frame, seed, on_event)


def _summarise(
    run: RunDirectory, out: Path, sensors: Sequence[str], frame: int | None, seed: int, on_event: OnEvent
) -> UncertaintySummary:
    started = time.time()
    run.require_stage("map")
    frames = RunFrames(run)
    chosen = _choose_sensors(frames, sensors)
    _check_frame(frames, frame)
    summaries: dict[str, SensorUncertainty] = {}
    skipped: dict[str, str] = {}
    charts: list[Path] = []
    for sensor in chosen:
        samples = collect_beta_samples(frames, sensor)
        if samples is None:
            skipped[sensor] = "it has no beta maps: it is not in the map, or the map learned no uncertainty"
            continue
        scores = _score(frames, sensor, seed, skipped, on_event)
        summaries[sensor] = summarise_sensor(samples, sensor_weight_summary(run, sensor), scores)
        charts += _draw_charts(out, sensor, samples, scores)
    if not summaries:
        raise DataError(
            f"the map of {run.root} has no uncertainty of {', '.join(chosen)}; map these sensors with "
            f"`uncle map --run {run.root} --method uncle`"
        )
    curves = {sensor: to_plain(s.scores.curves) for sensor, s in summaries.items() if s.scores is not None}
    chart = reliability_chart(curves)
    charts += [_write(out / "reliability.png", chart)] if chart else []
    if frame is not None:
        _warn_of_missing_beta(frames, list(summaries), frame, on_event)
    pictures = [*draw_sensors(run, out, on_event, list(summaries), frame), *charts]
    return UncertaintySummary(
        run=str(run.root),
        sensors=summaries,
        skipped=skipped,
        pictures=tuple(map(str, pictures)),
        seconds=time.time() - started,
    )


def _choose_sensors(frames: RunFrames, sensors: Sequence[str]) -> list[str]:
    known = estimated_sensors(frames)
    unknown = [sensor for sensor in sensors if sensor not in known]
    if unknown:
        raise ConfigError(f"--sensor {unknown[0]}: the run has no such estimated sensor; it has: {', '.join(known)}")
    return list(dict.fromkeys(sensors)) or known


def _check_frame(frames: RunFrames, frame: int | None) -> None:
    if frame is not None and not 0 <= frame < len(frames):
        raise ConfigError(f"--frame {frame}: the run has frames 0 to {len(frames) - 1}")


def _score(
    frames: RunFrames, sensor: str, seed: int, skipped: dict[str, str], on_event: OnEvent
) -> UncertaintyMetrics | None:
    """Scores against the true depth; None without it, or with the reason in `skipped`."""
    if GROUND_TRUTH_SENSOR not in frames.sensors:
        return None
    try:
        return score_uncertainty(frames, sensor, seed, on_event)
    except DataError as error:
        skipped[f"{sensor}, scores"] = str(error)
        return None


def _draw_charts(out: Path, sensor: str, samples: BetaSamples, scores: UncertaintyMetrics | None) -> list[Path]:
    """Noise curves and, with scores, the calibration of one sensor."""
    charts = [_write(out / f"noise_{sensor}.png", noise_chart(sensor, noise_curves(samples)))]
    calibration = uncertainty_calibration_chart(sensor, to_plain(scores.curves)) if scores is not None else None
    if calibration:
        charts.append(_write(out / f"uncertainty_calibration_{sensor}.png", calibration))
    return charts


def _warn_of_missing_beta(frames: RunFrames, sensors: list[str], frame: int, on_event: OnEvent) -> None:
    for sensor in sensors:
        if not frames.run.beta_path(sensor, frame).is_file():
            reason = "it was held out of the map, the camera was lost, or the sensor has no depth there"
            on_event(Warn(f"frame {frame} of {sensor} has no beta map: {reason}"))


def _write(path: Path, picture: bytes) -> Path:
    write_bytes(path, picture)
    return path
