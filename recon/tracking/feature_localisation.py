"""Localisation of a frame by its features: against the landmarks around, or against those of any keyframe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.se3 import exceeds, inverse, transform
from .keyframe_graph import KeyframeGraph
from .landmarks import FrameFeatures
from .local_features import match, match_near, near_projections, project
from .localisation import Localisation
from .place_recognition import recognise_among_keyframes
from .pose_estimation import MIN_INLIERS, Term, feature_term, minimise, ransac_pose

SEARCH_PX = 10.0  # around where a landmark is expected
MAX_ERROR = 4.0  # sigmas: a match with more is an outlier
SURE_MATCHES = 30  # fewer are believed only near the expected pose
JOINT_ITERATIONS = 3  # from the pose that features give
_MAX_MOTION_M, _MAX_MOTION_RAD = 0.5, 0.8  # a few matches do not prove a larger motion within one frame


def localise_by_features(
    graph: KeyframeGraph, features: FrameFeatures, descriptors: np.ndarray, expected: np.ndarray
) -> Localisation | None:
    """Match to the landmarks around the `expected` pose (4, 4), whatever the motion was; then search the other
    landmarks where the pose predicts them. descriptors (N, 128) of the features."""
    camera = graph.camera
    numbers = graph.local_landmarks(expected, graph.landmarks.seen_by(graph.frames[-1]))
    points = graph.landmarks.points[numbers]
    similarity = descriptors @ graph.landmarks.descriptors[numbers].T
    pairs = match(similarity)
    first = ransac_pose(camera, points[pairs[:, 1]], features.uv[pairs[:, 0]], graph.seed)
    if first is None:
        return None
    pose, kept = first
    if len(kept) < SURE_MATCHES and exceeds(inverse(expected) @ pose, _MAX_MOTION_M, _MAX_MOTION_RAD):
        return None
    pose, _ = minimise(pose, [feature_term(camera, points, features.observations(*pairs[kept].T))])
    pairs = match_near(similarity, near_projections(camera, pose, points, features.uv, SEARCH_PX))
    found = _from_matches(graph, features, pose, pairs[:, 0], numbers[pairs[:, 1]])
    return found if len(found.rows) >= MIN_INLIERS else None


def relocalise_by_features(
    graph: KeyframeGraph, features: FrameFeatures, descriptors: np.ndarray
) -> Localisation | None:
    """Localise against all keyframes, wherever the camera was before."""
    place = recognise_among_keyframes(graph, features, descriptors)
    if place is None:
        return None
    found = _from_matches(graph, features, place.pose, place.rows, place.numbers)
    return found if len(found.rows) >= SURE_MATCHES // 2 else None


def refine_jointly(
    graph: KeyframeGraph, features: FrameFeatures, found: Localisation, others: Sequence[Term] = ()
) -> Localisation:
    """The pose that minimises the sum of the residuals of its features and of `others`."""
    observations = features.observations(found.rows, found.numbers)
    terms = [feature_term(graph.camera, graph.landmarks.points, observations), *others]
    pose, information = minimise(found.pose, terms, JOINT_ITERATIONS)
    return Localisation(pose, information, found.rows, found.numbers)


def _from_matches(
    graph: KeyframeGraph, features: FrameFeatures, pose: np.ndarray, rows: np.ndarray, numbers: np.ndarray
) -> Localisation:
    """The pose from matches of features `rows` (K,) to landmarks `numbers` (K,), and those that agree with it."""
    camera, points = graph.camera, graph.landmarks.points
    for _ in range(2):
        pose, information = minimise(pose, [feature_term(camera, points, features.observations(rows, numbers))])
        local = transform(inverse(pose)[None], points[numbers])
        off = (project(camera, local) - features.uv[rows]) / features.sigma_px[rows, None]
        kept = ((off**2).sum(1) < MAX_ERROR**2) & (local[:, 2] > 0)
        rows, numbers = rows[kept], numbers[kept]
    return Localisation(pose, information, rows, numbers)
