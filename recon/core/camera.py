"""The pinhole camera: the only place where intrinsics change or are applied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Camera:
    """Pinhole camera, OpenCV axes (x right, y down, z forward); pixel centres lie at integer coordinates.

    `width`, `height` in pixels; `fx`, `fy`, `cx`, `cy` in pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) float64 intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Camera:
        """The camera of an image resampled to `width` x `height` (pixel centres at integers, hence the halves)."""
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fx * sx, self.fy * sy, (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5)

    def cropped(self, margin: int) -> Camera:
        """The camera of an image that lost `margin` pixels on each side."""
        return Camera(
            self.width - 2 * margin, self.height - 2 * margin, self.fx, self.fy, self.cx - margin, self.cy - margin
        )

    def rays(self, device: torch.device | str = "cpu") -> Tensor:
        """(H, W, 3) float32 directions [(u - cx)/fx, (v - cy)/fy, 1]: not normalised, so a ray parameter is z-depth."""
        u = (torch.arange(self.width, device=device, dtype=torch.float32) - self.cx) / self.fx
        v = (torch.arange(self.height, device=device, dtype=torch.float32) - self.cy) / self.fy
        x, y = torch.meshgrid(u, v, indexing="xy")
        return torch.stack([x, y, torch.ones_like(x)], dim=-1)

    def project(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(..., 3) points in camera axes, metres -> (u, v) in pixels and z in metres, each (...).

        Points at or behind the camera give u = v = -1e6, outside any image.
        """
        x, y, z = points.unbind(-1)
        in_front = z > 1e-6
        safe = torch.where(in_front, z, torch.ones_like(z))
        u = torch.where(in_front, self.fx * x / safe + self.cx, torch.full_like(z, -1e6))
        v = torch.where(in_front, self.fy * y / safe + self.cy, torch.full_like(z, -1e6))
        return u, v, z

    def to_dict(self) -> dict[str, float]:
        return {key: getattr(self, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}


MIN_DEPTH_M = 0.1  # nearer than any depth sensor measures


def project_into(
    points: np.ndarray, camera: Camera, T_world_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points that fall into the image, in front of the camera.

    (N, 3) world points -> positions (M,) into `points`, nearest pixels (M, 2) as column and row, z (M,) metres.
    """
    local = (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    front = np.flatnonzero(local[:, 2] > MIN_DEPTH_M)
    x, y, z = local[front].T
    u = np.rint(camera.fx * x / z + camera.cx).astype(np.int64)
    v = np.rint(camera.fy * y / z + camera.cy).astype(np.int64)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    return front[inside], np.column_stack([u[inside], v[inside]]), z[inside]
