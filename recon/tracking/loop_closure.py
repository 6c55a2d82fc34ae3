"""Loops: a keyframe joined with one that saw the same place before, and the error spread over those between."""

from __future__ import annotations

import numpy as np

from ..core.se3 import exceeds, inverse, transform
from .graph_adjustment import adjust_globally
from .keyframe_graph import KeyframeGraph
from .landmarks import NONE
from .place_recognition import Place, recognise_among_keyframes

_KNOWN_SHARE = 20  # landmarks in common that make two keyframes neighbours: nothing to recognise
_LEFT_M, _LEFT_RAD = 0.1, 0.1  # what may be left of a loop's error when all keyframes shared it
_TRACKED_M, _TRACKED_RAD = 0.02, 0.02  # of a motion between keyframes that their surfaces do not determine
_JUMP_M, _JUMP_RAD = 0.02, 0.02  # a loop that is off by more corrects the graph before bundle adjustment
_ITERATIONS = 10  # of the global adjustment after a loop


def close_by_features(graph: KeyframeGraph) -> None:
    """Recognise the newest keyframe's view among those that are no neighbours of it; join and correct."""
    newest = graph.newest
    view, numbers = graph.frames[newest], graph.landmarks_of(newest)
    positions, shared = graph.covisible(numbers)
    neighbours = {*positions[shared >= _KNOWN_SHARE].tolist(), *graph.keyframes[-3:]}
    current = graph.landmarks.current(view.landmark)
    place = recognise_among_keyframes(graph, view, graph.landmarks.descriptors[current], neighbours)
    if place is None:
        return
    jumps = exceeds(inverse(view.pose) @ place.pose, _JUMP_M, _JUMP_RAD)
    if jumps and not distribute_loop_error(graph, place):
        return
    graph.loops.append((place.keyframe, newest))
    graph.measure_edges(newest, [place.keyframe])
    graph.landmarks.merge(view.landmark[place.rows], place.numbers)
    if jumps:  # what is only joined is corrected by the local adjustments, and by the global one at the end
        adjust_globally(graph, _ITERATIONS)


def close_by_surface(graph: KeyframeGraph) -> None:
    """Without features: align the newest keyframe with older ones that are near by what is known so far."""
    (previous, newest), measured = graph.keyframes[-2:], len(graph.edges)
    if not any(newest == later for _, later, *_ in graph.edges):  # what was tracked connects the two
        motion = inverse(graph.frames[previous].pose) @ graph.frames[newest].pose
        graph.edges.append((previous, newest, motion, np.diag([_TRACKED_M**-2] * 3 + [_TRACKED_RAD**-2] * 3)))
        measured += 1
    graph.measure_edges(newest, graph.older_around(newest))
    graph.loops += [(first, newest) for first, *_ in graph.edges[measured:]]
    known = inverse(graph.frames[newest].pose)
    off = [known @ graph.frames[first].pose @ motion for first, _, motion, _ in graph.edges[measured:]]
    if any(exceeds(each, _JUMP_M, _JUMP_RAD) for each in off):
        adjust_globally(graph, _ITERATIONS)


def distribute_loop_error(graph: KeyframeGraph, place: Place) -> bool:
    """Spread the error of a loop over the keyframes; landmarks and frames move with theirs.

    Returns False, and moves nothing, if the rest contradicts the loop.
    """
    before = graph.keyframe_poses()
    order = {k: i for i, k in enumerate(graph.keyframes)}
    earlier, later = place.keyframe, graph.newest
    loops = [(order[a], order[b], inverse(before[a]) @ before[b]) for a, b in graph.loops]
    loops.append((order[earlier], order[later], inverse(before[earlier]) @ place.pose))
    poses = corrected_poses(np.stack([before[k] for k in graph.keyframes]), loops)
    left = inverse(loops[-1][2]) @ inverse(poses[order[earlier]]) @ poses[order[later]]
    if exceeds(left, _LEFT_M, _LEFT_RAD):
        return False
    owner = np.full(len(graph.landmarks), NONE)
    for k in reversed(graph.keyframes):  # a landmark belongs to the first keyframe that saw it
        owner[graph.landmarks_of(k)] = k
    points = graph.landmarks.points
    for k, pose in zip(graph.keyframes, poses, strict=True):
        graph.frames[k].pose = pose
        mine = owner == k
        points[mine] = transform((pose @ inverse(before[k]))[None], points[mine])
    graph.move_with_keyframes(before, set(graph.keyframes))
    return True


def corrected_poses(poses: np.ndarray, loops: list[tuple[int, int, np.ndarray]]) -> np.ndarray:
    """Poses (K, 4, 4) of the keyframes in order after robust pose-graph optimisation (Open3D, Levenberg-Marquardt).

    `loops`: (earlier, later, T_earlier_later), as places of `poses`. The first pose holds; a loop that contradicts the
    rest is switched off by its line process (Choi et al. 2015).
    """
    import open3d as o3d

    registration = o3d.pipelines.registration
    graph = registration.PoseGraph()
    for pose in poses:
        graph.nodes.append(registration.PoseGraphNode(pose))
    steps = [(i, i + 1, inverse(poses[i]) @ poses[i + 1], False) for i in range(len(poses) - 1)]
    for first, second, T_first_second, uncertain in [*steps, *((*loop, True) for loop in loops)]:
        # Open3D's edge holds T_target_source.
        edge = registration.PoseGraphEdge(second, first, T_first_second, np.eye(6) * 100.0, uncertain)
        graph.edges.append(edge)
    option = registration.GlobalOptimizationOption(
        max_correspondence_distance=0.1, edge_prune_threshold=0.25, preference_loop_closure=5.0, reference_node=0
    )
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        registration.global_optimization(
            graph, registration.GlobalOptimizationLevenbergMarquardt(),
            registration.GlobalOptimizationConvergenceCriteria(), option,
        )  # fmt: skip
    result = np.stack([node.pose for node in graph.nodes])
    return result if np.isfinite(result).all() else poses
