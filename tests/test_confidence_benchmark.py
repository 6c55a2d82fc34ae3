"""`benchmarks/confidence.py`: what it says of a confidence that is known."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import confidence
from uncle.recon.run.frames import RunFrames


class Oracle:
    """Models whose confidence falls with the true error of the box room's sensor."""

    def __init__(self, frames: RunFrames, sign: float) -> None:
        self.frames, self.sign, self.index = frames, sign, 0

    def image(self, sensor: str, depth: torch.Tensor) -> torch.Tensor:
        error = (depth - self.frames.depth(self.index, "gt")).abs()
        self.index += 4
        return torch.exp(-self.sign * error.clamp(max=2))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_oracle_ranks_perfectly_and_its_opposite_the_other_way(make_mappable_run, sign):
    frames = RunFrames(make_mappable_run(("gt", "noisy")))
    scores = confidence.score(frames, "noisy", Oracle(frames, sign), every=4)
    assert scores["rho"] == pytest.approx(sign, abs=0.01)
    assert 0 < scores["rho_depth"] < 0.5  # the noise of that sensor grows with depth
    assert np.sign(scores["error_m"] - scores["weighted_error_m"]) == sign
