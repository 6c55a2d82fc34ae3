"""Keyframes, what they share, and keeping them consistent: local and global bundle adjustment, loops."""

from __future__ import annotations

import numpy as np

from ..core.camera import Camera
from ..core.se3 import exceeds, inverse, rotation_angle, transform
from .bundle_adjustment import Observations, adjust, covariances, without_outliers
from .frame_to_frame import SurfaceView, align_views
from .landmarks import NONE, FrameFeatures, Landmarks, observations_of, seen_at_least
from .local_features import back_projected
from .loop_closure import Place, corrected_poses, recognise
from .outlier_poses import reoptimise_outliers
from .pose_graph_edges import Measured, edges_among

LOCAL_KEYFRAMES = 8
NEIGHBOURS = 3  # keyframes before one whose surfaces it is aligned with
_SAME_VIEW_RAD = 0.6
_LOCAL_ITERATIONS = 4
_OUTLIER = 5.0  # sigmas
_MAX_CAMERAS = 250  # adjusted together with all points; frames between them follow
_MIN_FEATURES = 20  # a frame with fewer follows its keyframe
_NEW_DEPTH_SIGMA = 0.15  # of the depth: a reading less certain makes no landmark
_KNOWN_SHARE = 20  # landmarks in common that make two keyframes neighbours: nothing to recognise
_LEFT_M, _LEFT_RAD = 0.1, 0.1  # what may be left of a loop's error when all keyframes shared it
_TRACKED_M, _TRACKED_RAD = 0.02, 0.02  # of a motion between keyframes whose surfaces do not say it
_JUMP_M, _JUMP_RAD = 0.02, 0.02  # a loop that is off by more bends the graph before bundle adjustment


class KeyframeGraph:
    """All sightings in order, which of them are keyframes (positions in `frames`), and the landmarks they share."""

    def __init__(self, camera: Camera, seed: int) -> None:
        self.camera, self.seed = camera, seed
        self.frames: list[FrameFeatures] = []
        self.keyframes: list[int] = []
        self.views: dict[int, SurfaceView] = {}  # of the keyframes
        self.edges: list[Measured] = []
        self.landmarks = Landmarks()
        self.loops: list[tuple[int, int]] = []  # earlier and later keyframe

    def add(self, frame_features: FrameFeatures, descriptors: np.ndarray, view: SurfaceView | None) -> None:
        """Remember a frame; one with a `view` of the surface is a keyframe: it lends its unmatched features, where they
        have depth, as new landmarks, and what was seen before is made consistent."""
        self.frames.append(frame_features)
        newest = len(self.frames) - 1
        if view is not None:
            self._add_landmarks(frame_features, descriptors)
            self.keyframes.append(newest)
            self.views[newest] = view
        frame_features.forget_unmatched()
        if view is None or len(self.keyframes) < 2:
            return
        self._align_surfaces(newest, self.keyframes[-1 - NEIGHBOURS : -1])
        if frame_features.common_px > 0:  # surfaces hold what pixels cannot
            self._align_surfaces(newest, self._older_around(newest))
        if len(self.landmarks) == 0:
            self._close_by_surface()
            return
        self._adjust_locally()
        self._close_loop()

    def numbers(self, position: int) -> np.ndarray:
        """The landmarks (K,) that a frame sees, distinct."""
        return self.landmarks.seen_by(self.frames[position])

    def local_landmarks(self, pose: np.ndarray, numbers: np.ndarray, count: int = 6) -> np.ndarray:
        """Landmarks of the keyframes that share most with `numbers`, of the newest one, and of the nearest in view."""
        positions, shared = self._covisible(numbers)
        chosen = {*positions[:count][shared[:count] > 0].tolist(), self.keyframes[-1], *self._near(pose, 4)}
        return np.unique(np.concatenate([self.numbers(p) for p in sorted(chosen)]))

    def spread_keyframes(self, count: int) -> list[int]:
        """The last keyframes, newest first, then as many spread over those before them; `count` in all."""
        newest = self.keyframes[: -1 - count // 2 : -1]
        older = self.keyframes[: -len(newest)]
        spread = np.unique(np.linspace(0, len(older) - 1, count - len(newest)).round().astype(int)) if older else []
        return [*newest, *(older[i] for i in spread)]

    def recognise(self, view: FrameFeatures, descriptors: np.ndarray, but: set[int] = frozenset()) -> Place | None:
        """The keyframe, not in `but`, that sees what `view` sees."""
        candidates = {p: self.numbers(p) for p in self.keyframes if p not in but}
        return recognise(self.camera, view, descriptors, candidates, self.landmarks, self.seed)

    def adjust_globally(self, iterations: int = 30) -> None:
        """Bundle adjustment of the whole recording: some cameras with all points, then the frames between them."""
        strong = self._well_constrained() if len(self.landmarks) else list(self.keyframes)
        cameras = self._cameras(strong)
        if len(cameras) < 2:
            return
        before = {k: self.frames[k].pose for k in self.keyframes}
        self._adjust(cameras, self._all_but_first(cameras), iterations)
        self._propagate_to_frames(
            before, set(cameras)
        )  # else what others see of landmarks that moved is dropped as outliers
        if others := sorted(set(strong) - set(cameras)):
            self._adjust(others, np.ones(len(others), bool), 10, free_points=False)

    def finish(self) -> None:
        """Adjust all; where pixels share an error, then place every frame on the landmarks, which hold still. Frames
        that lie where nobody expects them are placed again."""
        self.adjust_globally()
        frames = self._well_constrained()
        if frames and any(s.common_px > 0 for s in self.frames):
            before = {k: self.frames[k].pose for k in self.keyframes}
            self._adjust(frames, self._all_but_first(frames), 10, free_points=False)
            self._propagate_to_frames(before, {*frames})
        self._repair_outlier_poses()

    def covariances(self) -> dict[int, np.ndarray]:
        """Covariance (6, 6) of each frame's pose, metres and radians, against the first keyframe (zero for that one),
        by position; of the frames that enough features hold."""
        strong = self._well_constrained()
        cameras = self._cameras(strong)
        if len(cameras) < 2:
            return {}
        poses, points, observations, _ = self._seen_by(cameras, _OUTLIER)
        observations = observations[seen_at_least(observations, 2)]
        free, edges = self._all_but_first(cameras), edges_among(self.edges, cameras)
        found = covariances(self.camera, poses, points, observations, free, edges)
        held = np.bincount(observations.camera, minlength=len(cameras)) >= _MIN_FEATURES
        held |= ~free  # the first keyframe is where it is
        nearest = np.searchsorted(cameras, strong).clip(max=len(cameras) - 1)
        return {p: found[i] for p, i in zip(strong, nearest, strict=True) if held[i]}

    # --- consistency -------------------------------------------------------------------------------------------
    def _add_landmarks(self, frame_features: FrameFeatures, descriptors: np.ndarray) -> None:
        depth, sigma = frame_features.mean_depth()
        new = np.flatnonzero((frame_features.landmark == NONE) & (depth > 0) & (sigma < _NEW_DEPTH_SIGMA * depth))
        points = transform(
            frame_features.pose[None], back_projected(self.camera, frame_features.uv[new]) * depth[new, None]
        )
        frame_features.landmark[new] = self.landmarks.add(points, descriptors[new])

    def _align_surfaces(self, newest: int, others: list[int]) -> None:
        """Measure the motion between the surfaces of a keyframe and of others that look the same way."""
        for other in others:
            between = inverse(self.frames[other].pose) @ self.frames[newest].pose
            if rotation_angle(between) > _SAME_VIEW_RAD:
                continue
            found = align_views(self.views[other], self.views[newest], between)
            if found is not None:
                self.edges.append((other, newest, *found))

    def _adjust_locally(self) -> None:
        """Bundle adjustment of the newest keyframe and those that share most with it; the others hold."""
        newest = self.keyframes[-1]
        positions, shared = self._covisible(self.numbers(newest))
        window = [newest, *(p for p, s in zip(positions[:LOCAL_KEYFRAMES], shared, strict=False) if s and p != newest)]
        inside = np.unique(np.concatenate([self.numbers(p) for p in window]))
        positions, shared = self._covisible(inside)
        outside = [p for p, s in zip(positions, shared, strict=True) if p not in window and s >= 10]
        cameras = [*window, *outside[: 2 * LOCAL_KEYFRAMES]]
        free = np.array([p in window and p != self.keyframes[0] for p in cameras])
        if free.all():  # something must hold the rest
            free[int(np.argmin(cameras))] = False
        self._adjust(cameras, free, _LOCAL_ITERATIONS)

    def _close_loop(self) -> None:
        """Look for the newest keyframe's view among those that are no neighbours of it; join and straighten."""
        newest = self.keyframes[-1]
        view, numbers = self.frames[newest], self.numbers(newest)
        positions, shared = self._covisible(numbers)
        neighbours = {*positions[shared >= _KNOWN_SHARE].tolist(), *self.keyframes[-3:]}
        current = self.landmarks.current(view.landmark)
        place = self.recognise(view, self.landmarks.descriptors[current], neighbours)
        if place is None:
            return
        jumps = exceeds(inverse(view.pose) @ place.pose, _JUMP_M, _JUMP_RAD)
        if jumps and not self._distribute_loop_error(place):
            return
        self.loops.append((place.keyframe, newest))
        self._align_surfaces(newest, [place.keyframe])
        self.landmarks.merge(view.landmark[place.rows], place.numbers)
        if jumps:  # what is only joined is straightened by the local adjustments, and by the global one at the end
            self.adjust_globally(10)

    def _close_by_surface(self) -> None:
        """Without features: align the newest keyframe with older ones that are near by what is known so far."""
        (previous, newest), measured = self.keyframes[-2:], len(self.edges)
        if not any(newest == later for _, later, *_ in self.edges):  # what was tracked holds the two together
            motion = inverse(self.frames[previous].pose) @ self.frames[newest].pose
            self.edges.append((previous, newest, motion, np.diag([_TRACKED_M**-2] * 3 + [_TRACKED_RAD**-2] * 3)))
            measured += 1
        self._align_surfaces(newest, self._older_around(newest))
        self.loops += [(first, newest) for first, *_ in self.edges[measured:]]
        known = inverse(self.frames[newest].pose)
        off = [known @ self.frames[first].pose @ motion for first, _, motion, _ in self.edges[measured:]]
        if any(exceeds(each, _JUMP_M, _JUMP_RAD) for each in off):
            self.adjust_globally(10)

    def _distribute_loop_error(self, place: Place) -> bool:
        """Spread the error of a loop over the keyframes; landmarks and frames move with theirs.

        Returns False, and moves nothing, if the rest contradicts the loop.
        """
        before = {k: self.frames[k].pose for k in self.keyframes}
        order = {k: i for i, k in enumerate(self.keyframes)}
        earlier, later = place.keyframe, self.keyframes[-1]
        loops = [(order[a], order[b], inverse(before[a]) @ before[b]) for a, b in self.loops]
        loops.append((order[earlier], order[later], inverse(before[earlier]) @ place.pose))
        poses = corrected_poses(np.stack([before[k] for k in self.keyframes]), loops)
        left = inverse(loops[-1][2]) @ inverse(poses[order[earlier]]) @ poses[order[later]]
        if exceeds(left, _LEFT_M, _LEFT_RAD):
            return False
        owner = np.full(len(self.landmarks), NONE)
        for k in reversed(self.keyframes):  # a landmark belongs to the first keyframe that saw it
            owner[self.numbers(k)] = k
        for k, pose in zip(self.keyframes, poses, strict=True):
            self.frames[k].pose = pose
            mine = owner == k
            self.landmarks.points[mine] = transform((pose @ inverse(before[k]))[None], self.landmarks.points[mine])
        self._propagate_to_frames(before, set(self.keyframes))
        return True

    def _repair_outlier_poses(self) -> None:
        """Of frames between keyframes, which hold each other. Every reading of every pixel counts whole, as above."""
        frames = self._well_constrained()
        if not frames:
            return
        observations, numbers = observations_of([self.frames[p] for p in frames], self.landmarks)
        observations = observations.with_whole_pixels()
        poses = np.stack([self.frames[p].pose for p in frames])
        times = np.array([self.frames[p].index for p in frames], np.float64)
        free = ~np.isin(frames, self.keyframes)
        found = reoptimise_outliers(self.camera, poses, times, self.landmarks.points[numbers], observations, free)
        for position, pose in zip(frames, found, strict=True):
            self.frames[position].pose = pose

    def _propagate_to_frames(self, before: dict[int, np.ndarray], placed: set[int]) -> None:
        """Frames not in `placed` follow the last keyframe before them from where it was `before`."""
        keyframe = self.keyframes[0]
        for position, frame_features in enumerate(self.frames):
            keyframe = position if position in before else keyframe
            if position not in placed:
                frame_features.pose = self.frames[keyframe].pose @ inverse(before[keyframe]) @ frame_features.pose

    def _adjust(self, positions: list[int], free: np.ndarray, iterations: int, free_points: bool = True) -> None:
        """Bundle adjustment of frames, of which `free` (C,) move; nothing without frames or measurements of them."""
        if not positions:
            return
        poses, points, observations, numbers = self._seen_by(positions, 3 * _OUTLIER)
        observations = observations[seen_at_least(observations, 2)] if free_points else observations.with_whole_pixels()
        edges = edges_among(self.edges, positions)
        if len(observations) == 0 and (len(self.landmarks) or edges is None):
            return
        first = max(2, iterations // 2)
        settings = {"free_points": free_points, "edges": edges}
        result = adjust(self.camera, poses, points, observations, free, iterations=first, **settings)
        kept = without_outliers(self.camera, result.poses, result.points, observations, _OUTLIER)
        result = adjust(self.camera, result.poses, result.points, kept, free, iterations=iterations - first, **settings)
        for position, pose, moves in zip(positions, result.poses, free, strict=True):
            if moves:
                self.frames[position].pose = pose
        if free_points:
            seen = np.unique(kept.point)
            self.landmarks.points[numbers[seen]] = result.points[seen]

    def _seen_by(self, positions: list[int], limit: float) -> tuple[np.ndarray, np.ndarray, Observations, np.ndarray]:
        """Poses (C, 4, 4) of frames, the points (P, 3) they see, the observations within `limit` sigmas, and the number
        (P,) of each point's landmark."""
        frames = [self.frames[p] for p in positions]
        observations, numbers = observations_of(frames, self.landmarks)
        poses, points = np.stack([s.pose for s in frames]), self.landmarks.points[numbers]
        return poses, points, without_outliers(self.camera, poses, points, observations, limit), numbers

    # --- neighbourhood -----------------------------------------------------------------------------------------
    def _well_constrained(self) -> list[int]:
        """Positions of the frames that enough features hold."""
        return [p for p, s in enumerate(self.frames) if (s.landmark >= 0).sum() >= _MIN_FEATURES]

    def _cameras(self, strong: list[int]) -> list[int]:
        """Those of the frames `strong` that are adjusted together with all points: all, or keyframes and every n-th."""
        stride = -(-len(strong) // _MAX_CAMERAS) or 1
        return sorted({*strong[::stride], *self.keyframes}) if stride > 1 else strong

    def _all_but_first(self, positions: list[int]) -> np.ndarray:
        """(C,) which of the frames are not the first keyframe, which holds the world."""
        return np.array([p != self.keyframes[0] for p in positions])

    def _covisible(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For each keyframe, how many of the landmarks `numbers` it sees; positions and counts, most first."""
        marked = np.zeros(len(self.landmarks), bool)
        marked[numbers] = True
        shared = np.array([marked[self.numbers(k)].sum() for k in self.keyframes])
        order = np.argsort(-shared, kind="stable")
        return np.array(self.keyframes)[order], shared[order]

    def _older_around(self, newest: int) -> list[int]:
        """Keyframes near the newest one that are older than its neighbours."""
        near = self._near(self.frames[newest].pose, 2 * NEIGHBOURS)
        return [k for k in near if k not in self.keyframes[-1 - NEIGHBOURS :]]

    def _near(self, pose: np.ndarray, count: int) -> list[int]:
        """Keyframes that look from about the same place into about the same direction."""
        between = inverse(pose) @ np.stack([self.frames[k].pose for k in self.keyframes])
        apart = np.linalg.norm(between[:, :3, 3], axis=1) + rotation_angle(between)
        order = np.argsort(apart)[:count]
        return [self.keyframes[i] for i in order if apart[i] < 0.8]
