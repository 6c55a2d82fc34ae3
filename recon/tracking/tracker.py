"""The default tracker: features against the keyframes first, then Gauss-Newton against features, surface and colour."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from ..core.camera import Camera
from ..core.config.uncle import TrackingConfig
from ..core.frame import Frame
from ..core.se3 import apply_motion, exceeds, inverse, motion_between, rotation_angle, transform
from ..run.tracking_record import Status, TrackedFrame, TrackingRecord
from ..sensors.noise_model import NoiseModel
from ..volume.tsdf_volume import TsdfVolume
from . import graph_state
from .depth_only import SurfacePose, align_to_tsdf, expectation, relocalise_by_surface, track_from_keyframe
from .frame_observations import Prepared, observe_features, prepare, sample_depth_points, surface_view, weigh
from .frame_to_frame import SurfaceView
from .frame_to_model import Readings, scaled, surface_term
from .graph_adjustment import pose_covariances
from .graph_optimisation import optimise_after_keyframe, optimise_all
from .keyframe_graph import KeyframeGraph
from .landmarks import FrameFeatures
from .local_features import match, match_near, near_projections, project
from .place_recognition import recognise_among_keyframes
from .pose_estimation import MIN_INLIERS, covariance_of, feature_term, is_weak, minimise, ransac_pose

SEARCH_PX = 10.0  # around where a landmark is expected
AGREES = 4.0  # sigmas
SURE_MATCHES = 30  # fewer are believed only near the expected pose
MIN_MEASUREMENTS = 300
JOINT_ITERATIONS = 3  # from where the features have it
WORST_FIT = 2.5  # times the usual distance from the surface
_PLACES = 8  # keyframes at which a camera without features is looked for
_FIT_RATE = 0.1  # how fast what is usual follows
_FARTHEST_M, _FARTHEST_RAD = 0.5, 0.8  # a few matches do not prove a larger motion within one frame


@dataclass(frozen=True)
class _Found:
    """A pose (4, 4), its information (6, 6) from what was seen, the matched features (K,) and their landmarks (K,);
    `shown` (6, 6) is the share of a motion that the frame shows rather than the expectation."""

    pose: np.ndarray
    information: np.ndarray
    rows: np.ndarray
    numbers: np.ndarray
    shown: np.ndarray = field(default_factory=lambda: np.eye(6))


class AlignTracker:
    """Tracks frame after frame and keeps the trajectory consistent.

    `noise` are the models that weigh the depth of each sensor (None: a rule of thumb does), `volume` the map that grows
    along with the trajectory; without it features alone are tracked.
    """

    def __init__(
        self,
        camera: Camera,
        config: TrackingConfig,
        seed: int,
        noise: Sequence[NoiseModel | None] = (),
        volume: TsdfVolume | None = None,
        registration_sigma_px: float = 0.0,
    ) -> None:
        self.camera, self.config, self.seed = camera, config, seed
        self.noise, self.volume, self.registration_sigma_px = noise, volume, registration_sigma_px
        self.graph = KeyframeGraph(camera, seed)
        self.frames: list[TrackedFrame] = []
        self._velocity = np.eye(4)
        self._lost = False
        self._fit: float | None = None  # how far readings usually lie from the surface, in sigmas that were promised

    # --- the protocol of a tracker -----------------------------------------------------------------------------
    def prepare(self, frame: Frame, normals: dict[str, torch.Tensor]) -> Prepared:
        """What can be made of a frame beforehand, in the background; normals (H, W, 3) by sensor."""
        return prepare(frame, normals, self.camera, self.config)

    def track(self, frame: Frame, prepared: Prepared, noise_features: dict[str, torch.Tensor]) -> np.ndarray | None:
        """T_world_camera (4, 4) of the next frame, None where it is lost.

        `noise_features` (H, W, F) by sensor, as the noise models take them; nothing if the uncertainty is not learned.
        """
        features = prepared.features
        frame_features = observe_features(
            frame, features, noise_features, self.noise, self.camera, self.registration_sigma_px
        )
        readings = self._readings(frame, noise_features)
        view = None
        if self._featureless:
            view = surface_view(frame, prepared, noise_features, self.noise, self.camera, self._max_depth_m)
        if not self.graph.frames:
            found, status = self._initialise(frame, frame_features, readings)
        elif self._featureless:
            found, status = self._localise_depth_only(view, readings)
        else:
            found, status = self._locate(frame_features, features.descriptors, readings)
        self._note(frame, status, found)
        if found is None:
            self._lost, self._velocity = True, np.eye(4)
            return None
        steady = bool(self.graph.frames) and not self._lost
        motion = found.shown @ motion_between(self._last.pose, found.pose) if steady else np.zeros(6)
        self._velocity = apply_motion(np.eye(4), motion)
        self._lost = False
        frame_features.pose = found.pose
        frame_features.landmark[found.rows] = found.numbers
        if not self._is_keyframe(frame_features, len(found.rows), view):
            view = None
        elif view is None:
            view = surface_view(frame, prepared, noise_features, self.noise, self.camera, self._max_depth_m)
        self.graph.add(frame_features, features.descriptors, view)
        if view is not None:
            optimise_after_keyframe(self.graph)
        return self._last.pose

    def is_keyframe(self) -> bool:
        """Whether the frame tracked last became a keyframe."""
        return bool(self.graph.keyframes) and self.graph.keyframes[-1] == len(self.graph.frames) - 1

    def poses(self) -> dict[int, np.ndarray]:
        """T_world_camera (4, 4) of every frame that is not lost, by index, as known by now."""
        return {frame_features.index: frame_features.pose for frame_features in self.graph.frames}

    def finish(self) -> dict[int, np.ndarray]:
        """All frames made consistent, with what was learned about the sensors since they were seen."""
        for frame_features in self.graph.frames:
            weigh(frame_features, self.noise)
        optimise_all(self.graph)
        return self.poses()

    def record(self) -> TrackingRecord:
        """Status of every frame and, after `finish`, the covariance of its pose."""
        spread = {self.graph.frames[p].index: c for p, c in pose_covariances(self.graph).items()}
        return TrackingRecord.of(self.frames, spread)

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {
            "graph": graph_state.to_state(self.graph),
            "frames": [f.model_dump() for f in self.frames],
            "velocity": torch.from_numpy(self._velocity), "lost": self._lost, "fit": self._fit,
        }  # fmt: skip

    def load_state_dict(self, state: dict[str, Any]) -> None:
        graph_state.load_state(self.graph, state["graph"])
        self.frames = [TrackedFrame.model_validate(row) for row in state["frames"]]
        self._velocity, self._lost, self._fit = state["velocity"].numpy(), state["lost"], state["fit"]

    # --- one frame ---------------------------------------------------------------------------------------------
    @property
    def _max_depth_m(self) -> float:
        return math.inf if self.volume is None else self.volume.max_depth_m

    @property
    def _featureless(self) -> bool:
        """Whether no frame has shown a feature with depth: a recording without colour, or in the dark."""
        return len(self.graph.landmarks) == 0 and self.volume is not None

    @property
    def _last(self) -> FrameFeatures:
        return self.graph.frames[-1]

    def _readings(self, frame: Frame, noise_features: dict[str, torch.Tensor]) -> Readings | None:
        """What is aligned with the surface; None where there is too little, or no map."""
        if self.volume is None or self.config.depth_samples == 0:
            return None
        readings = sample_depth_points(frame, noise_features, self.noise, self.camera, self.config, self._max_depth_m)
        return readings.to(self.volume.grid.device) if len(readings) >= MIN_MEASUREMENTS else None

    def _initialise(
        self, frame: Frame, frame_features: FrameFeatures, readings: Readings | None
    ) -> tuple[_Found | None, Status]:
        """The first frame that shows anything defines the world: by its given pose, else it is the origin."""
        if (frame_features.mean_depth()[0] > 0).sum() < MIN_INLIERS and readings is None:
            return None, "lost"
        nothing = np.zeros(0, np.int64)
        first = np.eye(4) if frame.T_world_camera is None else frame.T_world_camera
        return _Found(first, np.zeros((6, 6)), nothing, nothing), "tracked"

    def _locate(
        self, frame_features: FrameFeatures, descriptors: np.ndarray, readings: Readings | None
    ) -> tuple[_Found | None, Status]:
        expected = self._last.pose @ self._velocity
        found = None if self._lost else self._localise_by_features(frame_features, descriptors, expected)
        if found is not None:
            found = self._refined(found, frame_features, readings)
            return found, "weak" if is_weak(found.information) else "tracked"
        if readings is not None and not (self._lost and len(descriptors)):  # without features nothing else finds it
            found = self._localise_by_tsdf(readings, expected)
            if found is not None:
                return found, "weak"
        found = self._relocalise(frame_features, descriptors)
        return found, "relocalised" if found is not None else "lost"

    def _localise_by_features(
        self, frame_features: FrameFeatures, descriptors: np.ndarray, expected: np.ndarray
    ) -> _Found | None:
        """Match to the landmarks around, whatever the motion was; then look for the others where they should be."""
        numbers = self.graph.local_landmarks(expected, self.graph.landmarks.seen_by(self._last))
        points = self.graph.landmarks.points[numbers]
        similarity = descriptors @ self.graph.landmarks.descriptors[numbers].T
        pairs = match(similarity)
        first = ransac_pose(self.camera, points[pairs[:, 1]], frame_features.uv[pairs[:, 0]], self.seed)
        if first is None:
            return None
        pose, kept = first
        if len(kept) < SURE_MATCHES and exceeds(inverse(expected) @ pose, _FARTHEST_M, _FARTHEST_RAD):
            return None
        pose, _ = minimise(pose, [feature_term(self.camera, points, frame_features.observations(*pairs[kept].T))])
        pairs = match_near(similarity, near_projections(self.camera, pose, points, frame_features.uv, SEARCH_PX))
        found = self._refine_inliers(frame_features, pose, pairs[:, 0], numbers[pairs[:, 1]])
        return found if len(found.rows) >= MIN_INLIERS else None

    def _refine_inliers(
        self, frame_features: FrameFeatures, pose: np.ndarray, rows: np.ndarray, numbers: np.ndarray
    ) -> _Found:
        """The pose from matches of features `rows` (K,) to landmarks `numbers` (K,), and those that agree with it."""
        points = self.graph.landmarks.points
        for _ in range(2):
            term = feature_term(self.camera, points, frame_features.observations(rows, numbers))
            pose, information = minimise(pose, [term])
            local = transform(inverse(pose)[None], points[numbers])
            off = (project(self.camera, local) - frame_features.uv[rows]) / frame_features.sigma_px[rows, None]
            kept = ((off**2).sum(1) < AGREES**2) & (local[:, 2] > 0)
            rows, numbers = rows[kept], numbers[kept]
        return _Found(pose, information, rows, numbers)

    def _refined(self, found: _Found, frame_features: FrameFeatures, readings: Readings | None) -> _Found:
        """All that was seen together: features, surface and colour."""
        observations = frame_features.observations(found.rows, found.numbers)
        terms = [feature_term(self.camera, self.graph.landmarks.points, observations)]
        if readings is not None:
            terms.append(surface_term(self.volume, readings))
        pose, information = minimise(found.pose, terms, JOINT_ITERATIONS)
        if readings is not None:
            self._residual_is_usual(scaled(self.volume, readings, pose).scale)
        return _Found(pose, information, found.rows, found.numbers)

    def _localise_by_tsdf(self, readings: Readings, expected: np.ndarray) -> _Found | None:
        """Without features: the surface alone, held by the expected motion in directions that it does not show."""
        return self._confirmed(align_to_tsdf(self.volume, readings, expected, expectation(self._last.pose, expected)))

    def _localise_depth_only(self, view: SurfaceView, readings: Readings | None) -> tuple[_Found | None, Status]:
        """In a recording without features: from the last keyframe on, else from any."""
        if readings is None:
            return None, "lost"
        graph, last = self.graph, self._last.pose
        newest, *others = [(graph.views[k], graph.frames[k].pose) for k in graph.spread_keyframes(_PLACES)]
        lost = sum(1 for _ in itertools.takewhile(lambda f: f.status == "lost", reversed(self.frames)))
        lost = max(lost, int(len(graph.frames) == 1))
        near = track_from_keyframe(self.volume, readings, view, newest, last, last @ self._velocity, lost)
        found = next(filter(None, map(self._confirmed, near)), None)
        if found is not None and not self._lost:
            return found, "weak"
        if found is None:
            again = relocalise_by_surface(self.volume, readings, view, [newest, *others])
            found = next(filter(None, map(self._confirmed, again)), None)
        return found, "lost" if found is None else "relocalised"

    def _confirmed(self, held: SurfacePose | None) -> _Found | None:
        if held is None or not self._residual_is_usual(held.fit if self._featureless else held.scale):
            return None
        nothing = np.zeros(0, np.int64)
        return _Found(held.pose, held.information, nothing, nothing, held.shown)

    def _residual_is_usual(self, scale: float) -> bool:
        """Whether readings lie about as near to the surface as usual; if so, what is usual follows."""
        usual = scale if self._fit is None else self._fit
        if scale > WORST_FIT * usual:
            return False
        self._fit = usual + _FIT_RATE * (scale - usual)
        return True

    def _relocalise(self, frame_features: FrameFeatures, descriptors: np.ndarray) -> _Found | None:
        """Relocalise against all keyframes."""
        place = recognise_among_keyframes(self.graph, frame_features, descriptors)
        if place is None:
            return None
        found = self._refine_inliers(frame_features, place.pose, place.rows, place.numbers)
        return found if len(found.rows) >= SURE_MATCHES // 2 else None

    def _is_keyframe(self, frame_features: FrameFeatures, matches: int, view: SurfaceView | None) -> bool:
        """A frame that moved or lost sight of what is known, and can lend landmarks or, without any, a view."""
        if not self.graph.keyframes:
            return True
        config = self.config
        depth, _ = frame_features.mean_depth()
        depth = depth[depth > 0]
        if len(depth) >= MIN_INLIERS:
            lost_sight = matches < config.keyframe_matches
        elif view is None or not view.valid.any():
            return False
        else:
            depth, lost_sight = view.points[view.valid][:, 2], False
        step = inverse(self.graph.frames[self.graph.keyframes[-1]].pose) @ frame_features.pose
        shift = np.linalg.norm(step[:3, 3]) / np.median(depth)
        return (
            lost_sight
            or rotation_angle(step) > config.keyframe_rotation_rad
            or shift > config.keyframe_translation_ratio
        )

    def _note(self, frame: Frame, status: Status, found: _Found | None) -> None:
        covariance = None
        if found is not None:  # the frame that defines the world has none to it
            covariance = (covariance_of(found.information) if self.graph.frames else np.zeros((6, 6))).tolist()
        facts = {"status": status, "matches": 0 if found is None else len(found.rows), "covariance": covariance}
        self.frames.append(TrackedFrame(index=frame.index, timestamp=frame.timestamp, **facts))
