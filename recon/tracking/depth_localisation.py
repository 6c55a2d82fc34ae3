"""Localisation of a frame by its depth: against the map, against the last keyframe, or against any keyframe."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..volume.tsdf_volume import TsdfVolume
from .depth_only import SurfacePose, align_to_tsdf, expectation, relocalise_by_surface, track_from_keyframe
from .frame_to_frame import SurfaceView
from .frame_to_model import Readings, scaled, surface_term
from .keyframe_graph import KeyframeGraph
from .localisation import Localisation, UsualResidual
from .pose_estimation import Term

_PLACES = 8  # keyframes at which a lost camera without features is searched


class DepthLocaliser:
    """Localises by depth samples, and without features by the surface that a frame shows.

    usual: residual to the surface that poses had so far; one with a much larger residual is rejected.
    """

    def __init__(self, volume: TsdfVolume, graph: KeyframeGraph) -> None:
        self.volume, self.graph = volume, graph
        self.usual = UsualResidual()

    def on_device(self, readings: Readings | None) -> Readings | None:
        """Depth samples on the device of the map."""
        return None if readings is None else readings.to(self.volume.grid.device)

    def term(self, readings: Readings) -> Term:
        """Residuals to the surface and to its colour, for a joint refinement."""
        return surface_term(self.volume, readings)

    def update_usual(self, readings: Readings, pose: np.ndarray) -> None:
        """Take in the residual of a pose (4, 4) that was found by features."""
        self.usual.accepts(scaled(self.volume, readings, pose).scale)

    def near(self, readings: Readings, expected: np.ndarray) -> Localisation | None:
        """By the map alone; the expected motion constrains directions that the surface does not show."""
        last = self.graph.frames[-1].pose
        found = align_to_tsdf(self.volume, readings, expected, expectation(last, expected))
        return None if found is None or not self.usual.accepts(found.scale) else _localisation(found)

    def from_last_keyframe(
        self, view: SurfaceView, readings: Readings, expected: np.ndarray, lost_frames: int
    ) -> Localisation | None:
        """Without features: by the surface of the last keyframe, then by the map."""
        newest, last = self._keyframe(self.graph.newest), self.graph.frames[-1].pose
        return self._first(track_from_keyframe(self.volume, readings, view, newest, last, expected, lost_frames))

    def from_any_keyframe(self, view: SurfaceView, readings: Readings) -> Localisation | None:
        """Without features: as if the camera were where some keyframe was."""
        keyframes = [self._keyframe(k) for k in self.graph.spread_keyframes(_PLACES)]
        return self._first(relocalise_by_surface(self.volume, readings, view, keyframes))

    def _keyframe(self, position: int) -> tuple[SurfaceView, np.ndarray]:
        return self.graph.views[position], self.graph.frames[position].pose

    def _first(self, candidates: Iterator[SurfacePose]) -> Localisation | None:
        """The first candidate with a usual residual, in sigmas that do not change while noise is learned."""
        return next((_localisation(found) for found in candidates if self.usual.accepts(found.fit)), None)


def _localisation(found: SurfacePose) -> Localisation:
    return Localisation(found.pose, found.information, shown=found.shown)
