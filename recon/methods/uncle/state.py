"""State of a reconstruction: its parts, how they start, and how a checkpoint holds them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor

from ...core.config.map_config import MapConfig
from ...core.device import choose_device
from ...core.events import Note, OnEvent
from ...core.tensor_files import taking_apart
from ...mvs.bias_correction import BiasCorrection
from ...mvs.photometric_depth import PhotometricDepth
from ...run.checkpoint import Checkpoint
from ...run.frames import RunFrames
from ...sensors.fault_detection import FaultDetector
from ...sensors.noise_prior import NoisePrior
from ...tracking.base import Tracker
from ...tracking.factory import choose_tracker
from .keyframes import KeyframeSelector
from .mapper import Mapper, pose_tensor
from .noise_learning import NoiseLearner
from .progress import RunProgress
from .ray_buffer import RayBuffer

_CONSTANTS = ("frames", "config", "device")  # the same after a resume


@dataclass(frozen=True)
class ReconstructionState:
    """The parts of a reconstruction. All but the first three change while it runs and are saved in checkpoints.

    generator: of all random draws that are not seeded by themselves, shared by noise, rays and mapper.
    """

    frames: RunFrames
    config: MapConfig
    device: torch.device
    generator: torch.Generator
    noise: NoiseLearner
    mapper: Mapper
    keyframes: KeyframeSelector
    rays: RayBuffer
    faults: FaultDetector
    biases: BiasCorrection
    photometric: PhotometricDepth
    tracker: Tracker
    progress: RunProgress

    def pose(self, index: int) -> Tensor:
        """Recorded T_world_camera (4, 4) of a frame, on the device of the map."""
        return pose_tensor(self.progress.poses[index], self.device)

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from, bit for bit."""
        parts = {name: part.state_dict() for name, part in self._parts().items()}
        return {**parts, "generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state of the same frames and settings."""
        for name, part in self._parts().items():
            part.load_state_dict(state[name])
        self.generator.set_state(state["generator"].cpu())

    def _parts(self) -> dict[str, Any]:
        names = [field.name for field in fields(self) if field.name not in (*_CONSTANTS, "generator")]
        return {name: getattr(self, name) for name in names}


def start(frames: RunFrames, config: MapConfig, prior: NoisePrior | None = None) -> ReconstructionState:
    """The state before the first frame. Noise models of sensors that are in `prior` start from it."""
    device, camera, sensors = choose_device(config.device), frames.camera, frames.sensors
    generator = torch.Generator().manual_seed(config.seed)
    noise = NoiseLearner(sensors, config.uncertainty, generator, device)
    if prior is not None:
        prior.initialise(noise.models)
    mapper = Mapper(camera, sensors, config, noise.models, device)
    # Given poses need no integration pass, tracked ones do: they change after the online pass.
    last_pass = max(config.fusion.passes, int(config.tracking.enabled))
    return ReconstructionState(
        frames=frames,
        config=config,
        device=device,
        generator=generator,
        noise=noise,
        mapper=mapper,
        keyframes=KeyframeSelector(camera, config.keyframes),
        rays=RayBuffer(camera, sensors, config.keyframes, config.fusion.max_depth_m, device),
        faults=FaultDetector(camera, sensors, config.fault_detection, poses_given=not config.tracking.enabled),
        biases=BiasCorrection(camera, sensors, config.uncertainty, config.seed, device),
        photometric=PhotometricDepth(
            camera, config.photometric, config.uncertainty, config.fusion.voxel_size_m, config.seed
        ),
        tracker=choose_tracker(frames, config, noise.models, mapper.volume),
        progress=RunProgress(last_pass=last_pass),
    )


def resume(state: ReconstructionState, checkpoint: Checkpoint, on_event: OnEvent) -> None:
    """Continue from the checkpoint if it holds a state."""
    saved = checkpoint.load()
    if saved is None:
        return
    with taking_apart(checkpoint.path):
        state.load_state_dict(saved["state"])
    progress = state.progress
    on_event(Note(f"continuing at pass {progress.current_pass + 1}, frame {progress.position}"))


def save(state: ReconstructionState, checkpoint: Checkpoint) -> None:
    """Write the checkpoint."""
    checkpoint.save({"state": state.state_dict()})
