"""`uncle pretrain decoders`: a tiny training end to end, its file, interruption and refusals."""

import pytest
import torch
from click.testing import CliRunner
from uncle.cli.main import main
from uncle.recon.methods.nice.decoder_files import load_decoders
from uncle.recon.methods.pretrain import decoder_run
from uncle.recon.methods.pretrain.decoder_training import DecoderTrainer, DecoderTraining

TINY = ["--steps", "4", "--cubes", "12", "--device", "cpu", "--seed", "3"]


@pytest.fixture(autouse=True)
def _quick_scores(monkeypatch):
    """Scores of two cubes instead of 24; they are tested by themselves."""
    full = decoder_run.decoder_scores
    monkeypatch.setattr(decoder_run, "decoder_scores", lambda *given: full(*given, cubes=2, steps=2, pool=512))


def test_a_tiny_training_writes_decoders_with_their_recipe(tmp_path):
    out = tmp_path / "decoders.pt"
    done = CliRunner().invoke(main, ["pretrain", "decoders", *TINY, "--out", str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "IoU" in done.output
    recipe = load_decoders(out).recipe
    assert recipe["settings"]["seed"] == 3
    assert recipe["versions"]["torch"] == torch.__version__
    assert 0 <= recipe["scores"]["fine_iou"] <= 1
    assert [path.name for path in tmp_path.iterdir()] == ["decoders.pt"]

    again = CliRunner().invoke(main, ["pretrain", "decoders", *TINY, "--out", str(out)])
    assert again.exit_code == 1
    assert "--overwrite" in again.output


def test_an_interrupted_training_goes_on(tmp_path, monkeypatch):
    out, step = tmp_path / "decoders.pt", DecoderTrainer.step
    settings, cpu = DecoderTraining(steps=4, cubes=12), torch.device("cpu")
    monkeypatch.setattr(decoder_run, "REPORT_EVERY", 1)
    monkeypatch.setattr(decoder_run.Checkpoint, "due", lambda self: True)

    def interrupted(trainer):
        if trainer.done == 2:
            raise KeyboardInterrupt
        return step(trainer)

    monkeypatch.setattr(DecoderTrainer, "step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        decoder_run.pretrain_decoders(out, settings, cpu)
    assert not out.exists()
    monkeypatch.setattr(DecoderTrainer, "step", step)
    events = []
    decoders = decoder_run.pretrain_decoders(out, settings, cpu, on_event=events.append)
    assert decoders.recipe["continued_at_steps"] == [2]
    assert any("step 2" in getattr(event, "text", "") for event in events)
    assert [path.name for path in tmp_path.iterdir()] == ["decoders.pt"]


def test_cubes_that_make_no_groups_are_refused(tmp_path):
    arguments = ["pretrain", "decoders", "--cubes", "13", "--out", str(tmp_path / "decoders.pt")]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 1
    assert "multiple of 12" in done.output
