"""A frame against the surface and the colour of the map: residuals of the tracking loss of the paper.

Every reading, moved by the pose, should lie on the zero level of the fused distances (which is point-to-plane with the
gradient as the plane's normal) and show the colour that the map has there. Each residual is divided by what is
expected of it: the learned beta of the reading and the sigma of the map (paper: |D - D'| / (S + beta)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ..volume.tsdf_query import query_numba, query_torch
from ..volume.tsdf_volume import TsdfVolume
from .pose_estimation import Linearised, Term

SHARE = 0.05  # how much of its information a residual counts: neighbours share most of their error
COLOR_SIGMA = 0.08  # of 0..1: what colours of the map and of a frame differ by
LEAST_SCALE, MIN_FOR_SCALE = 0.05, 100
ROBUST_SCALE = 2.0  # sigmas


@dataclass(frozen=True)
class Readings:
    """Depth readings of a frame: points (N, 3) in camera axes, metres; directions (N, 3) with z = 1; beta (N,) metres;
    grey (N,) 0..1, or None if colour is not used; `scale` of all sigmas, see `scaled`."""

    points: Tensor
    directions: Tensor
    beta: Tensor
    grey: Tensor | None
    scale: float = 1.0

    def __len__(self) -> int:
        return len(self.points)

    def to(self, device: torch.device) -> Readings:
        """The readings where the map is."""
        grey = None if self.grey is None else self.grey.to(device)
        return Readings(self.points.to(device), self.directions.to(device), self.beta.to(device), grey, self.scale)


def surface_term(volume: TsdfVolume, readings: Readings, share: float = SHARE, scale: float = ROBUST_SCALE) -> Term:
    """The term of `readings` in the sum that `minimise` takes."""

    def linearise(pose: np.ndarray) -> Linearised:
        r, jacobian = surface_residuals(volume, readings, pose)
        ratio = (r / scale) ** 2
        cost = share * scale**2 * float(torch.log1p(ratio).sum())
        # A reading off the map costs as much as one far from the surface: leaving the map must not pay.
        channels = 1 if readings.grey is None else 2
        cost += share * scale**2 * 3.0 * (channels * len(readings) - len(r))
        weighted = jacobian * (share / (1 + ratio))[:, None]
        information, gradient = weighted.T @ jacobian, weighted.T @ r
        return Linearised(cost, information.double().cpu().numpy(), gradient.double().cpu().numpy())

    return linearise


def surface_residuals(volume: TsdfVolume, readings: Readings, pose: np.ndarray) -> tuple[Tensor, Tensor]:
    """Whitened residuals (K,) of distance, then of colour, where the map is known, and their derivatives (K, 6)."""
    T = torch.tensor(pose, dtype=torch.float32, device=readings.points.device)
    query = query_numba if T.device.type == "cpu" else query_torch
    seen = query(volume, readings.points, T)
    points = readings.points[seen.kept]
    along = (seen.gradient * (readings.directions[seen.kept] @ T[:3, :3].T)).sum(-1)
    sigma = readings.scale * (2 * (readings.beta[seen.kept] * along) ** 2 + seen.sigma**2).sqrt()
    residuals, slopes_world = [seen.sdf / sigma], [seen.gradient / sigma[:, None]]
    if readings.grey is not None:
        off = seen.grey - readings.grey[seen.kept]
        residuals.append((off - off.median() if len(off) else off) / COLOR_SIGMA)  # exposure changes
        slopes_world.append(seen.grey_gradient / COLOR_SIGMA)
        points = torch.cat([points, points])
    d_camera = torch.cat(slopes_world) @ T[:3, :3]
    return torch.cat(residuals), torch.cat([d_camera, torch.linalg.cross(points, d_camera)], 1)


def scaled(volume: TsdfVolume, readings: Readings, pose: np.ndarray) -> Readings:
    """The readings with sigmas as small as the distances at `pose` show them to be.

    A noise model that is still learning promises too little; which reading is better than which it knows earlier than
    how good they all are.
    """
    r, _ = surface_residuals(volume, replace(readings, grey=None), pose)
    if len(r) < MIN_FOR_SCALE:
        return readings
    return replace(readings, scale=readings.scale * min(1.0, max(LEAST_SCALE, 1.48 * float(r.abs().median()))))


def agreement(volume: TsdfVolume, readings: Readings, pose: np.ndarray) -> tuple[float, float]:
    """Share of the readings that lie where the map is known, and the share of those within 3 sigma of the surface."""
    if len(readings) == 0:
        return 0.0, 0.0
    r, _ = surface_residuals(volume, replace(readings, grey=None), pose)
    return len(r) / len(readings), float((r.abs() < 3).float().mean()) if len(r) else 0.0


def distances(volume: TsdfVolume, readings: Readings, pose: np.ndarray) -> tuple[Tensor, Tensor]:
    """How far readings lie from the surface, (K,) metres, where the map is known, and which (K,) they are."""
    T = torch.tensor(pose, dtype=torch.float32, device=readings.points.device)
    seen = query_torch(volume, readings.points, T)
    return seen.sdf.abs(), seen.kept
