"""Plot the depth of a frame beside beta, the error scale of each measurement.

    python examples/01_plot_beta.py RUN --sensor sl --frame 10 --out beta.png

RUN is a run directory with a map of the method `uncle` or `uncle-paper`.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from uncle.recon.run import RunDirectory, RunFrames


def main() -> None:
    """Read one frame of a run and draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--sensor", required=True)
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("beta.png"))
    options = parser.parse_args()

    frames = RunFrames(RunDirectory(options.run), [options.sensor])
    depth = frames.depth(options.frame, options.sensor).numpy()  # metres, 0 = no measurement
    beta = frames.beta(options.frame, options.sensor).numpy()  # metres, 0 = no measurement
    valid = depth > 0

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for axes, image, title in ((left, depth, "depth (m)"), (right, 100 * beta, "beta (cm)")):
        picture = axes.imshow(np.where(valid, image, np.nan), cmap="viridis")
        axes.set_title(f"{options.sensor}, frame {options.frame}: {title}")
        axes.set_axis_off()
        figure.colorbar(picture, ax=axes)
    figure.savefig(options.out)
    print(f"median beta of {options.sensor}: {100 * np.median(beta[valid]):.2f} cm; wrote {options.out}")


if __name__ == "__main__":
    main()
