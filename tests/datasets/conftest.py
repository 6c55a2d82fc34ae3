"""A box room with a known surface, and a colour that tells the place: every reader must find it again."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.recon.core.camera import Camera

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
LOW, HIGH = np.array([-1.0, -1.3, -0.9]), np.array([1.6, 1.2, 1.5])  # no symmetry that could hide a swapped axis


class BoxRoom:
    """Renders the inside of the box analytically and checks recordings of it."""

    @staticmethod
    def poses(count: int) -> list[np.ndarray]:
        """`count` different (4, 4) T_world_camera, OpenCV axes."""
        poses = []
        for index in range(count):
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_euler(
                "xyz", [20 + 15 * index, 35 * index - 10, 8 * index + 5], degrees=True
            ).as_matrix()
            pose[:3, 3] = [0.1 * index, -0.05 * index, 0.15]
            poses.append(pose)
        return poses

    @staticmethod
    def color_of(points: np.ndarray) -> np.ndarray:
        """(..., 3) world points -> (..., 3) RGB 0..255: red grows with x, green with y, blue with z."""
        return (points - LOW) / (HIGH - LOW) * 255

    def render(self, camera: Camera, pose: np.ndarray, rays: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) uint8 RGB and (H, W) z-depth in metres; `rays` (H, W, 3) replace the pinhole's."""
        rays = camera.rays().numpy().astype(np.float64) if rays is None else rays
        directions = rays @ pose[:3, :3].T
        directions = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
        origin = pose[:3, 3]
        depth = np.maximum((LOW - origin) / directions, (HIGH - origin) / directions).min(axis=-1)
        points = origin + directions * depth[..., None]
        return np.clip(np.round(self.color_of(points)), 0, 255).astype(np.uint8), depth

    @staticmethod
    def write_color(path: Path, color: np.ndarray) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])

    @staticmethod
    def write_depth(path: Path, depth: np.ndarray, units_per_m: float = 1000.0) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), np.round(depth * units_per_m).astype(np.uint16))

    @staticmethod
    def write_matrix(path: Path, matrix: np.ndarray) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, matrix)

    def errors(self, recording, index: int, sensor: str) -> np.ndarray:
        """(N,) metres between where a pixel is unprojected to and where its colour says that it is."""
        frame = recording[index]
        depth = frame.depths[sensor]
        points = (recording.camera.rays() * depth[..., None]).double().numpy()[depth.numpy() > 0]
        points = points @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3]
        told = LOW + frame.color.double().numpy()[depth.numpy() > 0] / 255 * (HIGH - LOW)
        return np.linalg.norm(points - told, axis=-1)

    def check(self, recording, sensor: str = "depth", tolerance_m: float = 0.012) -> None:
        """Every frame's pixels land where their colour says; a level of colour is about 1 cm of room."""
        for index in range(len(recording)):
            errors = self.errors(recording, index, sensor)
            assert errors.size > 0.9 * recording.camera.width * recording.camera.height
            assert np.median(errors) < tolerance_m
            assert np.quantile(errors, 0.98) < 4 * tolerance_m


@pytest.fixture(scope="session")
def room() -> BoxRoom:
    return BoxRoom()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The recordings for development; the test is skipped without them."""
    if not DATA.is_dir():
        pytest.skip("no recordings at ../shared/data")
    return DATA


def tum_line(timestamp: float, pose: np.ndarray) -> str:
    values = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
    return f"{timestamp:.6f} " + " ".join(f"{value:.9f}" for value in values)


@pytest.fixture(scope="session")
def pose_line():
    """(timestamp, (4, 4) pose) -> a line of TUM text."""
    return tum_line


@pytest.fixture
def write_folder(tmp_path: Path, room: BoxRoom):
    """Writes a recording in the project's own format and returns its folder."""

    def write(count: int = 3, sensors: tuple[str, ...] = ("depth",), color: str = ".png") -> Path:
        camera = Camera(64, 48, 50.0, 52.0, 30.0, 25.0)
        folder = tmp_path / "own"
        for index, pose in enumerate(room.poses(count)):
            image, depth = room.render(camera, pose)
            room.write_color(folder / "color" / f"{index:04d}{color}", image)
            for sensor in sensors:
                room.write_depth(folder / sensor / f"{index:04d}.png", depth)
        (folder / "camera.json").write_text('{"width": 64, "height": 48, "fx": 50, "fy": 52, "cx": 30, "cy": 25}')
        return folder

    return write
