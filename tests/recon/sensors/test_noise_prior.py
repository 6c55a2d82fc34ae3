"""Noise models as files: read as they were written, rejected where they do not fit, and of use as a prior."""

import json
import shutil
import time
from functools import partial

import numpy as np
import pytest
import torch
from uncle.recon.core.config.map_config import MapConfig, make_config
from uncle.recon.core.config.uncle import UncertaintyConfig
from uncle.recon.core.errors import ConfigError, RunError
from uncle.recon.core.events import Progress, Warn
from uncle.recon.core.tensor_files import load_tensors, save_tensors
from uncle.recon.methods.uncle.online_pass import integrate_new_frame
from uncle.recon.methods.uncle.state import start
from uncle.recon.methods.uncle.views import noise_inputs
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames
from uncle.recon.sensors import noise_prior
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS
from uncle.recon.sensors.noise_model import NoiseModel, Residuals
from uncle.recon.sensors.noise_prior import NoisePrior, save_noise_models
from uncle.recon.stages import map as map_stage
from uncle.recon.stages.map import map_run

QUICK = [
    "fusion.voxel_size_m=0.05",
    "fusion.min_observations=2",
    "keyframes.rays=500",
    "field.iterations=3",
    "field.rays=256",
    "uncertainty.steps_per_keyframe=4",
    "uncertainty.steps_per_pass=150",
    "uncertainty.batch=512",
]


def settings(*overrides: str, method: str = "uncle", **top_level) -> MapConfig:
    return make_config(method, [*QUICK, *overrides], device="cpu", **top_level)


def learned_model(seed: int = 0, **config) -> NoiseModel:
    generator = torch.Generator().manual_seed(seed)
    model = NoiseModel(UncertaintyConfig(batch=64, **config), generator)
    features = torch.rand(500, len(SENSOR_INPUTS), generator=generator)
    model.learn(Residuals.from_exact_reference(0.05 * features[:, 0], features), 20, generator)
    return model


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "models" / "noise_model.pt"
    save_noise_models(path, {"sl": learned_model(1), "sgm": learned_model(2)})
    return path


def test_a_model_starts_as_the_one_that_was_saved(file):
    model = NoiseModel(UncertaintyConfig(), torch.Generator().manual_seed(9))
    features = torch.rand(100, len(SENSOR_INPUTS), generator=torch.Generator().manual_seed(3))
    assert not model.is_trained
    untouched = NoiseModel(UncertaintyConfig(), torch.Generator().manual_seed(8))
    NoisePrior.load(file).initialise({"sgm": model, "psmnet": untouched})
    assert torch.equal(model(features), learned_model(2)(features))
    assert model.is_trained
    assert not untouched.is_trained


def test_models_that_learned_nothing_are_not_saved(tmp_path):
    save_noise_models(
        tmp_path / "m.pt", {"a": learned_model(), "b": NoiseModel(UncertaintyConfig(), torch.Generator())}
    )
    assert list(NoisePrior.load(tmp_path / "m.pt").sensors) == ["a"]


def test_digest_is_that_of_the_content(file, tmp_path):
    prior = NoisePrior.load(file)
    shutil.copy(file, tmp_path / "copy.pt")
    assert NoisePrior.load(tmp_path / "copy.pt").digest == prior.digest
    digests = {prior.digest}
    for models in (
        {"sl": learned_model(1), "sgm": learned_model(3)}, {"sl": learned_model(1)},
        {"sl": learned_model(1), "other": learned_model(2)},
        {"sl": learned_model(1), "sgm": learned_model(2, beta_min_m=0.002)},
    ):  # fmt: skip
        save_noise_models(tmp_path / "copy.pt", models)
        digests.add(NoisePrior.load(tmp_path / "copy.pt").digest)
    assert len(digests) == 5


def test_what_is_no_file_of_models_is_refused(file, tmp_path):
    with pytest.raises(ConfigError, match=r"none\.pt: there is no such file"):
        NoisePrior.load(tmp_path / "none.pt")
    broken = tmp_path / "broken.pt"
    state = load_tensors(file)
    for content in (b"", b"no archive", file.read_bytes()[:2000]):
        broken.write_bytes(content)
        with pytest.raises(ConfigError, match=r"broken\.pt: not a file of noise models"):
            NoisePrior.load(broken)
    for other in ({"weights": 1}, state | {"sensors": [1]}, state | {"sensors": {"sl": {"weights": {}}}}, [1]):
        save_tensors(broken, other)
        with pytest.raises(ConfigError, match="not a file of noise models"):
            NoisePrior.load(broken)
    save_tensors(broken, state | {"version": 2})
    with pytest.raises(ConfigError, match=r"another version of uncle \(format 2, here 1\); give a run directory"):
        NoisePrior.load(broken)


def test_models_of_another_shape_are_refused(file, tmp_path, monkeypatch):
    prior = NoisePrior.load(file)
    prior.require_fit(["sl"], UncertaintyConfig())
    with pytest.raises(ConfigError, match=r"sensor sl.*16 wide, here 24; add --set uncertainty\.hidden=16"):
        prior.require_fit(["sl"], UncertaintyConfig(hidden=24))
    with pytest.raises(ConfigError, match=r"other inputs; add --set 'uncertainty\.inputs=\[\"depth"):
        prior.require_fit(["sl"], UncertaintyConfig(inputs=("depth",)))
    prior.sensors["sl"]["weights"]["layers.0.bias"] = torch.zeros(3)
    with pytest.raises(ConfigError, match="another shape"):
        prior.require_fit(["sl"], UncertaintyConfig())
    monkeypatch.setattr(noise_prior, "SENSOR_INPUTS", (*SENSOR_INPUTS[:-1], "novelty"))
    with pytest.raises(ConfigError, match=rf"sensor sgm.*other inputs \({SENSOR_INPUTS[-1]}, novelty\)"):
        prior.require_fit(["sgm"], UncertaintyConfig())


def test_the_advice_on_inputs_helps(tmp_path):
    save_noise_models(tmp_path / "m.pt", {"sl": learned_model(inputs=("depth", "incidence"))})
    with pytest.raises(ConfigError) as error:
        NoisePrior.load(tmp_path / "m.pt").require_fit(["sl"], UncertaintyConfig())
    advice = str(error.value).split("--set '")[1].rstrip("'")
    NoisePrior.load(tmp_path / "m.pt").require_fit(["sl"], make_config("uncle", [advice]).uncertainty)


def test_sensors_without_a_model(file):
    prior = NoisePrior.load(file)
    assert prior.covers(("psmnet", "sgm")) == ["sgm"]
    with pytest.raises(ConfigError, match="none of the sensors tof, only of sl, sgm"):
        prior.covers(("tof",))


def test_runs_as_priors(make_mappable_run, tmp_path):
    run = make_mappable_run(("noisy",))
    with pytest.raises(RunError, match="uncle preprocess"):
        NoisePrior.load(tmp_path)
    with pytest.raises(RunError, match="uncle map"):
        NoisePrior.load(run.root)
    run.finish_stage("map", "0", time.time(), {"method": "tsdf"})
    with pytest.raises(RunError, match="holds no noise models"):
        NoisePrior.load(run.root)
    map_run(run, settings())
    found = NoisePrior.load(run.root)
    assert list(found.sensors) == ["noisy"]
    assert found.digest == NoisePrior.load(run.noise_model_path).digest
    map_run(run, settings("uncertainty.enabled=false"))
    assert not run.noise_model_path.exists()


@pytest.fixture
def rig(make_mappable_run, tmp_path):
    """A run that was mapped, and the noise models of another one with the same sensors, elsewhere in the room."""
    other = make_mappable_run(angles=np.linspace(0.3, 2 * np.pi + 0.3, 10, endpoint=False))
    map_run(other, settings(sensors=("gt", "noisy")))
    model = tmp_path / "rig.pt"
    shutil.copy(other.noise_model_path, model)
    shutil.rmtree(other.root)
    return make_mappable_run(), model


def test_a_prior_is_part_of_what_decides_the_map(rig):
    run, model = rig
    prior, both = NoisePrior.load(model), settings(sensors=("gt", "noisy"))
    assert not map_run(run, both, prior=prior).unchanged
    facts = run.load_manifest().stages["map"].facts
    assert facts["prior"] == {"path": str(model), "digest": prior.digest, "sensors": ["gt", "noisy"]}
    with_prior = run.noise_model_path.read_bytes()
    assert map_run(run, both, prior=prior).unchanged
    assert not map_run(run, both).unchanged
    assert "prior" not in run.load_manifest().stages["map"].facts
    assert run.noise_model_path.read_bytes() != with_prior
    shutil.copy(run.noise_model_path, model)
    assert not map_run(run, both, prior=NoisePrior.load(model)).unchanged


def test_what_cannot_start_from_a_prior_is_said(rig):
    run, model = rig
    prior = NoisePrior.load(model)
    with pytest.raises(ConfigError, match="learned uncertainty"):
        map_run(run, make_config("tsdf", ["fusion.voxel_size_m=0.05"]), prior=prior)
    with pytest.raises(ConfigError, match="24; add --set"):
        map_run(run, settings("uncertainty.hidden=24"), prior=prior)
    assert "map" not in run.load_manifest().stages
    events = []
    only = NoisePrior(model, {"gt": prior.sensors["gt"]})
    map_run(run, settings(sensors=("gt", "noisy")), prior=only, on_event=events.append)
    assert any(isinstance(event, Warn) and "does not know noisy" in event.text for event in events)
    with pytest.raises(ConfigError, match="copy the file elsewhere"):
        map_run(run, settings(), prior=NoisePrior.load(run.root))


class Broken(Exception):
    """Stands for whatever ends a process."""


def test_a_broken_map_with_a_prior_resumes_to_the_same(rig, monkeypatch):
    run, model = rig
    monkeypatch.setattr(map_stage, "Checkpoint", partial(Checkpoint, interval_s=0.0))
    prior, config = NoisePrior.load(model), settings(sensors=("gt", "noisy"))
    map_run(run, config, prior=prior)
    expected = run.noise_model_path.read_bytes(), run.load_manifest().stages["map"].facts["sensor_weight_share"]

    def break_at(stage: str, event) -> None:
        if isinstance(event, Progress) and event.stage.startswith(stage) and event.done == 5:
            raise Broken

    for stage in ("mapping", "integrating"):
        with pytest.raises(Broken):
            map_run(run, config, prior=prior, overwrite=True, on_event=partial(break_at, stage))
        with pytest.raises(RunError, match="other settings"):
            map_run(run, config, resume=True)
        map_run(run, config, prior=prior, resume=True)
        assert (
            run.noise_model_path.read_bytes(),
            run.load_manifest().stages["map"].facts["sensor_weight_share"],
        ) == expected


def test_the_better_sensor_has_the_larger_share(rig):
    run, _ = rig
    map_run(run, settings(sensors=("gt", "noisy")))
    share = json.loads(run.manifest_path.read_text())["stages"]["map"]["facts"]["sensor_weight_share"]
    assert set(share) == {"gt", "noisy"}
    assert sum(share.values()) == pytest.approx(1.0, abs=1e-3)
    assert share["gt"] > 0.55


def test_a_prior_knows_the_sensors_from_the_first_frame_on(rig):
    """Its betas of the first frames are closer to those that the whole recording teaches than without it."""
    run, model = rig
    config = settings(sensors=("gt", "noisy"))
    map_run(run, config)
    final, prior = NoisePrior.load(run.root), NoisePrior.load(model)
    off = {None: first_betas(run, config, None), "prior": first_betas(run, config, prior)}
    last = first_betas(run, config, final, frames=0)
    errors = {name: np.abs(np.log(betas / last)).mean() for name, betas in off.items()}
    assert errors["prior"] < 0.5 * errors[None]


def first_betas(run: RunDirectory, config: MapConfig, prior: NoisePrior | None, frames: int = 2) -> np.ndarray:
    """Betas of the third frame after two were mapped, both sensors one after the other."""
    recording = RunFrames(run, config.sensors)
    state = start(recording, config, prior)
    for index in range(3):
        frame = recording[index]
        normals = {sensor: recording.normals(index, sensor) for sensor in config.sensors}
        inputs = noise_inputs(frame, normals, recording.camera)
        if index < frames:
            integrate_new_frame(state, frame, inputs, torch.from_numpy(frame.T_world_camera).float())
    models = state.noise.models
    betas = [models[s].beta_image(frame.depths[s], inputs[s]).numpy().ravel() for s in config.sensors]
    return np.concatenate(betas)
