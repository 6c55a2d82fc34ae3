"""What was fused from where: which cameras moved, and the models as they were."""

import math

import numpy as np
import pytest
import torch
from uncle.recon.core.config.uncle import UncertaintyConfig
from uncle.recon.core.se3 import apply_motion
from uncle.recon.methods.uncle.fusion_log import LEVER_M, FusionLog
from uncle.recon.sensors.noise_inputs import FEATURES
from uncle.recon.sensors.noise_model import NoiseModel, Residuals


def models() -> dict[str, NoiseModel]:
    generator = torch.Generator().manual_seed(0)
    return {sensor: NoiseModel(UncertaintyConfig(), generator) for sensor in ("a", "b")}


def pose(*motion: float) -> torch.Tensor:
    start = apply_motion(np.eye(4), np.array([1.0, 2.0, 3.0, 0.3, -2.0, 0.5]))
    return torch.from_numpy(apply_motion(start, np.array(motion))).float()


def test_moved_tells_who_went_too_far():
    log, noise = FusionLog(), models()
    for index in range(5):
        log.note(index, pose(0, 0, 0, 0, 0, 0), noise, 10)
    poses = {0: pose(0, 0, 0, 0, 0, 0), 1: pose(0.009, 0, 0, 0, 0, 0), 2: pose(0, 0.008, 0.008, 0, 0, 0),
             3: pose(0, 0, 0, 0, 0.006, 0), 7: pose(1, 1, 1, 0, 0, 0)}  # fmt: skip
    assert log.moved(poses, 0.01) == [2, 3]
    assert log.moved(poses, 0.0125) == []
    assert log.moved({3: pose(0, 0, 0, 0, math.pi, 0)}, 0.99 * LEVER_M * math.pi) == [3]
    log.note(2, poses[2], noise, 10)  # fused again from there
    assert log.moved(poses, 0.01) == [3]


def test_what_is_noted_does_not_change_with_the_pose_given():
    log, given = FusionLog(), torch.eye(4)
    log.note(0, given, models(), 10)
    given[0, 3] = 5.0
    assert log.moved({0: torch.eye(4)}, 0.001) == []


def test_snapshots_are_shared_until_a_model_learns():
    log, noise = FusionLog(), models()
    features = torch.rand(50, len(FEATURES))
    log.note(0, torch.eye(4), noise, 1)
    log.note(1, torch.eye(4), noise, 2)
    before = noise["b"](features).detach()
    noise["b"].learn(Residuals.against_truth(torch.rand(50), features), 3, torch.Generator())
    log.note(2, torch.eye(4), noise, 3)
    log.note(3, torch.eye(4), noise, 4)
    assert [log.entries[i].snapshot for i in range(4)] == [0, 0, 1, 1]
    assert [log.entries[i].blocks for i in range(4)] == [1, 2, 3, 4]
    assert len(log.snapshots) == 2
    after = noise["b"](features).detach()
    assert not torch.equal(before, after)
    assert torch.equal(log.models(log.entries[1], noise)["b"](features), before)
    assert torch.equal(log.models(log.entries[2], noise)["b"](features), after)
    assert torch.equal(noise["b"](features), after)  # the models themselves stay


def test_state_round_trip():
    log, noise = FusionLog(), models()
    log.note(3, pose(0, 0, 0, 0, 0, 0), noise, 7)
    again = FusionLog()
    again.load_state_dict(log.state_dict())
    assert again.entries[3].blocks == 7
    assert torch.equal(again.entries[3].T_world_camera, log.entries[3].T_world_camera)
    features = torch.rand(5, len(FEATURES))
    assert torch.equal(again.models(again.entries[3], models())["a"](features), noise["a"](features))
    log.clear()
    assert not log.entries
    assert not log.snapshots
    with pytest.raises(KeyError):
        log.entries[3]


def test_a_state_comes_back_where_the_map_is():
    """The meta device stands for an accelerator: it knows where tensors are, and no values."""
    log, noise = FusionLog(), models()
    log.note(4, pose(0, 0, 0, 0, 0, 0), noise, 7)
    restored, elsewhere = FusionLog(), FusionLog()
    restored.load_state_dict(log.state_dict())
    assert torch.equal(restored.entries[4].T_world_camera, log.entries[4].T_world_camera)
    assert (restored.entries[4].snapshot, restored.entries[4].blocks) == (0, 7)
    features = torch.rand(5, len(FEATURES))
    assert torch.equal(restored.models(restored.entries[4], models())["b"](features), noise["b"](features))
    elsewhere.load_state_dict(log.state_dict(), "meta")
    assert elsewhere.entries[4].T_world_camera.device.type == "meta"
    assert all(v.device.type == "meta" for weights in elsewhere.snapshots[0].values() for v in weights.values())
