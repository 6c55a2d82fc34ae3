"""Closed-form fusion of truncated signed distances with the weights 1 / z^power."""

from __future__ import annotations

import numpy as np
import torch
from uncle.recon.core.config.map_config import MapConfig
from uncle.recon.core.device import choose_device
from uncle.recon.core.events import OnEvent, track_progress
from uncle.recon.run import RunFrames
from uncle.recon.volume import NeuralField, SparseGrid, TsdfVolume

from . import InversePowerConfig


def fuse(
    frames: RunFrames, indices: list[int], config: MapConfig, on_event: OnEvent, poses: dict[int, np.ndarray] | None
) -> tuple[NeuralField, dict[int, np.ndarray]]:
    """Fuse all sensors of the frames `indices`; returns the map and T_world_camera of the frames in it.

    `poses` are tracked poses by frame index; None: take those of the recording.
    """
    assert isinstance(config.plugin, InversePowerConfig)
    device, fusion = choose_device(config.device), config.fusion
    truncation_m = fusion.truncation_voxels * fusion.voxel_size_m
    volume = TsdfVolume(SparseGrid(fusion.voxel_size_m, device), frames.camera, truncation_m, fusion.max_depth_m)
    used: dict[int, np.ndarray] = {}
    images = frames.stream(indices, lambda frame: frame)
    for frame in track_progress(images, len(indices), "fusing", on_event):
        pose = frame.T_world_camera if poses is None else poses.get(frame.index)
        if pose is None:
            continue
        used[frame.index] = pose
        T_world_camera = torch.from_numpy(pose).float().to(device)
        for depth in (image.to(device) for image in frame.depths.values()):
            weight = depth.clamp(min=0.1) ** -config.plugin.power
            volume.allocate(depth, T_world_camera)
            volume.integrate(depth, weight, frame.color.to(device), T_world_camera)
    return NeuralField.from_fusion(volume, fusion.min_observations, config.field, torch.Generator()), used
