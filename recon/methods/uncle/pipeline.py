"""The method UncLe: online pass, consistent trajectory, offline integration passes, refinement by rendering."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.config.map_config import MapConfig
from ...core.errors import DataError
from ...core.events import OnEvent, Progress, ignore
from ...run.checkpoint import Checkpoint
from ...run.frames import RunFrames
from ...run.tracking_record import TrackingRecord
from ...sensors.noise_prior import NoisePrior
from ...tracking.base import require_found
from ...volume.neural_field import NeuralField
from ..base import OnBeta
from .noise_learning import MapEvidence
from .online_pass import adopt_final_poses, track_and_integrate
from .photometric_pass import update_photometric_depth
from .ray_batch import RayBatch, photometric_rays, sensor_rays
from .refinement import refine_map
from .sensor_weighting import sensor_reliability
from .state import ReconstructionState, resume, save, start
from .views import View, stream_views, views_of_pass


@dataclass(frozen=True)
class Reconstruction:
    """Result: field; T_world_camera (4, 4) by frame index; likelihood curves by name, nats; seconds by part; tracking:
    status and covariance of tracked poses, None for given ones; state: the parts of the method as they ended."""

    field: NeuralField
    poses: dict[int, np.ndarray]
    curves: dict[str, list[float]]
    seconds: dict[str, float]
    tracking: TrackingRecord | None
    state: ReconstructionState

    def facts(self) -> dict[str, Any]:
        """What the manifest records of the sensors and the map, plain JSON values."""
        state = self.state
        return {
            "keyframes": len(state.keyframes),
            "bias_test_improved_ratio": _rounded(state.biases.improved_fraction),
            "bias_corrected_sensors": sorted(state.biases.active()),
            "sensor_reliability": _rounded(state.mapper.weights.reliability),
            "error_quantiles_in_beta": {s: values for s, values in state.noise.error_quantiles.items() if values},
            "sensor_weight_share": _rounded(state.mapper.weight_sums.shares()),
        }


def reconstruct(
    frames: RunFrames,
    indices: list[int],
    config: MapConfig,
    checkpoint: Checkpoint,
    on_beta: OnBeta,
    on_event: OnEvent = ignore,
    prior: NoisePrior | None = None,
) -> Reconstruction:
    """Reconstruct the frames `indices`. Continues from `checkpoint` if it holds a state, with the same result.

    The noise models of sensors that are in `prior` start from it. Raises DataError if no frame can be mapped.
    """
    state = start(frames, config, prior)
    resume(state, checkpoint, on_event)
    progress, photometric = state.progress, state.photometric

    while progress.current_pass <= progress.last_pass:
        online = progress.current_pass == 0
        for view in views_of_pass(state, indices, on_event):
            if online:
                track_and_integrate(state, view)  # estimates the pose, trains the noise models on new keyframes
            else:
                integrate_again(state, view)  # with the poses, noise models, biases and weights known by now
            progress.position += 1
            if checkpoint.due():
                save(state, checkpoint)
        require_map(state, len(indices))

        if online:
            save(state, checkpoint)  # if what follows fails, --resume need not track again
            learn_noise(state)
            adopt_final_poses(state)
            updated = update_photometric_depth(state, on_event)
        else:
            integrate_photometric_depth(state)
            updated = photometric.needs_another_pass() and update_photometric_depth(state, on_event)

        if updated and photometric.needs_another_pass():
            # One pass integrates this update, and the one after it the update around the surface that results.
            progress.last_pass = max(progress.last_pass, progress.current_pass + 2)
        if updated or not online:
            learn_noise(state)
        if updated:
            estimate_sensor_reliability(state)

        finish_pass(state, checkpoint)

    with progress.timed("refining"):
        has_photometric = photometric.samples is not None
        batches = ray_batches(state) if config.field.iterations else []
        field, losses = refine_map(state.mapper.volume, batches, config, has_photometric, on_event)
    with progress.timed("beta maps"):
        write_beta_maps(state, on_beta, on_event)
    poses = {index: np.array(pose) for index, pose in progress.poses.items()}
    curves = {**progress.losses, "refinement": losses}
    return Reconstruction(field, poses, curves, progress.seconds, state.tracker.record(), state)


def require_map(state: ReconstructionState, frame_count: int) -> None:
    """Raises DataError if the camera was lost in all frames, or no measurement was integrated."""
    if state.config.tracking.enabled:
        require_found(state.progress.poses, frame_count)
    if state.mapper.is_empty:
        raise DataError("no frame could be mapped: no depth measurement within range has a camera pose")


def finish_pass(state: ReconstructionState, checkpoint: Checkpoint) -> None:
    """Go on to the next pass, with an empty volume; after the last pass the map stays as it is."""
    was_last = state.progress.is_last_pass
    if not was_last:
        state.mapper.clear_volume()
    state.progress.start_next_pass()
    if was_last or checkpoint.due():  # what follows the last pass writes much, and the disk may be full
        save(state, checkpoint)


def integrate_again(state: ReconstructionState, view: View) -> None:
    """Integrate a frame with its recorded pose, bias-corrected; frames without a pose are skipped."""
    progress, biases = state.progress, state.biases
    if view.frame.index not in progress.poses:
        return
    with progress.timed(f"pass_{progress.current_pass + 1}"):
        pose = state.pose(view.frame.index)
        frame = biases.correct(view.frame, view.inputs)
        # The surface may have left the allocated blocks since the online pass: by the final pose, or by a bias that was
        # activated since the last pass. All other changes are smaller than the truncation band.
        displaced = state.config.tracking.enabled or frame is not view.frame
        if displaced and (progress.current_pass == 1 or biases.newly_active):
            state.mapper.allocate(frame, pose)
        state.mapper.integrate(frame, view.inputs, pose)


def integrate_photometric_depth(state: ReconstructionState) -> None:
    """Complete an integration pass by the photometric depth that is known by now."""
    photometric = state.photometric
    with state.progress.timed("photometric"):
        state.mapper.integrate_photometric(photometric.depth_images(), photometric.frames_per_view)


def learn_noise(state: ReconstructionState) -> None:
    """Train the noise models on the whole map; after the last pass for errors of the measurements as recorded."""
    progress, mapper, rays = state.progress, state.mapper, state.rays.rays
    if not state.config.uncertainty.enabled or rays is None:
        return
    with progress.timed("learning"):
        map_depth = mapper.surface().raycast(rays.origins, rays.directions)
        evidence = MapEvidence(
            rays, map_depth, mapper.volume, mapper.weights, state.biases.models, state.photometric.samples
        )
        losses = state.noise.learn_from_map(evidence, target="raw" if progress.is_last_pass else "corrected")
    for sensor, loss in losses.items():
        if math.isfinite(loss):
            progress.add_loss(f"noise/{sensor}", loss)


def estimate_sensor_reliability(state: ReconstructionState) -> None:
    """Set the reliability of the sensors in the fusion weights of the passes that follow."""
    mapper = state.mapper
    with state.progress.timed("photometric"):
        mapper.weights.reliability = sensor_reliability(
            state.photometric, state.noise.models, state.biases.models, mapper.volume, state.config
        )


def ray_batches(state: ReconstructionState) -> list[RayBatch]:
    """What the field is fitted to: keyframe rays of the sensors, bias-corrected, and photometric depth."""
    batches: list[RayBatch] = []
    if state.rays.rays is not None and len(state.rays):
        corrected = state.rays.rays.without_bias(state.biases.models)
        batches.append(sensor_rays(corrected, state.noise.models, state.mapper.weights.reliability))
    if state.photometric.samples is not None:
        batches.append(photometric_rays(state.photometric.samples, state.device))
    return batches


def write_beta_maps(state: ReconstructionState, on_beta: OnBeta, on_event: OnEvent) -> None:
    """Pass the error scale of every mapped frame and sensor to `on_beta`, if it was learned."""
    if not state.config.uncertainty.enabled:
        return
    indices, stage = sorted(state.progress.poses), "writing beta maps"
    for done, view in enumerate(stream_views(state, indices)):
        on_event(Progress(stage, done, len(indices)))
        for sensor, inputs in view.inputs.items():
            depth = view.frame.depths[sensor].to(state.device)
            beta = state.noise.models[sensor].beta_image(depth, inputs.to(state.device))
            on_beta(view.frame.index, sensor, beta.cpu())
    on_event(Progress(stage, len(indices), len(indices)))


def _rounded(values: dict[str, float]) -> dict[str, float]:
    return {sensor: round(value, 4) for sensor, value in values.items()}
