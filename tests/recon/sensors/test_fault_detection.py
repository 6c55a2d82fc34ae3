"""Verdicts on sensors that fail in ways that are known."""

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.uncle import FaultDetectionConfig
from uncle.recon.core.frame import Frame
from uncle.recon.sensors.fault_detection import (
    Comparison,
    FaultDetectionParameters,
    FaultDetector,
    compare_depths,
    image_motion,
    is_unusual,
    repeats,
)

CAMERA = Camera(160, 120, 100.0, 100.0, 79.5, 59.5)
FAR_M = 6.0


def slope(index: int, metres: float = 2.0) -> torch.Tensor:
    """(120, 160) metres: a slanted wall that moves sideways with the frame."""
    return metres + 0.004 * (torch.arange(160.0) + 2 * index).expand(120, 160)


def noisy(depth: torch.Tensor, index: int, share: float) -> torch.Tensor:
    return depth * (1 + share * torch.randn(depth.shape, generator=torch.Generator().manual_seed(index)))


def make_frame(index: int, depths: dict[str, torch.Tensor], moves: bool = True, grey: int = 90) -> Frame:
    pose = np.eye(4)
    pose[0, 3] = 0.04 * index * moves
    return Frame(index, index, torch.full((120, 160, 3), grey, dtype=torch.uint8), depths, pose)


def make_health(*sensors: str, poses_given: bool = True, **settings: float) -> FaultDetector:
    return FaultDetector(CAMERA, sensors, FaultDetectionConfig(**settings), poses_given)


def judge(health: FaultDetector, frame: Frame, truth: torch.Tensor) -> Frame:
    """As the mapper does, with a map that knows the truth (H, W)."""
    looked = health.check_images(frame)
    rays = health.rays
    u, v = (rays[:, 0] * CAMERA.fx + CAMERA.cx).round().long(), (rays[:, 1] * CAMERA.fy + CAMERA.cy).round().long()
    return health.check_against_map(looked, truth[v, u], FAR_M)


def watch(health: FaultDetector, frames: int, depths, **options) -> list[Frame]:
    return [judge(health, make_frame(i, depths(i), **options), slope(i)) for i in range(frames)]


def verdicts(health: FaultDetector, sensor: str) -> str:
    """One letter for each frame."""
    return "".join(verdict[0] for verdict in health.verdicts[sensor].values())


def both(index: int, faulty: torch.Tensor | None = None) -> dict[str, torch.Tensor]:
    """A good sensor `a` and a poorer one `b`, whose image may be replaced."""
    return {"a": noisy(slope(index), index, 0.005), "b": noisy(slope(index), 99 + index, 0.03)} | (
        {} if faulty is None else {"b": faulty}
    )


def test_sensors_that_are_well_are_left_alone():
    health = make_health("a", "b")
    frames = watch(health, 30, both)
    assert verdicts(health, "a") == verdicts(health, "b") == "o" * 30
    assert all(torch.equal(frame.depths["b"], both(i)["b"]) for i, frame in enumerate(frames))


@pytest.mark.parametrize(
    ("fault", "letter"),
    [
        (lambda i: torch.zeros(120, 160), "m"),
        (lambda i: both(9)["b"] * (torch.arange(160) < 3), "m"),
        (lambda i: both(9)["b"], "f"),
        (lambda i: both(i)["b"] + 0.2, "i"),
        (lambda i: both(i)["b"] - 0.2, "i"),
        (lambda i: 1 + 3 * torch.rand(120, 160, generator=torch.Generator().manual_seed(i)), "i"),
    ],
    ids=["zero", "a few pixels left", "frozen", "too far", "too near", "garbage"],
)
@pytest.mark.parametrize("poses_given", [True, False])
def test_a_sensor_that_fails_and_recovers(fault, letter, poses_given):
    health = make_health("a", "b", poses_given=poses_given)
    grey = iter(range(60, 240, 4))
    frames = [
        judge(health, make_frame(i, both(i, fault(i) if 10 <= i < 20 else None), grey=next(grey)), slope(i))
        for i in range(30)
    ]
    assert verdicts(health, "b") == "o" * 10 + letter * 10 + "o" * 10
    assert verdicts(health, "a") == "o" * 30
    assert all(not frames[i].depths["b"].any() for i in range(10, 20))
    assert all(frames[i].depths["b"].any() for i in range(20, 30))


def test_a_camera_that_stands_still_is_no_frozen_sensor():
    health = make_health("a")
    watch(health, 12, lambda i: {"a": slope(3)}, moves=False)
    assert verdicts(health, "a") == "o" * 12


def test_the_colour_tells_that_the_camera_moved_where_no_pose_is_given():
    health = make_health("a", poses_given=False)
    for i in range(6):
        health.check_images(make_frame(i, {"a": slope(3)}, grey=90 + 5 * i))
    assert verdicts(health, "a") == "o" + "f" * 5
    still = make_health("a", poses_given=False)
    for i in range(6):
        still.check_images(make_frame(i, {"a": slope(3)}, moves=True))  # by an unused pose
    assert verdicts(still, "a") == "o" * 6


def test_a_bare_wall_is_no_frozen_sensor():
    health = make_health("a")
    for i in range(6):
        health.check_images(make_frame(i, {"a": torch.full((120, 160), 2.0)}))
    assert verdicts(health, "a") == "o" * 6


def test_a_frozen_sensor_that_moves_a_little_each_frame_is_caught():
    """Each step is below a pixel; together they are not."""
    health = make_health("a")
    for i in range(10):
        frame = make_frame(i, {"a": slope(3)})
        frame.T_world_camera[0, 3] = 0.006 * i
        health.check_images(frame)
    assert verdicts(health, "a") == "o" * 4 + "f" * 6


def test_nobody_is_blamed_where_all_sensors_are_off():
    """A wrong pose puts every sensor off."""
    health = make_health("a", "b")
    watch(health, 20, lambda i: both(i) if i < 10 else {s: depth + 0.2 for s, depth in both(i).items()})
    assert verdicts(health, "a") == verdicts(health, "b") == "o" * 20


@pytest.mark.parametrize(("poses_given", "expected"), [(True, "o" * 10 + "i" * 10), (False, "o" * 20)])
def test_one_sensor_alone_is_blamed_where_the_poses_are_sure(poses_given, expected):
    health = make_health("a", poses_given=poses_given)
    watch(health, 20, lambda i: {"a": slope(i) + (0.2 if i >= 10 else 0)})
    assert verdicts(health, "a") == expected


def test_the_first_frames_blame_nobody():
    health = make_health("a", "b")
    watch(health, FaultDetectionParameters().min_history, lambda i: both(i, slope(i) + 0.2 * i))
    assert verdicts(health, "b") == "o" * FaultDetectionParameters().min_history


def test_the_verdict_stands_where_the_map_is_unknown():
    health = make_health("a", "b")
    watch(health, 12, lambda i: both(i, both(i)["b"] + 0.2) if i >= 10 else both(i))
    judge(health, make_frame(12, both(12)), torch.zeros(120, 160))
    assert (health.verdicts["a"][12], health.verdicts["b"][12]) == ("ok", "inconsistent")


def test_a_suspect_is_kept_from_the_tracker_unless_it_is_alone():
    health = make_health("a", "b")
    watch(health, 12, lambda i: both(i, both(i)["b"] + 0.2) if i >= 10 else both(i))
    next_frame = health.check_images(make_frame(12, both(12)))
    assert not health.without_suspected(next_frame).depths["b"].any()
    alone = make_frame(12, {**both(12), "a": torch.zeros(120, 160)})
    assert health.without_suspected(alone).depths["b"].any()


def test_what_is_switched_off_judges_nothing():
    health = make_health("a", "b", enabled=False)
    watch(health, 14, lambda i: both(i, torch.zeros(120, 160)))
    assert health.verdicts == {"a": {}, "b": {}}


def test_state_continues_with_the_same_verdicts():
    def fault(i):
        return both(i, both(9)["b"] if i >= 10 else None)

    unbroken, first, second = (make_health("a", "b") for _ in range(3))
    watch(unbroken, 16, fault)
    watch(first, 12, fault)
    second.load_state_dict(first.state_dict())
    for i in range(12, 16):
        judge(second, make_frame(i, fault(i)), slope(i))
    assert second.verdicts == unbroken.verdicts
    assert second.state_dict()["history"] == unbroken.state_dict()["history"]
    assert verdicts(first, "b") == "o" * 10 + "ff"  # what is loaded is not shared


# --- the parts -------------------------------------------------------------------------------------------------------
def test_compare_depths_is_signed_and_robust():
    predicted = torch.full((100,), 2.0)
    depth = predicted * 1.1
    depth[:30] = 5.0
    found = compare_depths(depth, predicted, FAR_M)
    assert found.median == pytest.approx(0.1, abs=1e-5)
    assert found.count == 100
    assert compare_depths(-depth.clamp(max=0), predicted, FAR_M).count == 0
    assert compare_depths(depth, predicted, 4.0).count == 70


def test_what_is_usual_of_a_poor_sensor_is_unusual_of_a_good_one():
    config, now = FaultDetectionConfig(), Comparison(0.05, 0.01, 500)
    steady, restless = [0.001, -0.001] * 10, [0.03, -0.03] * 10
    assert is_unusual(now, steady, [0.01] * 20, config)
    assert not is_unusual(now, restless, [0.01] * 20, config)
    assert not is_unusual(now, [0.05] * 20, [0.01] * 20, config)  # it was always that far off
    assert not is_unusual(now, [*steady, 0.021], [0.01] * 21, config)  # it was on its way
    assert is_unusual(Comparison(0.0, 0.2, 500), steady, [0.01] * 20, config)
    assert not is_unusual(Comparison(0.0, 0.2, 500), steady, [0.1] * 20, config)


def test_repeats_bears_rounding_and_a_few_pixels():
    image = noisy(slope(0), 0, 0.01)
    assert repeats(image + 0.0005, image)
    assert not repeats(noisy(slope(0), 1, 0.01), image)
    assert not repeats(torch.zeros(120, 160), image)


def test_image_motion_of_a_turn_and_of_a_shift():
    shifted, turned = np.eye(4), np.eye(4)
    shifted[0, 3] = 0.1
    turned[:2, :2] = [[np.cos(0.02), -np.sin(0.02)], [np.sin(0.02), np.cos(0.02)]]
    assert image_motion(np.eye(4), shifted, 2.0, CAMERA) == pytest.approx(5.0)
    assert image_motion(np.eye(4), turned, 2.0, CAMERA) == pytest.approx(2.0, rel=1e-4)
