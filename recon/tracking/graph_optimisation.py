"""Keeping a keyframe graph consistent: after each keyframe, and when all frames were tracked."""

from __future__ import annotations

from .graph_adjustment import adjust_globally, adjust_locally, place_on_landmarks, reoptimise_outlier_frames
from .keyframe_graph import NEIGHBOURS, KeyframeGraph
from .loop_closure import close_by_features, close_by_surface


def optimise_after_keyframe(graph: KeyframeGraph) -> None:
    """Align the surface of the newest keyframe, adjust what it sees, and close loops."""
    if len(graph.keyframes) < 2:
        return
    graph.measure_edges(graph.newest, graph.keyframes[-1 - NEIGHBOURS : -1])
    if graph.frames[graph.newest].common_px > 0:  # surfaces constrain what pixels with a common error cannot
        graph.measure_edges(graph.newest, graph.older_around(graph.newest))
    if len(graph.landmarks) == 0:
        close_by_surface(graph)
        return
    adjust_locally(graph)
    close_by_features(graph)


def optimise_all(graph: KeyframeGraph) -> None:
    """Adjust everything; where pixels share an error, then place every frame on the landmarks. Frames that lie far
    from where their neighbours predict them are adjusted again."""
    adjust_globally(graph)
    if any(s.common_px > 0 for s in graph.frames):
        place_on_landmarks(graph)
    reoptimise_outlier_frames(graph)
