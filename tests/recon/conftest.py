"""A painted room in memory, for tests of photometric depth alone and as a part of a reconstruction."""

import numpy as np
import pytest
import torch
from uncle.recon.core.frame import Frame
from uncle.recon.run.frames import RunFrames


class PaintedFrames(RunFrames):
    """The painted room in memory; its one sensor measures `scale` times the true depth. `paint`: of the images."""

    registration_sigma_px = 0.0

    def __init__(self, room, poses, scale: float = 1.0, grain: float = 0.0, **paint) -> None:
        self.room, self.poses, self.scale, self.camera, self.sensors = room, poses, scale, room.camera, ("stereo",)
        rng = np.random.default_rng(0)
        pictures = [room.picture(pose, **paint) + rng.normal(0, grain, (*self._size, 1)) for pose in poses]
        self.colors = [torch.from_numpy(np.rint(p).clip(0, 255).astype(np.uint8)) for p in pictures]

    @property
    def _size(self) -> tuple[int, int]:
        return self.camera.height, self.camera.width

    def color(self, index):
        return self.colors[index]

    def normals(self, index, sensor):
        return torch.from_numpy(self.room.normals(self.poses[index]))

    def __getitem__(self, index):
        depth = torch.from_numpy(self.room.depth(self.poses[index]) * self.scale).float()
        return Frame(index, index, self.colors[index], {"stereo": depth}, self.poses[index])


@pytest.fixture(scope="session")
def painted_frames() -> type[PaintedFrames]:
    """The class: `painted_frames(room, poses)`."""
    return PaintedFrames


@pytest.fixture(scope="session")
def walk(box_room) -> list[np.ndarray]:
    """Before two walls and the corner between them."""
    return [
        box_room.pose(angle, (1.6 + 0.3 * np.sin(i), 0.9 + 0.3 * i, 1.0 + 0.15 * (i % 3)))
        for i in range(5)
        for angle in (0.0, 0.35)
    ]
