"""`uncle report`: everything that a run can show, on one page that needs no other file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..core.errors import DependencyError, UncleError
from ..core.events import OnEvent, Progress, Warn, ignore
from ..core.files import write_text
from ..core.html import Section, embed_picture, explain, heading, missing, page, preformatted, table
from ..evaluation.noise_curves import Readings, collect_readings, noise_of
from ..evaluation.sensor_frames import estimated_sensors
from ..evaluation.sensor_summary import standing_of, summarise
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.manifest import Manifest
from ..visualization.mesh_pictures import draw_mesh, load_reference, load_run_mesh, snapshot_views
from ..visualization.metrics_table import grouped, metric_rows
from ..visualization.report_camera import camera_section
from ..visualization.report_charts import (
    calibration_chart,
    curves_chart,
    noise_chart,
    reliability_chart,
    reliability_curves,
    vertex_sigma_chart,
)
from ..visualization.sensor_pictures import draw_sensors
from ..visualization.uncertainty_table import summary_table

_SUMMARY = (  # order of the metrics
    "surface", "trajectory", "tracking", "held_out", "held_out_color", "uncertainty", "skipped", "notes", "settings",
)  # fmt: skip

_CAPTIONS = {
    "shaded": "Surface under a lamp at the camera.",
    "color": "Colours of the vertices.",
    "sigma": "How far each vertex may be from the true surface: one sigma, as the map estimates it.",
    "error": "Distance of each vertex to the ground truth.",
}


def write_report(run: RunDirectory, renderer: str = "auto", on_event: OnEvent = ignore) -> Path:
    """Write RUN/report.html, with fresh snapshots of the run's mesh, camera and sensors; returns its path.

    What the run does not hold is named on the page with the command that makes it. Raises RunError without a run.
    """
    manifest = run.manifest
    parts: list[tuple[str, Callable[[], str]]] = [
        ("Overview", lambda: _overview(run, manifest)),
        ("Mesh", lambda: _mesh(run, renderer, on_event)),
        ("Camera", lambda: camera_section(run)),
        ("Metrics", lambda: _metrics(run)),
        ("Sensors", lambda: _sensors(run, on_event)),
        ("Curves", lambda: _curves(run)),
        ("Time and memory", lambda: _stages(manifest)),
        ("Configuration", lambda: _configuration(run)),
    ]
    sections = []
    for done, (title, build) in enumerate(parts):
        on_event(Progress("report", done, len(parts), "sections"))
        sections.append(Section(title, _guarded(title, build, on_event)))
    lead = f"{', '.join(manifest.sensors)} · {manifest.dataset_format} · run directory {run.root}"
    write_text(run.report_path, page(f"Reconstruction of {manifest.name}", lead, sections))
    on_event(Progress("report", len(parts), len(parts), "sections"))
    return run.report_path


def _guarded(title: str, build: Callable[[], str], on_event: OnEvent) -> str:
    """A broken part of a run costs its section, not the page; a missing library concerns the whole page."""
    try:
        return build()
    except DependencyError:
        raise
    except UncleError as error:
        on_event(Warn(f"{title}: {error}"))
        return missing(str(error))


def _overview(run: RunDirectory, manifest: Manifest) -> str:
    camera = run.load_camera()
    mapped = manifest.stages.get("map")
    facts = mapped.facts if mapped else {}
    method = facts.get("method")
    used = facts.get("sensors")
    rows = [
        ("Data set", manifest.dataset),
        ("Format", manifest.dataset_format),
        ("Sensors", ", ".join(manifest.sensors)),
        ("Sensors in the map", ", ".join(map(str, used)) if isinstance(used, list | tuple) else "unknown"),
        ("Frames", str(len(RunFrames(run))) + (f" ({len(manifest.skipped)} skipped)" if manifest.skipped else "")),
        ("Camera", f"{camera.width} x {camera.height}, f {camera.fx:.1f} {camera.fy:.1f}"),
        ("Method", str(method) if method else "unknown" if mapped else "no map yet"),
        ("Stages", ", ".join(manifest.stages) or "none"),
    ]
    note = "" if mapped else missing(f"There is no map yet; make one with `uncle map --run {run.root}`.")
    return table(("", ""), rows) + note


def _mesh(run: RunDirectory, renderer: str, on_event: OnEvent) -> str:
    if not run.mesh_path.is_file():
        return missing(f"There is no mesh yet; make it with `uncle mesh --run {run.root}`.")
    mesh, reference = load_run_mesh(run), load_reference(run)
    snapshots = draw_mesh(mesh, snapshot_views(mesh, run), None, reference, renderer, on_event)
    counts = f"{grouped(len(mesh.vertices))} vertices, {grouped(len(mesh.faces))} triangles."
    pictures = [
        embed_picture(shot.save(run.snapshots_path).read_bytes(), _CAPTIONS[shot.mode], photographic=True)
        for shot in snapshots
    ]
    return explain(counts) + "\n".join(pictures) + _vertex_sigma(run)


def _vertex_sigma(run: RunDirectory) -> str:
    surface = (_read_json(run.metrics_path) or {}).get("surface")
    scored = surface.get("vertex_sigma") if isinstance(surface, dict) else None
    curves = scored.get("curves") if isinstance(scored, dict) else None
    chart = vertex_sigma_chart(curves) if isinstance(curves, dict) else None
    return _embed_chart(chart, "The sigma of the vertices against their distance to the true surface.")


def _sensors(run: RunDirectory, on_event: OnEvent) -> str:
    frames = RunFrames(run)
    sheets = {path.stem.removeprefix("sensor_"): path for path in draw_sensors(run, run.snapshots_path, on_event)}
    metrics = _read_json(run.metrics_path) or {}
    scored = metrics.get("uncertainty")
    readings = {sensor: collect_readings(frames, sensor) for sensor in estimated_sensors(frames)}
    parts = [_trust(run, readings)]
    for sensor in readings:
        parts.append(heading(f"Sensor {sensor}"))
        parts.append(fault_section(run, sensor))
        if sensor in sheets:
            picture = sheets[sensor].read_bytes()
            parts.append(embed_picture(picture, "All sensors share these scales.", photographic=True))
        else:
            parts.append(missing("No frame of this sensor can be read; redo it with `uncle preprocess --overwrite`."))
        parts.append(_noise(run, sensor, readings[sensor]))
        parts.append(_calibration(sensor, scored.get(sensor) if isinstance(scored, dict) else None))
    caption = "Reliability of all that states an uncertainty: how much of the truth lies within what was promised."
    parts.append(_embed_chart(reliability_chart(reliability_curves(metrics)), caption))
    return "\n".join(filter(None, parts)) or missing("The run has no sensor but the ground truth.")


def fault_section(run: RunDirectory, sensor: str) -> str:
    """What was wrong with a sensor while the map was made."""
    sensors = (_read_json(run.sensors_path) or {}).get("sensors")
    facts = sensors.get(sensor) if isinstance(sensors, dict) else None
    sentences = facts.get("sentences") if isinstance(facts, dict) else None
    return "".join(explain(str(sentence)) for sentence in sentences) if isinstance(sentences, list) else ""


def _trust(run: RunDirectory, readings: dict[str, Readings | None]) -> str:
    """How much each sensor has to say in the map, and what it is believed to be off by."""
    found = {sensor: summarise(seen, standing_of(run, sensor)) for sensor, seen in readings.items() if seen is not None}
    if not found:
        return ""
    header, rows = summary_table(found)
    text = "What each sensor counts in the map, and its beta: the mean error that a reading promises."
    return explain(text) + table(header, rows, numbers=range(1, len(header) - 1))


def _noise(run: RunDirectory, sensor: str, readings: Readings | None) -> str:
    if readings is None:
        return missing(f"No beta maps: `uncle map --run {run.root}` learns them for the sensors that it maps.")
    noise = noise_of(readings)
    caption = "A beta is the mean error that it promises: where the curves coincide, the sensor is known."
    return embed_picture(noise_chart(sensor, noise), caption, photographic=False)


def _calibration(sensor: str, scored: Any) -> str:
    curves = scored.get("curves") if isinstance(scored, dict) else None
    chart = calibration_chart(sensor, curves) if isinstance(curves, dict) else None
    return _embed_chart(chart, "Calibration against the true depth (`uncle eval`).")


def _embed_chart(chart: bytes | None, caption: str) -> str:
    """Nothing where there is nothing to draw."""
    return embed_picture(chart, caption, photographic=False) if chart else ""


def _curves(run: RunDirectory) -> str:
    curves = _read_json(run.curves_path)
    chart = curves_chart(curves) if curves else None
    if chart is None:
        return missing(f"There are no curves; `uncle map --run {run.root}` writes them.")
    return embed_picture(chart, "Written by the map stage.", photographic=False)


def _metrics(run: RunDirectory) -> str:
    metrics = _read_json(run.metrics_path)
    if not metrics:
        return missing(f"There are no scores; make them with `uncle eval --run {run.root}`.")
    ordered = {key: metrics[key] for key in (*_SUMMARY, *metrics) if key in metrics}
    rows: list[tuple[str, ...]] = []
    group = None
    for row in metric_rows(ordered):
        if row.group != group:
            group = row.group
            rows.append((group or "run",))
        rows.append((row.name, row.value, row.unit))
    return table(("Metric", "Value", "Unit"), rows, numbers=(1,))


def _stages(manifest: Manifest) -> str:
    if not manifest.stages:
        return missing("No stage is finished; start with `uncle preprocess DATASET`.")
    rows = [(name, f"{stage.seconds:.1f}", stage.finished) for name, stage in manifest.stages.items()]
    parts = [table(("Stage", "Seconds", "Finished"), rows, numbers=(1,))]
    for name, stage in manifest.stages.items():
        facts = metric_rows(stage.facts)
        if facts:
            lines = [(f"{row.group} / {row.name}" if row.group else row.name, row.value, row.unit) for row in facts]
            parts.append(heading(f"Facts of {name}") + table(("Fact", "Value", "Unit"), lines, numbers=(1,)))
    versions = next(reversed(manifest.stages.values())).versions
    parts.append(explain("Versions: " + ", ".join(f"{name} {number}" for name, number in versions.items())))
    return "\n".join(parts)


def _configuration(run: RunDirectory) -> str:
    try:
        return preformatted(run.config_path.read_text(errors="replace"))
    except OSError:
        return missing(f"There is no configuration; `uncle map --run {run.root}` writes it.")


def _read_json(path: Path) -> dict[str, Any] | None:
    """None where the file is missing, broken or no JSON object."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
