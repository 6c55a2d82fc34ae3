"""The default tracker: features against the keyframes first, then Gauss-Newton against features, surface and colour."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import TrackingConfig
from ..core.frame import Frame
from ..run.tracking_record import Status, TrackedFrame, TrackingRecord
from ..sensors.noise_model import NoiseModel
from ..volume.tsdf_volume import TsdfVolume
from . import graph_state
from .depth_localisation import DepthLocaliser
from .feature_localisation import localise_by_features, refine_jointly, relocalise_by_features
from .frame_observations import Prepared
from .frame_observer import FrameObserver
from .frame_to_frame import SurfaceView
from .frame_to_model import Readings
from .graph_adjustment import pose_covariances
from .graph_optimisation import optimise_after_keyframe, optimise_all
from .keyframe_decision import becomes_keyframe
from .keyframe_graph import KeyframeGraph
from .landmarks import FrameFeatures
from .localisation import Localisation
from .motion_model import MotionModel
from .pose_estimation import MIN_INLIERS, covariance_of, is_weak

Outcome = tuple[Localisation | None, Status]


class AlignTracker:
    """Tracks frame after frame and keeps the trajectory consistent.

    `noise` are the models that weight the depth of each sensor (None: a default error scale does), `volume` the map
    that grows along with the trajectory; without it features alone are tracked.
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
        max_depth_m = math.inf if volume is None else volume.max_depth_m
        self.config = config
        self.observer = FrameObserver(camera, config, noise, registration_sigma_px, max_depth_m)
        self.graph = KeyframeGraph(camera, seed)
        self.motion = MotionModel()
        self.surface = None if volume is None else DepthLocaliser(volume, self.graph)
        self.frames: list[TrackedFrame] = []

    # --- the protocol of a tracker -----------------------------------------------------------------------------
    def prepare(self, frame: Frame, normals: dict[str, Tensor]) -> Prepared:
        """What can be computed of a frame beforehand, in the background; normals (H, W, 3) by sensor."""
        return self.observer.prepare(frame, normals)

    def track(self, frame: Frame, prepared: Prepared, inputs: dict[str, Tensor]) -> np.ndarray | None:
        """T_world_camera (4, 4) of the next frame, None where it is lost.

        `inputs` (H, W, F) by sensor, as the noise models take them; nothing if the uncertainty is not learned.
        """
        features, descriptors = self.observer.features(frame, prepared, inputs), prepared.features.descriptors
        readings = None if self.surface is None else self.surface.on_device(self.observer.depth_samples(frame, inputs))
        view = self.observer.view(frame, prepared, inputs) if self._featureless else None
        if not self.graph.frames:
            found, status = self._initialise(frame, features, readings)
        elif view is not None:
            found, status = self._localise_by_surface(view, readings)
        else:
            found, status = self._localise(features, descriptors, readings)
        self._record(frame, status, found)
        self.motion.update(self.graph.frames[-1].pose if self.graph.frames else None, found)
        if found is None:
            return None

        features.pose = found.pose
        features.landmark[found.rows] = found.numbers
        if not self._becomes_keyframe(features, len(found.rows), view):
            self.graph.add(features, descriptors, None)
        else:
            view = self.observer.view(frame, prepared, inputs) if view is None else view
            self.graph.add(features, descriptors, view)
            optimise_after_keyframe(self.graph)
        return self.graph.frames[-1].pose

    def is_keyframe(self) -> bool:
        """Whether the frame tracked last became a keyframe."""
        return bool(self.graph.keyframes) and self.graph.newest == len(self.graph.frames) - 1

    def poses(self) -> dict[int, np.ndarray]:
        """T_world_camera (4, 4) of every frame that is not lost, by index, as known by now."""
        return {features.index: features.pose for features in self.graph.frames}

    def finish(self) -> dict[int, np.ndarray]:
        """The poses of all frames made consistent, with what was learned about the sensors since they were tracked."""
        for features in self.graph.frames:
            self.observer.update_sigmas(features)
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
            "frames": [frame.model_dump() for frame in self.frames],
            "motion": self.motion.state_dict(),
            "usual_residual": None if self.surface is None else self.surface.usual.mean,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        graph_state.load_state(self.graph, state["graph"])
        self.frames = [TrackedFrame.model_validate(row) for row in state["frames"]]
        self.motion.load_state_dict(state["motion"])
        if self.surface is not None:
            self.surface.usual.mean = state["usual_residual"]

    # --- localisation ------------------------------------------------------------------------------------------
    @property
    def _featureless(self) -> bool:
        """Whether no frame has shown a feature with depth: a recording without colour, or in the dark."""
        return len(self.graph.landmarks) == 0 and self.surface is not None

    def _initialise(self, frame: Frame, features: FrameFeatures, readings: Readings | None) -> Outcome:
        """The first frame that shows anything defines the world: by its given pose, else it is the origin."""
        if (features.mean_depth()[0] > 0).sum() < MIN_INLIERS and readings is None:
            return None, "lost"
        first = np.eye(4) if frame.T_world_camera is None else frame.T_world_camera
        return Localisation(first, np.zeros((6, 6))), "tracked"

    def _localise(self, features: FrameFeatures, descriptors: np.ndarray, readings: Readings | None) -> Outcome:
        """By features, refined with the surface; else by the surface; else by the features of any keyframe."""
        expected, lost = self.motion.predict(self.graph.frames[-1].pose), self.motion.lost
        found = None if lost else localise_by_features(self.graph, features, descriptors, expected)
        if found is not None:
            found = self._refine(found, features, readings)
            return found, "weak" if is_weak(found.information) else "tracked"
        if self.surface is not None and readings is not None and not (lost and len(descriptors)):
            found = self.surface.near(readings, expected)  # a lost camera with features is left to these
            if found is not None:
                return found, "weak"
        found = relocalise_by_features(self.graph, features, descriptors)
        return found, "lost" if found is None else "relocalised"

    def _refine(self, found: Localisation, features: FrameFeatures, readings: Readings | None) -> Localisation:
        """By all residuals together: features, surface and colour."""
        if self.surface is None or readings is None:
            return refine_jointly(self.graph, features, found)
        found = refine_jointly(self.graph, features, found, [self.surface.term(readings)])
        self.surface.update_usual(readings, found.pose)
        return found

    def _localise_by_surface(self, view: SurfaceView, readings: Readings | None) -> Outcome:
        """In a recording without features: from the last keyframe on, else from any."""
        if self.surface is None or readings is None:
            return None, "lost"
        expected = self.motion.predict(self.graph.frames[-1].pose)
        unknown = max(self.motion.lost_frames, int(len(self.graph.frames) == 1))  # no motion was seen of one frame
        found = self.surface.from_last_keyframe(view, readings, expected, unknown)
        if found is not None and not self.motion.lost:
            return found, "weak"
        if found is None:
            found = self.surface.from_any_keyframe(view, readings)
        return found, "lost" if found is None else "relocalised"

    def _becomes_keyframe(self, features: FrameFeatures, matches: int, view: SurfaceView | None) -> bool:
        if not self.graph.keyframes:
            return True
        return becomes_keyframe(features, matches, view, self.graph.frames[self.graph.newest], self.config)

    def _record(self, frame: Frame, status: Status, found: Localisation | None) -> None:
        covariance = None
        if found is not None:  # the frame that defines the world has no uncertainty
            covariance = (covariance_of(found.information) if self.graph.frames else np.zeros((6, 6))).tolist()
        tracked = TrackedFrame(
            index=frame.index, timestamp=frame.timestamp, status=status,
            matches=0 if found is None else len(found.rows), covariance=covariance,
        )  # fmt: skip
        self.frames.append(tracked)
