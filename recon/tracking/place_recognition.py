"""Places seen before: found by features and verified by geometry."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ..core.camera import Camera
from .keyframe_graph import KeyframeGraph
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


def recognise_among_keyframes(
    graph: KeyframeGraph, view: FrameFeatures, descriptors: np.ndarray, excluded: Collection[int] = ()
) -> Place | None:
    """The keyframe, not `excluded`, that sees what `view` with `descriptors` (N, 128) sees."""
    candidates = {p: graph.landmarks_of(p) for p in graph.keyframes if p not in excluded}
    return recognise(graph.camera, view, descriptors, candidates, graph.landmarks, graph.seed)


def recognise(
    camera: Camera,
    view: FrameFeatures,
    descriptors: np.ndarray,
    candidates: dict[int, np.ndarray],
    landmarks: Landmarks,
    seed: int,
) -> Place | None:
    """The one of `candidates` (position -> numbers of landmarks) that `view` with `descriptors` (N, 128) shows, too.

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


def _some(landmarks: Landmarks, numbers: np.ndarray) -> np.ndarray:
    """Descriptors of at most about `_VOTES` of the landmarks."""
    chosen: np.ndarray = landmarks.descriptors[numbers[:: 1 + len(numbers) // _VOTES]]
    return chosen
