"""The online pass: track, check the sensors, integrate and learn, one frame after the other."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from ...core.frame import Frame
from .mapper import pose_tensor
from .state import ReconstructionState
from .views import View, stream_views


def track_and_integrate(state: ReconstructionState, view: View) -> None:
    """Track a frame; if it was tracked, integrate it and record its pose."""
    tracking, progress, tracker, faults = state.config.tracking, state.progress, state.tracker, state.faults
    frame = faults.check_images(view.frame)
    with progress.timed("tracking"):
        T_world_camera = tracker.track(faults.without_suspected(frame), view.prepared, view.inputs)
    if T_world_camera is None:
        return
    with progress.timed("pass_1"):
        pose = pose_tensor(T_world_camera, state.device)
        if tracking.enabled and tracker.is_keyframe():  # only a keyframe changes the poses of other frames
            reintegrate_moved_frames(state)
        frame = check_against_map(state, frame, pose)
        if not tracking.enabled or tracker.is_keyframe() or progress.position % tracking.integrate_every == 0:
            integrate_new_frame(state, frame, view.inputs, pose)
    progress.poses[frame.index] = np.asarray(T_world_camera).tolist()


def check_against_map(state: ReconstructionState, frame: Frame, pose: Tensor) -> Frame:
    """The frame without sensors whose depth is inconsistent with the map as it is before the frame."""
    if state.mapper.is_empty or not state.config.fault_detection.enabled:
        return frame
    map_depth = state.mapper.surface().depth_along_rays(state.faults.rays, pose)
    return state.faults.check_against_map(frame, map_depth.cpu(), state.config.fusion.max_depth_m)


def integrate_new_frame(state: ReconstructionState, frame: Frame, inputs: dict[str, Tensor], pose: Tensor) -> None:
    """Integrate a frame for the first time.

    The rays of a keyframe are kept. Before it is integrated, the noise models are trained on its residuals to the map.
    """
    mapper = state.mapper
    if state.keyframes.is_keyframe(frame, pose):
        rays = state.rays.draw(frame, inputs, pose, state.generator)
        if state.config.uncertainty.enabled and not mapper.is_empty:
            map_depth = mapper.surface().raycast(rays.origins, rays.directions)
            state.noise.learn_online(rays, map_depth, state.biases.models)
        state.rays.add(rays, state.generator)
    mapper.allocate(frame, pose)
    mapper.integrate(frame, inputs, pose)


def reintegrate_moved_frames(state: ReconstructionState) -> None:
    """Reintegrate the frames whose poses were changed by later frames, above all by loop closures."""
    poses = {index: pose_tensor(pose, state.device) for index, pose in state.tracker.poses().items()}
    moved = state.mapper.log.moved_frames(poses, state.config.fusion.voxel_size_m)
    if not moved:
        return
    state.rays.move(state.mapper.log.corrections({index: poses[index] for index in moved}))
    for view in stream_views(state, moved):
        state.mapper.reintegrate(view.frame, view.inputs, poses[view.frame.index])


def adopt_final_poses(state: ReconstructionState) -> None:
    """Replace the poses recorded in the online pass by the final, consistent ones, and move the kept rays with them."""
    with state.progress.timed("tracking"):
        final = state.tracker.finish()
        poses = {index: pose_tensor(pose, state.device) for index, pose in final.items()}
        state.rays.move(state.mapper.log.corrections(poses))
        state.mapper.log.clear()
        state.progress.poses.update({index: pose.tolist() for index, pose in final.items()})
