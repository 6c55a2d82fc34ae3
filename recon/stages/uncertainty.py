"""`uncle uncertainty`: what a run learned about its sensors, as figures and as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import ConfigError, DataError
from ..core.events import OnEvent, Warn, ignore
from ..core.files import write_bytes
from ..core.frame import GROUND_TRUTH_SENSOR
from ..core.json_values import to_plain
from ..evaluation.noise_curves import collect_readings, noise_of
from ..evaluation.run_metrics import score_uncertainty
from ..evaluation.sensor_frames import estimated_sensors
from ..evaluation.sensor_summary import SensorUncertainty, standing_of, summarise
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..visualization.report_charts import calibration_chart, noise_chart, reliability_chart
from ..visualization.sensor_pictures import draw_sensors


@dataclass(frozen=True)
class RunUncertainty:
    """By sensor; sensors without an uncertainty or without a truth are in `skipped` with the reason."""

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
) -> RunUncertainty:
    """Describe the uncertainty of all sensors of a map, or of some, and draw it into the folder `out`.

    Drawn are, of each sensor: depth, beta and true error of a few frames, or of `frame`; noise against depth and slant;
    and, where the truth is known, how far the promises are kept. Raises RunError (no map), ConfigError (no such sensor
    or frame), DataError (nothing was learned).
    """
    run.require_stage("map")
    frames = RunFrames(run)
    shown = _choose(frames, sensors, frame)
    has_truth = GROUND_TRUTH_SENSOR in frames.sensors
    found: dict[str, SensorUncertainty] = {}
    skipped: dict[str, str] = {}
    charts: list[Path] = []
    for sensor in shown:
        readings = collect_readings(frames, sensor)
        if readings is None:
            skipped[sensor] = "it has no beta maps: it is not in the map, or the map learned no uncertainty"
            continue
        scores = None
        if has_truth:
            try:
                scores = score_uncertainty(frames, sensor, seed, on_event)
            except DataError as error:
                skipped[f"{sensor}, scores"] = str(error)
        found[sensor] = summarise(readings, standing_of(run, sensor), scores)
        charts.append(_write(out / f"noise_{sensor}.png", noise_chart(sensor, noise_of(readings))))
        chart = calibration_chart(sensor, to_plain(scores.curves)) if scores is not None else None
        charts += [_write(out / f"calibration_{sensor}.png", chart)] if chart else []
    if not found:
        raise DataError(
            f"the map of {run.root} learned no uncertainty of {', '.join(shown)}; map these sensors with "
            f"`uncle map --run {run.root} --method uncle`"
        )
    scored = {sensor: to_plain(s.scores.curves) for sensor, s in found.items() if s.scores is not None}
    chart = reliability_chart(scored)
    charts += [_write(out / "reliability.png", chart)] if chart else []
    if frame is not None:
        _warn_of_missing(frames, found, frame, on_event)
    pictures = [*draw_sensors(run, out, on_event, list(found), frame), *charts]
    return RunUncertainty(str(run.root), found, skipped, tuple(map(str, pictures)))


def _choose(frames: RunFrames, sensors: Sequence[str], frame: int | None) -> list[str]:
    known = estimated_sensors(frames)
    unknown = [sensor for sensor in sensors if sensor not in known]
    if unknown:
        raise ConfigError(f"no sensor called {unknown[0]!r} can be unsure in this run; it has: {', '.join(known)}")
    if frame is not None and not 0 <= frame < len(frames):
        raise ConfigError(f"--frame {frame}: the run has frames 0 to {len(frames) - 1}")
    return list(dict.fromkeys(sensors)) or known


def _warn_of_missing(frames: RunFrames, sensors: dict[str, SensorUncertainty], frame: int, on_event: OnEvent) -> None:
    for sensor in sensors:
        if not frames.run.beta_path(sensor, frame).is_file():
            on_event(Warn(f"frame {frame} of {sensor} has no beta map: it was held out of the map, lost, or not read"))


def _write(path: Path, picture: bytes) -> Path:
    write_bytes(path, picture)
    return path
