"""Places seen before: found by features, verified by geometry, and made to agree by a robust pose graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.camera import Camera
from ..core.se3 import inverse
from .landmarks import FrameFeatures, Landmarks
from .local_features import match
from .pose_estimation import feature_term, minimise, ransac_pose

MIN_MATCHES = 25
MIN_SHARE = 0.3  # of the matches that must agree with one motion
_VOTES = 300  # landmarks of a keyframe that are compared
_CANDIDATES = 3


@dataclass(frozen=True)
class Place:
    """A view that agrees with an earlier keyframe. `pose` (4, 4) of the view as that keyframe's landmarks give it;
    `rows` (K,) features of the view and `numbers` (K,) the landmarks they are of; `keyframe` a position."""

    keyframe: int
    pose: np.ndarray
    rows: np.ndarray
    numbers: np.ndarray


def recognise(
    camera: Camera,
    view: FrameFeatures,
    descriptors: np.ndarray,
    candidates: dict[int, np.ndarray],
    landmarks: Landmarks,
    seed: int,
) -> Place | None:
    """Where `view` with `descriptors` (N, 128) looks at the landmarks of one of `candidates` (position -> numbers).

    The keyframes with most matches are tried; enough of the matches must agree with one motion of the camera.
    """
    votes = {p: len(match(descriptors[:: 1 + len(descriptors) // _VOTES] @ _some(landmarks, n).T))
             for p, n in candidates.items()}  # fmt: skip
    for keyframe in sorted(votes, key=lambda p: -votes[p])[:_CANDIDATES]:
        numbers = candidates[keyframe]
        pairs = match(descriptors @ landmarks.descriptors[numbers].T)
        if len(pairs) < MIN_MATCHES:
            continue
        points = landmarks.points[numbers[pairs[:, 1]]]
        found = ransac_pose(camera, points, view.uv[pairs[:, 0]], seed)
        if found is None or len(found[1]) < max(MIN_MATCHES, MIN_SHARE * len(pairs)):
            continue
        kept = pairs[found[1]]
        seen = view.observations(kept[:, 0], np.arange(len(kept)))
        pose, _ = minimise(found[0], [feature_term(camera, points[found[1]], seen)])
        return Place(keyframe, pose, kept[:, 0], numbers[kept[:, 1]])
    return None


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


def _some(landmarks: Landmarks, numbers: np.ndarray) -> np.ndarray:
    """Descriptors of at most about `_VOTES` of the landmarks."""
    return landmarks.descriptors[numbers[:: 1 + len(numbers) // _VOTES]]
