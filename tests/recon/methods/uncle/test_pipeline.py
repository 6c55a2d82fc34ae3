"""The sweeps of the reconstruction."""

from types import SimpleNamespace

import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.methods.uncle import pipeline
from uncle.recon.methods.uncle.pipeline import reconstruct
from uncle.recon.methods.uncle.progress import RunProgress
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.frames import RunFrames


def test_every_sweep_counts_every_reading_once(make_mappable_run, tmp_path):
    """The last sweep replaces the ones before: no sample has more readings than there are frames and sensors."""
    run = make_mappable_run(("noisy",))
    overrides = ["fusion.voxel_size_m=0.1", "fusion.passes=2", "field.iterations=0", "uncertainty.steps_per_pass=2"]
    config = make_config("uncle", overrides, sensors=("noisy",), device="cpu")
    betas: dict[int, torch.Tensor] = {}
    made = reconstruct(
        RunFrames(run, ("noisy",)), list(range(0, 12, 2)), config, Checkpoint(tmp_path / "c.pt", ""),
        lambda index, sensor, beta: betas.update({index: beta}),
    )  # fmt: skip
    counts = made.mapper.volume.counts()
    assert counts.max() <= 6
    assert counts.max() >= 3
    assert sorted(betas) == sorted(made.poses) == list(range(0, 12, 2))
    assert {"pass_1", "pass_2", "pass_3", "learning"} <= set(made.seconds)


@pytest.mark.parametrize(("off_px", "asked"), [(0.0, True), (1.0, True), (3.0, False)])
def test_colour_that_lies_beside_its_depth_is_no_witness(off_px, asked):
    looked, events = [], []
    witness = SimpleNamespace(look=lambda *_: looked.append(1))
    mapper = SimpleNamespace(config=make_config("uncle", []), witness=witness, surface=lambda: None)
    frames = SimpleNamespace(registration_sigma_px=off_px, stream=lambda indices, prepare: iter(()))
    pipeline._hear_colors(frames, mapper, RunProgress(last=1), events.append)
    assert bool(looked) == asked
    assert any("3 px beside its depth" in event.text for event in events) != asked
