"""The sections of `uncle report` as HTML, each from the files of a run. What is missing is named with its command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..core.errors import RunError
from ..core.events import OnEvent
from ..core.files import read_bytes, read_json
from ..core.html import embed_picture, explain, heading, missing, preformatted, table
from ..core.number_format import format_grouped
from ..evaluation.noise_curves import BetaSamples, collect_beta_samples, noise_curves
from ..evaluation.sensor_frames import estimated_sensors
from ..evaluation.sensor_summary import sensor_weight_summary, summarise_sensor
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.manifest import Manifest
from ..run.meshes import has_reference_mesh, load_reference_mesh, load_run_mesh
from .mesh_pictures import draw_mesh, snapshot_views
from .metrics_table import metric_rows
from .report_camera import camera_section
from .report_charts import (
    curves_chart,
    noise_chart,
    reliability_chart,
    reliability_curves,
    uncertainty_calibration_chart,
    vertex_sigma_chart,
)
from .sensor_pictures import draw_sensors
from .uncertainty_table import summary_table

_METRICS_ORDER = (
    "surface", "trajectory", "tracking", "held_out", "held_out_color", "uncertainty", "skipped", "notes", "settings",
)  # fmt: skip
_CAPTIONS = {
    "shaded": "Surface, lit from the camera.",
    "color": "Colours of the vertices.",
    "sigma": "Estimated 1-sigma distance of each vertex to the true surface.",
    "error": "Distance of each vertex to the ground truth.",
}


def report_sections(run: RunDirectory, renderer: str, on_event: OnEvent) -> list[tuple[str, Callable[[], str]]]:
    """Title of each section and the function that makes its HTML. Raises RunError without a run."""
    manifest = run.load_manifest()
    return [
        ("Overview", lambda: overview_section(run, manifest)),
        ("Mesh", lambda: mesh_section(run, renderer, on_event)),
        ("Camera", lambda: camera_section(run)),
        ("Metrics", lambda: metrics_section(run)),
        ("Sensors", lambda: sensors_section(run, on_event)),
        ("Curves", lambda: curves_section(run)),
        ("Time and memory", lambda: stages_section(manifest)),
        ("Configuration", lambda: configuration_section(run)),
    ]


def overview_section(run: RunDirectory, manifest: Manifest) -> str:
    """Data set, sensors, method and finished stages."""
    camera = run.load_camera()
    record = manifest.stages.get("map")
    facts = record.facts if record is not None else {}
    method, mapped_sensors = facts.get("method"), facts.get("sensors")
    in_map = ", ".join(map(str, mapped_sensors)) if isinstance(mapped_sensors, list | tuple) else "unknown"
    skipped = f" ({len(manifest.skipped)} skipped)" if manifest.skipped else ""
    rows = [
        ("Data set", manifest.dataset),
        ("Format", manifest.dataset_format),
        ("Sensors", ", ".join(manifest.sensors)),
        ("Sensors in the map", in_map),
        ("Frames", f"{len(RunFrames(run))}{skipped}"),
        ("Camera", f"{camera.width} x {camera.height}, f {camera.fx:.1f} {camera.fy:.1f}"),
        ("Method", str(method) if method else "unknown" if record is not None else "no map yet"),
        ("Stages", ", ".join(manifest.stages) or "none"),
    ]
    note = "" if record is not None else missing(f"There is no map yet; make one with `uncle map --run {run.root}`.")
    return table(("", ""), rows) + note


def mesh_section(run: RunDirectory, renderer: str, on_event: OnEvent) -> str:
    """Fresh pictures of the mesh, and the calibration of its sigma."""
    if not run.mesh_path.is_file():
        return missing(f"There is no mesh yet; make it with `uncle mesh --run {run.root}`.")
    mesh = load_run_mesh(run)
    reference = load_reference_mesh(run) if has_reference_mesh(run) else None
    snapshots = draw_mesh(mesh, snapshot_views(mesh, run), None, reference, renderer, on_event)
    counts = f"{format_grouped(len(mesh.vertices))} vertices, {format_grouped(len(mesh.faces))} triangles."
    pictures = [
        embed_picture(snapshot.save(run.snapshots_path).read_bytes(), _CAPTIONS[snapshot.mode], photographic=True)
        for snapshot in snapshots
    ]
    return explain(counts) + "\n".join(pictures) + _vertex_sigma(run)


def _vertex_sigma(run: RunDirectory) -> str:
    surface = _metrics(run).get("surface")
    scores = surface.get("vertex_sigma") if isinstance(surface, dict) else None
    curves = scores.get("curves") if isinstance(scores, dict) else None
    chart = vertex_sigma_chart(curves) if isinstance(curves, dict) else None
    return _embed_chart(chart, "Sigma of the vertices against their distance to the true surface.")


def sensors_section(run: RunDirectory, on_event: OnEvent) -> str:
    """Summary table, pictures, noise curves and calibration of every sensor but the ground truth."""
    frames = RunFrames(run)
    sheets = {path.stem.removeprefix("sensor_"): path for path in draw_sensors(run, run.snapshots_path, on_event)}
    metrics = _metrics(run)
    scores = metrics.get("uncertainty")
    samples = {sensor: collect_beta_samples(frames, sensor) for sensor in estimated_sensors(frames)}
    parts = [_summary(run, samples)]
    for sensor, sensor_samples in samples.items():
        parts.append(heading(f"Sensor {sensor}"))
        parts.append(fault_section(run, sensor))
        if sensor in sheets:
            picture = sheets[sensor].read_bytes()
            parts.append(embed_picture(picture, "All sensors share these colour scales.", photographic=True))
        else:
            parts.append(missing("No frame of this sensor can be read; redo it with `uncle preprocess --overwrite`."))
        parts.append(_noise(run, sensor, sensor_samples))
        parts.append(_calibration(sensor, scores.get(sensor) if isinstance(scores, dict) else None))
    caption = "Reliability diagram: predicted against empirical coverage of central intervals."
    parts.append(_embed_chart(reliability_chart(reliability_curves(metrics)), caption))
    return "\n".join(filter(None, parts)) or missing("The run has no sensor but the ground truth.")


def fault_section(run: RunDirectory, sensor: str) -> str:
    """Sentences on the faults of a sensor that the map stage detected; empty if there were none."""
    sensors = (_read_json(run.sensors_path) or {}).get("sensors")
    facts = sensors.get(sensor) if isinstance(sensors, dict) else None
    sentences = facts.get("sentences") if isinstance(facts, dict) else None
    return "".join(explain(str(sentence)) for sentence in sentences) if isinstance(sentences, list) else ""


def _summary(run: RunDirectory, samples: dict[str, BetaSamples | None]) -> str:
    """Weight share, reliability and betas of all sensors that have beta maps."""
    summaries = {
        sensor: summarise_sensor(sensor_samples, sensor_weight_summary(run, sensor))
        for sensor, sensor_samples in samples.items()
        if sensor_samples is not None
    }
    if not summaries:
        return ""
    header, rows = summary_table(summaries)
    text = "Weight share of each sensor in the map, and its beta: the expected absolute error of a measurement."
    return explain(text) + table(header, rows, numbers=range(1, len(header) - 1))


def _noise(run: RunDirectory, sensor: str, samples: BetaSamples | None) -> str:
    if samples is None:
        return missing(f"No beta maps: `uncle map --run {run.root}` learns them for the sensors that it maps.")
    caption = "Learned beta against the true mean absolute error; the curves of a calibrated sensor coincide."
    return embed_picture(noise_chart(sensor, noise_curves(samples)), caption, photographic=False)


def _calibration(sensor: str, scores: Any) -> str:
    curves = scores.get("curves") if isinstance(scores, dict) else None
    chart = uncertainty_calibration_chart(sensor, curves) if isinstance(curves, dict) else None
    return _embed_chart(chart, "Calibration of beta against the true depth (`uncle eval`).")


def _embed_chart(chart: bytes | None, caption: str) -> str:
    """A figure, or nothing without a chart."""
    return embed_picture(chart, caption, photographic=False) if chart else ""


def curves_section(run: RunDirectory) -> str:
    """Training curves of the map stage."""
    curves = _read_json(run.curves_path)
    chart = curves_chart(curves) if curves else None
    if chart is None:
        return missing(f"There are no curves; `uncle map --run {run.root}` writes them.")
    return embed_picture(chart, "Written by the map stage.", photographic=False)


def metrics_section(run: RunDirectory) -> str:
    """Every number of metrics.json."""
    try:
        run.require_current("eval")
    except RunError as error:
        return missing(str(error))
    metrics = _metrics(run)
    if not metrics:
        return missing(f"There are no scores; make them with `uncle eval --run {run.root}`.")
    ordered = {key: metrics[key] for key in (*_METRICS_ORDER, *metrics) if key in metrics}
    rows: list[tuple[str, ...]] = []
    group = None
    for row in metric_rows(ordered):
        if row.group != group:
            group = row.group
            rows.append((group or "run",))
        rows.append((row.name, row.value, row.unit))
    return table(("Metric", "Value", "Unit"), rows, numbers=(1,))


def stages_section(manifest: Manifest) -> str:
    """Times, facts and library versions of the finished stages."""
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


def configuration_section(run: RunDirectory) -> str:
    """The settings of the map."""
    try:
        return preformatted(read_bytes(run.config_path).decode(errors="replace"))
    except OSError:
        return missing(f"There is no configuration; `uncle map --run {run.root}` writes it.")


def _metrics(run: RunDirectory) -> dict[str, Any]:
    """metrics.json; empty where there is none, or it is not of the present mesh and map."""
    try:
        run.require_current("eval")
    except RunError:
        return {}
    return _read_json(run.metrics_path) or {}


def _read_json(path: Path) -> dict[str, Any] | None:
    """None where the file is missing, broken or no JSON object."""
    try:
        content = read_json(path)
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None
