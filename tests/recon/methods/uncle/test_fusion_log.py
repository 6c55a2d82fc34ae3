"""Integration records: frames whose poses changed, and the noise models of the time."""

import math

import numpy as np
import pytest
import torch
from uncle.recon.core.config.uncle import UncertaintyConfig
from uncle.recon.core.se3 import apply_motion
from uncle.recon.methods.uncle.fusion_log import FusionLog, FusionLogParameters
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS
from uncle.recon.sensors.noise_model import NoiseModel, Residuals


def models() -> dict[str, NoiseModel]:
    generator = torch.Generator().manual_seed(0)
    return {sensor: NoiseModel(UncertaintyConfig(), generator) for sensor in ("a", "b")}


def pose(*motion: float) -> torch.Tensor:
    start = apply_motion(np.eye(4), np.array([1.0, 2.0, 3.0, 0.3, -2.0, 0.5]))
    return torch.from_numpy(apply_motion(start, np.array(motion))).float()


def test_frames_that_moved_too_far_are_found():
    log, noise = FusionLog(), models()
    for index in range(5):
        log.add(index, pose(0, 0, 0, 0, 0, 0), noise, 10)
    poses = {0: pose(0, 0, 0, 0, 0, 0), 1: pose(0.009, 0, 0, 0, 0, 0), 2: pose(0, 0.008, 0.008, 0, 0, 0),
             3: pose(0, 0, 0, 0, 0.006, 0), 7: pose(1, 1, 1, 0, 0, 0)}  # fmt: skip
    assert log.moved_frames(poses, 0.01) == [2, 3]
    assert log.moved_frames(poses, 0.0125) == []
    assert log.moved_frames({3: pose(0, 0, 0, 0, math.pi, 0)}, 0.99 * FusionLogParameters.lever_m * math.pi) == [3]
    log.add(2, poses[2], noise, 10)  # integrated again with it
    assert log.moved_frames(poses, 0.01) == [3]


def test_records_do_not_share_memory_with_the_given_pose():
    log, given = FusionLog(), torch.eye(4)
    log.add(0, given, models(), 10)
    given[0, 3] = 5.0
    assert log.moved_frames({0: torch.eye(4)}, 0.001) == []


def test_snapshots_are_shared_until_a_model_learns():
    log, noise = FusionLog(), models()
    features = torch.rand(50, len(SENSOR_INPUTS))
    log.add(0, torch.eye(4), noise, 1)
    log.add(1, torch.eye(4), noise, 2)
    before = noise["b"](features).detach()
    noise["b"].learn(Residuals.from_exact_reference(torch.rand(50), features), 3, torch.Generator())
    log.add(2, torch.eye(4), noise, 3)
    log.add(3, torch.eye(4), noise, 4)
    assert [log.records[i].snapshot for i in range(4)] == [0, 0, 1, 1]
    assert [log.records[i].block_count for i in range(4)] == [1, 2, 3, 4]
    assert len(log.snapshots) == 2
    after = noise["b"](features).detach()
    assert not torch.equal(before, after)
    assert torch.equal(log.noise_models(log.records[1], noise)["b"](features), before)
    assert torch.equal(log.noise_models(log.records[2], noise)["b"](features), after)
    assert torch.equal(noise["b"](features), after)  # the models themselves stay


def test_state_round_trip():
    log, noise = FusionLog(), models()
    log.add(3, pose(0, 0, 0, 0, 0, 0), noise, 7)
    again = FusionLog()
    again.load_state_dict(log.state_dict())
    assert again.records[3].block_count == 7
    assert torch.equal(again.records[3].T_world_camera, log.records[3].T_world_camera)
    features = torch.rand(5, len(SENSOR_INPUTS))
    assert torch.equal(again.noise_models(again.records[3], models())["a"](features), noise["a"](features))
    log.clear()
    assert not log.records
    assert not log.snapshots
    with pytest.raises(KeyError):
        log.records[3]


def test_a_state_comes_back_where_the_map_is():
    """The meta device stands for an accelerator: it knows where tensors are, and no values."""
    log, noise = FusionLog(), models()
    log.add(4, pose(0, 0, 0, 0, 0, 0), noise, 7)
    restored, elsewhere = FusionLog(), FusionLog()
    restored.load_state_dict(log.state_dict())
    assert torch.equal(restored.records[4].T_world_camera, log.records[4].T_world_camera)
    assert (restored.records[4].snapshot, restored.records[4].block_count) == (0, 7)
    features = torch.rand(5, len(SENSOR_INPUTS))
    assert torch.equal(restored.noise_models(restored.records[4], models())["b"](features), noise["b"](features))
    elsewhere.load_state_dict(log.state_dict(), "meta")
    assert elsewhere.records[4].T_world_camera.device.type == "meta"
    assert all(v.device.type == "meta" for weights in elsewhere.snapshots[0].values() for v in weights.values())
