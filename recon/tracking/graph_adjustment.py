"""Bundle adjustment of parts of a keyframe graph: around the newest keyframe, of the whole, of single frames."""

from __future__ import annotations

import numpy as np

from .bundle_adjustment import adjust, covariances
from .keyframe_graph import MIN_FEATURES, KeyframeGraph
from .landmarks import observations_of, seen_at_least
from .observations import Observations, without_outliers
from .outlier_poses import reoptimise_outliers
from .pose_graph_edges import edges_among

LOCAL_KEYFRAMES = 8
MAX_CAMERAS = 250  # adjusted together with all points; frames between them follow
_LOCAL_ITERATIONS = 4
_MIN_SHARED = 10  # landmarks that a keyframe shares with the local ones to hold them
_OUTLIER = 5.0  # sigmas


def adjust_locally(graph: KeyframeGraph) -> None:
    """Adjust the newest keyframe and those that share most with it; others that see the same hold still."""
    newest = graph.newest
    positions, shared = graph.covisible(graph.landmarks_of(newest))
    window = [newest, *(p for p, s in zip(positions[:LOCAL_KEYFRAMES], shared, strict=False) if s and p != newest)]
    inside = np.unique(np.concatenate([graph.landmarks_of(p) for p in window]))
    positions, shared = graph.covisible(inside)
    outside = [p for p, s in zip(positions, shared, strict=True) if p not in window and s >= _MIN_SHARED]
    cameras = [*window, *outside[: 2 * LOCAL_KEYFRAMES]]
    free = np.array([p in window and p != graph.keyframes[0] for p in cameras])
    if free.all():  # something must hold the rest
        free[int(np.argmin(cameras))] = False
    adjust_frames(graph, cameras, free, _LOCAL_ITERATIONS)


def adjust_globally(graph: KeyframeGraph, iterations: int = 30) -> None:
    """Adjust the whole recording: some cameras with all points, then the frames between them."""
    strong = graph.well_constrained() if len(graph.landmarks) else list(graph.keyframes)
    cameras = _with_points(graph, strong)
    if len(cameras) < 2:
        return
    before = graph.keyframe_poses()
    adjust_frames(graph, cameras, _all_but_first(graph, cameras), iterations)
    # Else what the frames between see of landmarks that moved is dropped as outliers.
    graph.move_with_keyframes(before, set(cameras))
    if others := sorted(set(strong) - set(cameras)):
        adjust_frames(graph, others, np.ones(len(others), bool), 10, free_points=False)


def place_on_landmarks(graph: KeyframeGraph) -> None:
    """Adjust each frame by itself; landmarks hold still, and all frames without enough features follow."""
    frames, before = graph.well_constrained(), graph.keyframe_poses()
    if not frames:
        return
    adjust_frames(graph, frames, _all_but_first(graph, frames), 10, free_points=False)
    graph.move_with_keyframes(before, {*frames})


def reoptimise_outlier_frames(graph: KeyframeGraph) -> None:
    """Adjust the frames between keyframes that lie far from where their neighbours predict them; keyframes hold each
    other. Every pixel counts whole, see `Observations.with_whole_pixels`."""
    frames = graph.well_constrained()
    if not frames:
        return
    observations, numbers = observations_of([graph.frames[p] for p in frames], graph.landmarks)
    observations = observations.with_whole_pixels()
    poses = np.stack([graph.frames[p].pose for p in frames])
    times = np.array([graph.frames[p].index for p in frames], np.float64)
    free = ~np.isin(frames, graph.keyframes)
    found = reoptimise_outliers(graph.camera, poses, times, graph.landmarks.points[numbers], observations, free)
    for position, pose in zip(frames, found, strict=True):
        graph.frames[position].pose = pose


def pose_covariances(graph: KeyframeGraph) -> dict[int, np.ndarray]:
    """Covariance (6, 6) of each frame's pose, metres and radians, against the first keyframe (zero for that one), by
    position; of the frames that enough features constrain."""
    strong = graph.well_constrained()
    cameras = _with_points(graph, strong)
    if len(cameras) < 2:
        return {}
    poses, points, observations, _ = _problem(graph, cameras, _OUTLIER)
    observations = observations[seen_at_least(observations, 2)]
    free, edges = _all_but_first(graph, cameras), edges_among(graph.edges, cameras)
    found = covariances(graph.camera, poses, points, observations, free, edges)
    held = np.bincount(observations.camera, minlength=len(cameras)) >= MIN_FEATURES
    held |= ~free  # the first keyframe is where it is
    nearest = np.searchsorted(cameras, strong).clip(max=len(cameras) - 1)
    return {p: found[i] for p, i in zip(strong, nearest, strict=True) if held[i]}


def adjust_frames(
    graph: KeyframeGraph, positions: list[int], free: np.ndarray, iterations: int, free_points: bool = True
) -> None:
    """Adjust frames, of which `free` (C,) move, and, if `free_points`, the landmarks that they see.

    Does nothing without frames, or without any measurement of them.
    """
    if not positions:
        return
    poses, points, observations, numbers = _problem(graph, positions, 3 * _OUTLIER)
    observations = observations[seen_at_least(observations, 2)] if free_points else observations.with_whole_pixels()
    edges = edges_among(graph.edges, positions)
    if len(observations) == 0 and (len(graph.landmarks) or edges is None):
        return
    first = max(2, iterations // 2)
    result = adjust(
        graph.camera, poses, points, observations, free, free_points=free_points, iterations=first, edges=edges
    )
    kept = without_outliers(graph.camera, result.poses, result.points, observations, _OUTLIER)
    result = adjust(
        graph.camera, result.poses, result.points, kept, free,
        free_points=free_points, iterations=iterations - first, edges=edges,
    )  # fmt: skip
    for position, pose, moves in zip(positions, result.poses, free, strict=True):
        if moves:
            graph.frames[position].pose = pose
    if free_points:
        seen = np.unique(kept.point)
        graph.landmarks.points[numbers[seen]] = result.points[seen]


def _problem(
    graph: KeyframeGraph, positions: list[int], limit: float
) -> tuple[np.ndarray, np.ndarray, Observations, np.ndarray]:
    """Poses (C, 4, 4) of frames, the points (P, 3) they see, the observations within `limit` sigmas, and the number
    (P,) of each point's landmark."""
    frames = [graph.frames[p] for p in positions]
    observations, numbers = observations_of(frames, graph.landmarks)
    poses, points = np.stack([s.pose for s in frames]), graph.landmarks.points[numbers]
    return poses, points, without_outliers(graph.camera, poses, points, observations, limit), numbers


def _with_points(graph: KeyframeGraph, strong: list[int]) -> list[int]:
    """Those of the frames `strong` that are adjusted together with all points: all, or keyframes and every n-th."""
    stride = -(-len(strong) // MAX_CAMERAS) or 1
    return sorted({*strong[::stride], *graph.keyframes}) if stride > 1 else strong


def _all_but_first(graph: KeyframeGraph, positions: list[int]) -> np.ndarray:
    """(C,) which of the frames are not the first keyframe, which defines the world."""
    return np.array([p != graph.keyframes[0] for p in positions])
