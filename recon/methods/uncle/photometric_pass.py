"""A photometric pass: stereo around the current surface, comparison with the sensors, and sensor biases."""

from __future__ import annotations

import numpy as np

from ...core.events import Note, OnEvent
from ...mvs.bias_correction import BiasFit, PosedView
from ...mvs.photometric_samples import PhotometricSamples
from .state import ReconstructionState
from .views import stream_views


def photometric_is_usable(state: ReconstructionState, on_event: OnEvent) -> bool:
    """Whether the settings ask for photometric depth and the calibration of the recording allows it."""
    config, frames = state.config, state.frames
    if not (config.photometric.enabled and config.uncertainty.enabled and config.fusion.passes):
        return False
    if frames.registration_sigma_px > config.photometric.max_registration_px:
        error = f"{frames.registration_sigma_px:g} px"
        on_event(Note(f"photometric depth is skipped: the colour-depth registration may be off by {error}"))
        return False
    return True


def update_photometric_depth(state: ReconstructionState, on_event: OnEvent) -> bool:
    """Run a photometric pass around the current surface, if photometric depth is usable.

    Fits the sensor biases to its result and validates it by them. Returns whether there is a new result.
    """
    if not photometric_is_usable(state, on_event):
        return False
    photometric, progress = state.photometric, state.progress
    with progress.timed("photometric"):
        poses = {index: np.array(pose) for index, pose in progress.poses.items()}
        surface = state.mapper.surface()
        loss = photometric.update(state.frames, poses, surface, on_event)
        if loss is None:
            return False
        progress.add_loss("noise/photometric", loss)
        views = ((view.frame, view.inputs) for view in stream_views(state, photometric.indices))
        samples = photometric.collect_samples(views, surface)
        biases = fit_biases(state, samples)
        photometric.set_validation(biases.validation)
    return True


def fit_biases(state: ReconstructionState, samples: PhotometricSamples) -> BiasFit:
    """Fit the sensor biases to photometric samples, tested on an even choice of the reference views."""
    photometric, biases = state.photometric, state.biases
    tested = photometric.views[:: 1 + len(photometric.views) // biases.test.views]
    poses = {view.index: view.T_world_camera.numpy() for view in tested}
    views = (
        PosedView(view.frame, view.inputs, poses[view.frame.index]) for view in stream_views(state, list(poses))
    )  # fmt: skip
    return biases.fit(samples, views, photometric.voxel_size_m)
