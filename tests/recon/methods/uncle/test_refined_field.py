"""What the refinement of a finished map is given."""

from types import SimpleNamespace

import pytest
from uncle.recon.core.config.map_config import make_config
from uncle.recon.methods.uncle import refinement as module
from uncle.recon.methods.uncle.pipeline import reconstruct
from uncle.recon.methods.uncle.refinement import field_settings
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.frames import RunFrames


def test_sensors_alone_move_the_field_less_than_with_colour():
    config = make_config("uncle", ["field.learning_rate=0.01"]).field
    said, silent = (SimpleNamespace(witness=SimpleNamespace(samples=told)) for told in ({"color": 1}, {}))
    assert field_settings(said, config) == config
    slower = field_settings(silent, config)
    assert slower.learning_rate == pytest.approx(0.001)
    assert slower.model_copy(update={"learning_rate": 0.01}) == config


def test_the_field_is_refined_by_its_settings(make_mappable_run, tmp_path, monkeypatch):
    """One sensor, no colour to match: the readings of its keyframes, with a tenth of the step."""
    run, given = make_mappable_run(("noisy",)), []
    overrides = ["fusion.voxel_size_m=0.1", "fusion.passes=0", "field.iterations=3", "uncertainty.steps_per_pass=2"]
    config = make_config("uncle", overrides, sensors=("noisy",), device="cpu")
    monkeypatch.setattr(module, "refine", lambda field, *args: given.append(args) or [0.0])
    reconstruct(RunFrames(run, ("noisy",)), [0, 1], config, Checkpoint(tmp_path / "c.pt", ""), lambda *_: None)
    ((readings, settings, *_),) = given
    assert [rays.depths.shape[1] for rays in readings] == [1]
    assert settings.learning_rate == pytest.approx(0.1 * config.field.learning_rate)
