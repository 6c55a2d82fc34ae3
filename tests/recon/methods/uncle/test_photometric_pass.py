"""Photometric depth in a reconstruction: what it corrects, its schedule, and when it is not used."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.events import Progress
from uncle.recon.core.mesh_raycaster import Surface
from uncle.recon.methods.uncle import pipeline
from uncle.recon.methods.uncle.pipeline import Reconstruction, ray_batches
from uncle.recon.methods.uncle.ray_batch import RayBatch
from uncle.recon.methods.uncle.views import noise_inputs
from uncle.recon.mvs import photometric_depth
from uncle.recon.mvs.bias_model import BiasModel
from uncle.recon.mvs.bias_validation import ConsistencyTestParameters, CrossViewConsistencyTest
from uncle.recon.mvs.photometric_depth import PhotometricDepth
from uncle.recon.mvs.sensor_reliability import DEFAULT_RELIABILITY
from uncle.recon.run.checkpoint import Checkpoint

QUICK = [
    "fusion.voxel_size_m=0.05", "fusion.min_observations=2", "keyframes.rays=500", "field.iterations=0",
    "uncertainty.steps_per_keyframe=4", "uncertainty.steps_per_pass=120", "uncertainty.learning_rate=0.01",
]  # fmt: skip


@pytest.fixture
def reconstructed(box_room, walk, painted_frames):
    """Reconstructs the walk from a sensor that measures 4 % too far."""

    def run(path, *settings, poses=walk, method="uncle", on_event=lambda event: None, interval_s=1e9) -> Reconstruction:
        quick = QUICK if method == "uncle" else QUICK[:2]
        config = make_config(method, [*quick, *settings], sensors=("stereo",), device="cpu")
        frames, checkpoint = painted_frames(box_room, poses, scale=1.04), Checkpoint(path, "", interval_s)
        return pipeline.reconstruct(frames, list(range(len(poses))), config, checkpoint, lambda *_: None, on_event)

    return run


def map_error(room, made: Reconstruction, walk) -> float:
    """Median distance between map and truth along the views, as a share of depth."""
    surface, errors = made.state.mapper.surface(), []
    for pose in walk:
        depth, true = surface.depth_from(room.camera, pose), room.depth(pose)
        errors.append((np.abs(depth / true - 1))[depth > 0])
    return float(np.median(np.concatenate(errors)))


def check_rays_of_the_refinement(room, with_colors: Reconstruction, without: Reconstruction) -> None:
    """Bias-corrected sensors with their reliability, and photometric depth; without it sensors as measured."""
    sensors, color = ray_batches(with_colors.state)
    assert sensors.reliability.tolist() == pytest.approx([DEFAULT_RELIABILITY])
    assert color.reliability.tolist() == [1.0]
    assert abs(beyond_walls(room, sensors)) < 0.012
    assert abs(beyond_walls(room, color)) < 0.006
    (alone,) = ray_batches(without.state)
    assert alone.reliability.tolist() == [1.0]
    assert beyond_walls(room, alone) == pytest.approx(0.04, abs=1e-3)


def beyond_walls(room, rays: RayBatch) -> float:
    """Median share of the depth by which measurements of the first source lie beyond the walls along their rays."""
    read = (rays.depths[:, 0] > 0).numpy()
    met = Surface(room.mesh()).cast(rays.origins.numpy()[read], rays.directions.numpy()[read])
    return float(np.median(rays.depths[:, 0].numpy()[read] / met - 1))


def test_the_map_overcomes_a_bias_that_its_only_sensor_always_has(box_room, walk, tmp_path, reconstructed):
    with_colors = reconstructed(tmp_path / "a")
    without = reconstructed(tmp_path / "b", "photometric.enabled=false")
    assert len(with_colors.curves["noise/photometric"]) == 3  # needs more passes: the first surface was off
    assert "pass_4" in with_colors.seconds
    assert "pass_3" not in without.seconds
    assert "noise/photometric" not in without.curves
    assert not without.state.photometric.views
    assert map_error(box_room, without, walk) == pytest.approx(0.04, abs=0.006)
    assert map_error(box_room, with_colors, walk) < 0.006
    assert with_colors.state.biases.improved_fraction["stereo"] >= ConsistencyTestParameters.accepted_fraction
    assert with_colors.state.photometric.validated
    assert with_colors.state.mapper.weights.reliability == {
        "stereo": DEFAULT_RELIABILITY
    }  # all views have an image in common
    assert not without.state.biases.improved_fraction
    assert without.state.mapper.weights.reliability == {"stereo": 1.0}
    check_rays_of_the_refinement(box_room, with_colors, without)
    assert not without.state.biases.models["stereo"].active


def test_beta_describes_measurements_with_their_bias(box_room, walk, tmp_path, reconstructed, painted_frames):
    made = reconstructed(tmp_path / "a")
    frame = painted_frames(box_room, walk, scale=1.04)[4]
    inputs = noise_inputs(frame, {"stereo": torch.from_numpy(box_room.normals(walk[4]))}, box_room.camera)
    corrected = made.state.biases.correct(frame, inputs).depths["stereo"].numpy()
    true = box_room.depth(walk[4])
    assert np.median(np.abs(corrected / true - 1)) < 0.012  # as measured: 0.04
    beta = made.state.noise.models["stereo"].beta_image(frame.depths["stereo"], inputs["stereo"]).numpy()
    # All errors are as large as their bias, which just lies in the interval of 50 %: half of them could not.
    assert np.median(beta * np.log(2) / (0.04 * true)) == pytest.approx(1.0, abs=0.15)


def test_photometric_depth_is_rejected_if_the_views_of_a_sensor_contradict_it(
    box_room, walk, tmp_path, monkeypatch, painted_frames
):
    """Depth is right, the pictures are taken by a camera with another focal length than that of the depth images."""
    wide = replace(box_room, camera=replace(box_room.camera, fx=box_room.camera.fx * 1.1, fy=box_room.camera.fy * 1.1))
    picture = type(box_room).picture
    monkeypatch.setattr(type(box_room), "picture", lambda room, pose: picture(wide, pose))
    frames = painted_frames(box_room, walk)
    config = make_config("uncle", QUICK, sensors=("stereo",), device="cpu")
    checkpoint = Checkpoint(tmp_path / "a", "", 1e9)
    made = pipeline.reconstruct(frames, list(range(len(walk))), config, checkpoint, lambda *_: None)
    assert made.state.biases.improved_fraction["stereo"] <= ConsistencyTestParameters.rejected_fraction
    assert not made.state.photometric.views
    assert not made.state.biases.models["stereo"].active
    assert map_error(box_room, made, walk) < 0.004


def test_a_later_pass_without_result_leaves_that_of_the_earlier_one(
    box_room, walk, tmp_path, monkeypatch, reconstructed
):
    fit, calls = photometric_depth.fit_photometric_noise, []

    def fit_once(*given):
        calls.append(1)
        return fit(*given) if len(calls) == 1 else None

    monkeypatch.setattr(photometric_depth, "fit_photometric_noise", fit_once)
    made = reconstructed(tmp_path / "a")
    assert len(calls) == 2  # and no third one
    assert len(made.state.photometric.views) == len(walk)
    assert made.state.biases.models["stereo"].active
    assert made.state.noise.error_quantiles["stereo"]  # learned from the last map
    assert map_error(box_room, made, walk) < 0.008


@pytest.mark.parametrize(("share", "kept"), [(None, True), (0.0, False)])
def test_a_later_fit_that_is_not_accepted_deactivates_the_bias(tmp_path, monkeypatch, share, kept, reconstructed):
    shares = iter([1.0, share])
    monkeypatch.setattr(CrossViewConsistencyTest, "improved_fraction", lambda *_: next(shares))
    made = reconstructed(tmp_path / "a")
    assert next(shares, "no third fit") == "no third fit"
    assert not made.state.biases.models["stereo"].active
    assert made.state.biases.improved_fraction == ({} if share is None else {"stereo": share})
    assert not made.state.photometric.validated
    assert made.state.mapper.weights.reliability == {"stereo": 1.0}
    assert bool(made.state.photometric.views) == kept


def test_the_number_of_passes_is_limited_by_the_setting(tmp_path, reconstructed):
    once = reconstructed(tmp_path / "a", "photometric.max_passes=1")
    assert len(once.curves["noise/photometric"]) == 1
    assert {"pass_2"} == {part for part in once.seconds if part in ("pass_2", "pass_3", "pass_4")}
    more = reconstructed(tmp_path / "b", "photometric.max_passes=2", "fusion.passes=3")
    assert len(more.curves["noise/photometric"]) == 2
    assert "pass_4" in more.seconds


def test_a_bias_below_that_of_photometric_depth_is_not_corrected(tmp_path, monkeypatch, reconstructed):
    monkeypatch.setattr(BiasModel, "exceeds_photometric_bias", lambda *_: False)
    made = reconstructed(tmp_path / "a")
    assert made.state.biases.improved_fraction["stereo"] >= ConsistencyTestParameters.accepted_fraction
    assert not made.state.biases.models["stereo"].active
    assert made.state.photometric.validated


def test_reliability_is_estimated_from_independent_views(box_room, walk, tmp_path, monkeypatch, reconstructed):
    monkeypatch.setattr(PhotometricDepth, "share_source_images", lambda self: np.eye(len(self.views), dtype=bool))
    made = reconstructed(tmp_path / "a")
    assert made.state.mapper.weights.reliability["stereo"] not in (1.0, DEFAULT_RELIABILITY)
    assert map_error(box_room, made, walk) < 0.008


def test_reliability_is_the_default_if_it_is_not_to_be_estimated(tmp_path, reconstructed):
    made = reconstructed(tmp_path / "a", "photometric.estimate_reliability=false")
    assert made.state.photometric.validated
    assert made.state.mapper.weights.reliability == {"stereo": DEFAULT_RELIABILITY}


OFF = ["uncertainty.enabled=false", "photometric.enabled=false", "fusion.passes=0"]


@pytest.mark.parametrize(("method", "settings"), [("tsdf", []), *(("uncle", [setting]) for setting in OFF)])
def test_there_is_no_photometric_pass(walk, tmp_path, monkeypatch, method, settings, reconstructed):
    def fail(*_):
        raise AssertionError("a photometric pass")

    monkeypatch.setattr(PhotometricDepth, "update", fail)
    made = reconstructed(tmp_path / "c", *settings, method=method, poses=walk[:4])
    assert not list(made.state.photometric.depth_images())


@pytest.mark.parametrize("stage", ["integrating, pass 2", "integrating, pass 3"])
def test_a_map_that_was_interrupted_is_the_same(walk, tmp_path, stage, reconstructed):
    def interrupt(event) -> None:
        if isinstance(event, Progress) and event.stage == stage and event.done == 4:
            raise InterruptedError

    unbroken = reconstructed(tmp_path / "a")
    with pytest.raises(InterruptedError):
        reconstructed(tmp_path / "b", on_event=interrupt, interval_s=0)
    texts: list[str] = []
    resumed = reconstructed(tmp_path / "b", on_event=lambda event: texts.append(str(event)))
    assert any(f"continuing at {stage.split(', ')[1]}" in text for text in texts)
    assert len(resumed.state.photometric.views) == len(walk)
    both = (unbroken.state.photometric.depth_images(), resumed.state.photometric.depth_images())
    for ours, theirs in zip(*both, strict=True):
        assert all(map(torch.equal, vars(ours).values(), vars(theirs).values()))
    assert torch.equal(unbroken.state.mapper.volume.sums, resumed.state.mapper.volume.sums)
    assert torch.equal(unbroken.state.mapper.volume.grid.blocks, resumed.state.mapper.volume.grid.blocks)
    assert unbroken.curves == resumed.curves


@pytest.mark.parametrize(("error_px", "is_used"), [(0.0, True), (1.0, True), (3.0, False)])
def test_photometric_depth_is_skipped_if_the_registration_is_off(
    walk, reconstructed, painted_frames, tmp_path, monkeypatch, error_px, is_used
):
    calls, events = [], []
    monkeypatch.setattr(PhotometricDepth, "update", lambda *_: calls.append(1))
    monkeypatch.setattr(painted_frames, "registration_sigma_px", error_px)
    reconstructed(tmp_path / "a", on_event=events.append, poses=walk[:2])
    assert bool(calls) == is_used
    assert any("off by 3 px" in getattr(event, "text", "") for event in events) != is_used
