"""All tracked frames: which of them are keyframes, the landmarks they share and the motions measured between them."""

from __future__ import annotations

import numpy as np

from ..core.camera import Camera
from ..core.se3 import inverse, rotation_angle, transform
from .frame_to_frame import SurfaceView, align_views
from .landmarks import NONE, FrameFeatures, Landmarks
from .local_features import back_projected
from .pose_graph_edges import Measured

MIN_FEATURES = 20  # a frame with fewer follows its keyframe
NEIGHBOURS = 3  # keyframes before one whose surfaces it is aligned with
_SAME_VIEW_RAD = 0.6  # between keyframes whose surfaces are aligned
_NEW_DEPTH_SIGMA = 0.15  # of the depth: a less certain measurement makes no landmark
_NEAR = 0.8  # metres plus radians between keyframes that are near each other


class KeyframeGraph:
    """Frames in order, keyframes (as positions in `frames`) with their surfaces, and landmarks.

    edges: motions measured between keyframes; loops: pairs of an earlier and a later keyframe that were joined.
    """

    def __init__(self, camera: Camera, seed: int) -> None:
        self.camera, self.seed = camera, seed
        self.frames: list[FrameFeatures] = []
        self.keyframes: list[int] = []
        self.views: dict[int, SurfaceView] = {}  # of the keyframes
        self.edges: list[Measured] = []
        self.landmarks = Landmarks()
        self.loops: list[tuple[int, int]] = []

    # --- growth ------------------------------------------------------------------------------------------------
    def add(self, frame_features: FrameFeatures, descriptors: np.ndarray, view: SurfaceView | None) -> None:
        """Add a frame; with a `view` of the surface it is a keyframe, whose unmatched features become landmarks where
        they have depth. descriptors (N, 128) of the features."""
        self.frames.append(frame_features)
        if view is not None:
            self._add_landmarks(frame_features, descriptors)
            self.keyframes.append(len(self.frames) - 1)
            self.views[len(self.frames) - 1] = view
        frame_features.forget_unmatched()

    def measure_edges(self, newest: int, others: list[int]) -> None:
        """Measure the motion between the surface of a keyframe and those of others with about the same direction."""
        for other in others:
            between = inverse(self.frames[other].pose) @ self.frames[newest].pose
            if rotation_angle(between) > _SAME_VIEW_RAD:
                continue
            found = align_views(self.views[other], self.views[newest], between)
            if found is not None:
                self.edges.append((other, newest, *found))

    def move_with_keyframes(self, before: dict[int, np.ndarray], placed: set[int]) -> None:
        """Frames not in `placed` follow the last keyframe before them from where it was `before` (4, 4)."""
        keyframe = self.keyframes[0]
        for position, frame_features in enumerate(self.frames):
            keyframe = position if position in before else keyframe
            if position not in placed:
                frame_features.pose = self.frames[keyframe].pose @ inverse(before[keyframe]) @ frame_features.pose

    def _add_landmarks(self, frame_features: FrameFeatures, descriptors: np.ndarray) -> None:
        depth, sigma = frame_features.mean_depth()
        new = np.flatnonzero((frame_features.landmark == NONE) & (depth > 0) & (sigma < _NEW_DEPTH_SIGMA * depth))
        points = transform(
            frame_features.pose[None], back_projected(self.camera, frame_features.uv[new]) * depth[new, None]
        )
        frame_features.landmark[new] = self.landmarks.add(points, descriptors[new])

    # --- what is known -----------------------------------------------------------------------------------------
    @property
    def newest(self) -> int:
        """The last keyframe."""
        return self.keyframes[-1]

    def landmarks_of(self, position: int) -> np.ndarray:
        """The landmarks (K,) that a frame sees, distinct."""
        return self.landmarks.seen_by(self.frames[position])

    def keyframe_poses(self) -> dict[int, np.ndarray]:
        """T_world_camera (4, 4) of the keyframes."""
        return {k: self.frames[k].pose for k in self.keyframes}

    def well_constrained(self) -> list[int]:
        """The frames that enough features constrain."""
        return [p for p, s in enumerate(self.frames) if (s.landmark >= 0).sum() >= MIN_FEATURES]

    # --- neighbourhood -----------------------------------------------------------------------------------------
    def covisible(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For each keyframe, how many of the landmarks `numbers` (K,) it sees; keyframes and counts, most first."""
        marked = np.zeros(len(self.landmarks), bool)
        marked[numbers] = True
        shared = np.array([marked[self.landmarks_of(k)].sum() for k in self.keyframes])
        order = np.argsort(-shared, kind="stable")
        return np.array(self.keyframes)[order], shared[order]

    def near(self, pose: np.ndarray, count: int) -> list[int]:
        """At most `count` keyframes with about the position and direction of `pose` (4, 4), nearest first."""
        between = inverse(pose) @ np.stack([self.frames[k].pose for k in self.keyframes])
        apart = np.linalg.norm(between[:, :3, 3], axis=1) + rotation_angle(between)
        order = np.argsort(apart)[:count]
        return [self.keyframes[i] for i in order if apart[i] < _NEAR]

    def older_around(self, newest: int) -> list[int]:
        """Keyframes near `newest` that are older than its neighbours."""
        near = self.near(self.frames[newest].pose, 2 * NEIGHBOURS)
        return [k for k in near if k not in self.keyframes[-1 - NEIGHBOURS :]]

    def local_landmarks(self, pose: np.ndarray, numbers: np.ndarray, count: int = 6) -> np.ndarray:
        """Landmarks of the keyframes that share most with `numbers` (K,), of the newest one, and of those near
        `pose` (4, 4)."""
        positions, shared = self.covisible(numbers)
        chosen = {*positions[:count][shared[:count] > 0].tolist(), self.newest, *self.near(pose, 4)}
        return np.unique(np.concatenate([self.landmarks_of(p) for p in sorted(chosen)]))

    def spread_keyframes(self, count: int) -> list[int]:
        """The last keyframes, newest first, then some spread over those before them; `count` in all."""
        newest = self.keyframes[: -1 - count // 2 : -1]
        older = self.keyframes[: -len(newest)]
        if not older:
            return newest
        spread = np.unique(np.linspace(0, len(older) - 1, count - len(newest)).round().astype(int))
        return [*newest, *(older[i] for i in spread)]
