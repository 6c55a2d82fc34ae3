"""The `inspect` stage: whether the parts of a recording, or the frames of a run, fit one another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..core.config.uncle import FusionConfig
from ..core.correction import Correction
from ..core.errors import ConfigError, DataError
from ..core.events import Note, OnEvent, Warn, ignore
from ..core.files import write_text
from ..core.frame import Recording
from ..core.html import Section, page
from ..evaluation.inspection.correspondences import InspectedFrames
from ..evaluation.inspection.findings import Verdict
from ..evaluation.inspection.inspector import THOROUGH, Inspection, inspect_recording
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..visualization.inspection_pages import findings_table, inspection_pictures

MAX_DEPTH_M = FusionConfig().max_depth_m  # as the map takes it unless it is set


def inspect_dataset(
    recording: Recording, sensors: Sequence[str] = (), report: Path | None = None, on_event: OnEvent = ignore
) -> Inspection:
    """Inspect a recording; `report` is a file for a page with pictures.

    Raises DataError (nothing can be read), ConfigError (no such sensor), RunError (the page cannot be written).
    """
    inspection = _inspect(recording, recording.has_timestamps, sensors, on_event)
    if report is not None:
        _write_page(report, recording.name, inspection, inspection_pictures(recording, sensors))
    return inspection


def inspect_run(
    run: RunDirectory, sensors: Sequence[str] = (), report: Path | None = None, on_event: OnEvent = ignore
) -> Inspection:
    """Inspect the frames of a run, like `inspect_dataset`. Raises RunError if it has none."""
    manifest = run.load_manifest()
    frames = RunFrames(run)
    inspection = _inspect(frames, manifest.has_timestamps, sensors, on_event)
    if report is not None:
        _write_page(report, manifest.name, inspection, inspection_pictures(frames, sensors))
    return inspection


def require_fitting(inspection: Inspection, *, fix: bool, force: bool, on_event: OnEvent = ignore) -> Correction | None:
    """What `uncle preprocess` does with an inspection: tell doubts, stop at a wrong finding, or return its correction.

    Only how the parts of the recording fit is judged here; images that cannot be used are reported as they are read.

    fix     apply what can be mended, and stop only at what cannot
    force   go on in any case

    Raises DataError with the finding and what to do.
    """
    for finding in inspection.fit:
        if finding.verdict is Verdict.DOUBT or (force and finding.verdict is Verdict.WRONG):
            on_event(Warn(f"{finding.check}: {finding.full_text}"))
    wrong = [finding for finding in inspection.fit if finding.verdict is Verdict.WRONG]
    if force or not wrong:
        return None
    mended = [finding for finding in wrong if fix and finding.correction is not None]
    for finding in wrong:
        if finding not in mended:
            raise DataError(f"{finding.check}: {finding.full_text}; or go on as it is with --force")
    for finding in mended:
        on_event(Note(f"mended: {finding.check}: {finding.text}"))
    return inspection.correction


def _inspect(frames: InspectedFrames, has_timestamps: bool, sensors: Sequence[str], on_event: OnEvent) -> Inspection:
    unknown = [name for name in sensors if name not in frames.sensors]
    if unknown:
        raise ConfigError(f"there is no sensor {unknown[0]!r}; there are: {', '.join(frames.sensors)}")
    return inspect_recording(
        frames,
        has_timestamps=has_timestamps,
        max_depth_m=MAX_DEPTH_M,
        sensors=sensors,
        effort=THOROUGH,
        on_event=on_event,
    )


def _write_page(path: Path, name: str, inspection: Inspection, pictures: str) -> None:
    first = inspection.first
    lead = "Everything that was checked fits." if first is None else f"First: {first.check}: {first.text}"
    sections = [Section("Findings", findings_table(inspection.findings)), Section("Pictures", pictures)]
    write_text(path, page(f"Inspection of {name}", lead, sections))
