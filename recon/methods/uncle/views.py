"""Frames with what the reconstruction derives from them, prepared in the background."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ...core.camera import Camera
from ...core.events import OnEvent, Progress
from ...core.frame import Frame
from ...sensors.noise_inputs import pixel_inputs
from .state import ReconstructionState


@dataclass(frozen=True)
class View:
    """A frame, the noise model inputs (H, W, F) of each sensor, and what the tracker prepared."""

    frame: Frame
    inputs: dict[str, Tensor]
    prepared: Any = None


def noise_inputs(frame: Frame, normals: dict[str, Tensor], camera: Camera) -> dict[str, Tensor]:
    """(H, W, F) input of the noise model of each sensor; normals (H, W, 3) by sensor."""
    return {s: pixel_inputs(depth, normals[s], frame.color, camera) for s, depth in frame.depths.items()}


def stream_views(state: ReconstructionState, indices: Sequence[int], for_tracking: bool = False) -> Iterator[View]:
    """Views of some frames, without the sensors that were found faulty in them; inputs only with uncertainty on.

    The next views are prepared in the background while one is being used.
    """
    frames, tracker = state.frames, state.tracker

    def prepare(frame: Frame) -> View:
        frame = state.faults.without_faulty(frame)
        normals = {sensor: frames.normals(frame.index, sensor) for sensor in frames.sensors}
        inputs = noise_inputs(frame, normals, frames.camera) if state.config.uncertainty.enabled else {}
        return View(frame, inputs, tracker.prepare(frame, normals) if for_tracking else None)

    return frames.stream(indices, prepare)


def views_of_pass(state: ReconstructionState, indices: Sequence[int], on_event: OnEvent) -> Iterator[View]:
    """The remaining views of the current pass, with progress reported."""
    progress, online = state.progress, state.progress.current_pass == 0
    stage = f"integrating, pass {progress.current_pass + 1}"
    if online:
        stage = "tracking and mapping" if state.config.tracking.enabled else "mapping"
    for view in stream_views(state, indices[progress.position :], for_tracking=online):
        on_event(Progress(stage, progress.position, len(indices)))
        yield view
    on_event(Progress(stage, len(indices), len(indices)))
