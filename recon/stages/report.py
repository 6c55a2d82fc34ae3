"""The `report` stage: everything that a run can show, on one HTML page that needs no other file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..core.errors import DependencyError, UncleError
from ..core.events import OnEvent, Progress, Warn, ignore
from ..core.files import write_text
from ..core.html import Section, missing, page
from ..run.directory import RunDirectory
from ..run.lock import writing
from ..visualization.report_sections import report_sections

STAGE = "report"


def report_run(run: RunDirectory, renderer: str = "auto", on_event: OnEvent = ignore) -> Path:
    """Write RUN/report.html, with fresh snapshots of the run's mesh, camera and sensors; returns its path.

    What the run does not hold is named on the page with the command that makes it. Raises RunError if there is no run,
    its map or mesh is not of the present frames, or another process writes into it; DependencyError if the chosen
    renderer does not run.
    """
    with writing(run, STAGE, on_event):
        run.require_current("preprocess", "map", "mesh")
        return _write_page(run, renderer, on_event)


def _write_page(run: RunDirectory, renderer: str, on_event: OnEvent) -> Path:
    manifest = run.load_manifest()
    parts = report_sections(run, renderer, on_event)
    sections = []
    for done, (title, build) in enumerate(parts):
        on_event(Progress(STAGE, done, len(parts), "sections"))
        sections.append(Section(title, _build_or_explain(title, build, on_event)))
    lead = f"{', '.join(manifest.sensors)} · {manifest.dataset_format} · run directory {run.root}"
    write_text(run.report_path, page(f"Reconstruction of {manifest.name}", lead, sections))
    on_event(Progress(STAGE, len(parts), len(parts), "sections"))
    return run.report_path


def _build_or_explain(title: str, build: Callable[[], str], on_event: OnEvent) -> str:
    """The HTML of a section, or the error in its place; a missing library stops the whole report."""
    try:
        return build()
    except DependencyError:
        raise
    except UncleError as error:
        on_event(Warn(f"{title}: {error}"))
        return missing(str(error))
