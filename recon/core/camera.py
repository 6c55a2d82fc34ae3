"""The pinhole camera: the only place where intrinsics are changed or applied.

Compiled loops take the numbers themselves and repeat the projection; nothing else does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

Array = TypeVar("Array", np.ndarray, Tensor)
MIN_DEPTH_M = 0.1  # nearer than any depth sensor measures
_TINY_M = 1e-6  # a smaller depth is at the camera or behind it


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

    def strided(self, step: int) -> Camera:
        """The camera of an image of every `step`-th pixel (`image[::step, ::step]`), which is not resampled."""
        width, height = -(-self.width // step), -(-self.height // step)
        return Camera(width, height, self.fx / step, self.fy / step, self.cx / step, self.cy / step)

    @property
    def max_focal_px(self) -> float:
        """The larger focal length: the most pixels that 1 m at a depth of 1 m can cover."""
        return max(self.fx, self.fy)

    def rays(self, device: torch.device | str = "cpu") -> Tensor:
        """(H, W, 3) float32 directions [(u - cx)/fx, (v - cy)/fy, 1]: not normalised, so a ray parameter is z-depth."""
        u = (torch.arange(self.width, device=device, dtype=torch.float32) - self.cx) / self.fx
        v = (torch.arange(self.height, device=device, dtype=torch.float32) - self.cy) / self.fy
        x, y = torch.meshgrid(u, v, indexing="xy")
        return torch.stack([x, y, torch.ones_like(x)], dim=-1)

    def unproject(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Pixels u, v (...) -> x, y (...) of the points on their rays at a depth of 1, in camera axes."""
        return (u - self.cx) / self.fx, (v - self.cy) / self.fy

    def project(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(..., 3) points in camera axes, metres -> (u, v) in pixels and z in metres, each (...).

        Points at or behind the camera give u = v = -1e6, outside any image.
        """
        x, y, z = points.unbind(-1)
        in_front = z > _TINY_M
        safe = torch.where(in_front, z, torch.ones_like(z))
        u = torch.where(in_front, self.fx * x / safe + self.cx, torch.full_like(z, -1e6))
        v = torch.where(in_front, self.fy * y / safe + self.cy, torch.full_like(z, -1e6))
        return u, v, z

    def project_array(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(..., 3) points in camera axes, metres -> (u, v) in pixels and z in metres, each (...), of the points' type.

        u and v mean nothing at or behind the camera: test z.
        """
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        safe = np.maximum(z, _TINY_M)
        return self.fx * x / safe + self.cx, self.fy * y / safe + self.cy, z

    def project_with_derivatives(self, points: np.ndarray, min_depth_m: float) -> tuple[np.ndarray, np.ndarray]:
        """(M, 3) points in camera axes, metres -> pixels (M, 2) and their derivatives by the point (M, 2, 3).

        Points nearer than `min_depth_m`, or behind the camera, are projected as if they had that depth.
        """
        x, y, z = points[:, 0], points[:, 1], np.maximum(points[:, 2], min_depth_m)
        inverse_z, zero = 1 / z, np.zeros_like(z)
        focal, centre = np.array([self.fx, self.fy]), np.array([self.cx, self.cy])
        pixels = focal * points[:, :2] * inverse_z[:, None] + centre
        d_u = np.stack([self.fx * inverse_z, zero, -self.fx * x * inverse_z**2], -1)
        d_v = np.stack([zero, self.fy * inverse_z, -self.fy * y * inverse_z**2], -1)
        return pixels, np.stack([d_u, d_v], 1)

    def contains(self, u: Array, v: Array) -> Array:
        """(...) bool: whether rounded pixels u, v (...) lie in the image."""
        return (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height)

    def to_dict(self) -> dict[str, float]:
        """The fields by name, pixels, as a manifest holds them."""
        return {key: getattr(self, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}


def project_into(
    points: np.ndarray, camera: Camera, T_world_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points that fall into the image, in front of the camera.

    (N, 3) world points -> positions (M,) into `points`, nearest pixels (M, 2) as column and row, z (M,) metres.
    """
    local = (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    front = np.flatnonzero(local[:, 2] > MIN_DEPTH_M)
    u, v, z = camera.project_array(local[front])
    u, v = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
    inside = camera.contains(u, v)
    return front[inside], np.column_stack([u[inside], v[inside]]), z[inside]
