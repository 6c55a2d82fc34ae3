"""Read recordings of a format of your own: one file `recording.npz` with all frames.

    python examples/03_own_reader.py FOLDER --run RUN

FOLDER/recording.npz holds color (N, H, W, 3) uint8, depth (N, H, W) metres, T_world_camera (N, 4, 4) with OpenCV
camera axes, and matrix (3, 3), the intrinsics. `examples/plugin` has a reader that `uncle preprocess` finds by itself.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from uncle.datasets import ReaderSpec, open_dataset, register_reader
from uncle.recon.core.camera import Camera
from uncle.recon.core.frame import Frame
from uncle.recon.run import RunDirectory
from uncle.recon.stages import preprocess_run


class StackedRecording:
    """Implements `uncle.recon.core.frame.Recording`."""

    format, sensors = "stacked", ("depth",)
    has_poses, has_timestamps, reference_mesh = True, False, None
    registration_sigma_px, notes = 0.0, ()

    def __init__(self, path: Path) -> None:
        arrays = np.load(path / "recording.npz")
        self.name = path.resolve().name
        self.colors, self.depths, self.poses = arrays["color"], arrays["depth"], arrays["T_world_camera"]
        matrix, (_, height, width) = arrays["matrix"], self.depths.shape
        self.camera = Camera(width, height, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])

    def __len__(self) -> int:
        return len(self.depths)

    def __getitem__(self, index: int) -> Frame:
        depths = {"depth": self.depth(index, "depth")}
        return Frame(index, self.timestamp(index), self.color(index), depths, self.pose(index))

    def timestamp(self, index: int) -> float:
        """Seconds; the index without a clock."""
        return float(index)

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera, or None."""
        return self.poses[index]

    def color(self, index: int) -> torch.Tensor:
        """(H, W, 3) uint8 RGB."""
        return torch.from_numpy(self.colors[index])

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        """(H, W) float32 metres, 0 = no measurement."""
        return torch.from_numpy(self.depths[index].astype(np.float32))


class StackedReader:
    """Recognises and opens such folders; a module with these two functions is a reader, too."""

    def matches(self, path: Path) -> bool:
        """Whether the folder is of this format; decided by names alone."""
        return (path / "recording.npz").is_file()

    def read(self, path: Path) -> StackedRecording:
        """Open the folder."""
        return StackedRecording(path)


def main() -> None:
    """Register the reader and convert a recording into a run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--run", type=Path, default=Path("run"))
    options = parser.parse_args()

    register_reader(ReaderSpec("stacked", "recording.npz", "all frames in one file", StackedReader()))
    recording = open_dataset(options.dataset)
    summary = preprocess_run(recording, RunDirectory(options.run), dataset=options.dataset)
    print(f"{summary.frames} frames of the format {recording.format} in {options.run}")


if __name__ == "__main__":
    main()
