"""What confidence networks know of the true error: rank correlation, weighted error, against depth alone.

python benchmarks/confidence.py RUN --sensors sl sgm psmnet [--files a.pt b.pt] [--every 10]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr
from uncle.recon.methods.confidence.models import ConfidenceModels
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames

PIXELS = 4000  # drawn from each image


def score(frames: RunFrames, sensor: str, models: ConfidenceModels, every: int) -> dict[str, float]:
    """Over random valid pixels of every n-th frame: Spearman's rho of 1 - confidence (0 where that is the same
    everywhere) and of depth alone with the true error; mean error with equal weights, and weighted by confidence,
    metres; mean confidence."""
    rng = np.random.default_rng(0)
    errors, confidences, depths = [], [], []
    for index in range(0, len(frames), every):
        depth, truth = frames.depth(index, sensor), frames.depth(index, "gt")
        image = models.image(sensor, depth)
        valid = np.flatnonzero(((depth > 0) & (truth > 0)).numpy().ravel())
        picks = rng.choice(valid, min(PIXELS, len(valid)), replace=False)
        errors.append((depth - truth).abs().numpy().ravel()[picks])
        confidences.append(image.numpy().ravel()[picks])
        depths.append(depth.numpy().ravel()[picks])
    error, confidence, depth = map(np.concatenate, (errors, confidences, depths))
    return {
        "rho": 0.0 if np.ptp(confidence) == 0 else float(spearmanr(1 - confidence, error)[0]),
        "rho_depth": float(spearmanr(depth, error)[0]),
        "error_m": float(error.mean()),
        "weighted_error_m": float((error * confidence).sum() / confidence.sum()),
        "confidence": float(confidence.mean()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--sensors", nargs="+", required=True)
    parser.add_argument("--files", nargs="*", default=[], type=Path)
    parser.add_argument("--every", type=int, default=10)
    given = parser.parse_args()
    models = ConfidenceModels.load(given.sensors, given.files)
    frames = RunFrames(RunDirectory(given.run))
    scores = {sensor: score(frames, sensor, models, given.every) for sensor in given.sensors}
    print(json.dumps(scores, indent=2))


if __name__ == "__main__":
    main()
