"""Light as a function of the surface point alone, so that every view of a point shows the same colour.

Soft shadows and the darkening of corners are computed once on a coarse grid of free points and interpolated.
"""

from __future__ import annotations

import numpy as np
import open3d as o3d
import torch
from torch.nn.functional import grid_sample

from .scene import Light, Scene

_SPACING_M = 0.1
_MAX_NODES = 150_000
_SHADOW_RAYS = 12
_OPENNESS_RAYS = 24
_OPEN_DISTANCE_M = 1.2  # farther walls do not darken a corner
_AMBIENT = np.array([0.50, 0.50, 0.52], dtype=np.float32)
_SKY_DIRECTIONS = np.array([[0.35, 0.25, 0.90], [-0.6, 0.4, 0.3]])
_SKY_WEIGHTS = (0.30, 0.12)


class LightField:
    """Irradiance at surface points of one scene."""

    def __init__(self, scene: Scene, raycaster: o3d.t.geometry.RaycastingScene, rng: np.random.Generator) -> None:
        self._lights = scene.lights
        if not self._lights:
            return
        low, high = scene.bounds
        spacing = max(_SPACING_M, float(np.prod((high - low) / _MAX_NODES ** (1 / 3)) ** (1 / 3)))
        self._low, self._spacing = low.astype(np.float32), np.float32(spacing)
        counts = np.ceil((high - low) / spacing).astype(int) + 1
        axes = [low[i] + spacing * np.arange(counts[i]) for i in range(3)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        directions = rng.normal(size=(_OPENNESS_RAYS, 3))
        directions *= _OPEN_DISTANCE_M / np.linalg.norm(directions, axis=1, keepdims=True)
        open_share = _unoccluded(raycaster, nodes, nodes[:, None] + directions[None])
        # Half of the sphere around a point on a plain wall lies behind the wall.
        shares = [np.minimum(2 * open_share, 1)]
        shares += [_visibility(raycaster, nodes, light, rng) for light in self._lights]
        self._shares = torch.from_numpy(np.stack(shares).reshape(1, -1, *counts))  # openness, then one per light
        self._unit = (2 / (spacing * (counts - 1))).astype(np.float32)  # metres -> -1..1

    def irradiance(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(N, 3) linear RGB light on points (N, 3) with unit normals (N, 3) that point to the viewer's side."""
        if not self._lights:
            return _sky_light(normals)
        openness, *visibilities = self._interpolate(points + self._spacing * normals)
        light = _AMBIENT * (0.25 + 0.75 * openness)[:, None]
        for source, visibility in zip(self._lights, visibilities, strict=True):
            to_light = source.center.astype(np.float32) - points
            square = np.einsum("nk,nk->n", to_light, to_light)
            cosine = np.einsum("nk,nk->n", to_light, normals) / np.sqrt(square)
            # Wrapped Lambert: a large source also reaches a surface that faces a little away from its centre.
            strength = np.maximum(cosine + 0.15, 0) / 1.15 * visibility / (square + 1.0)
            light += strength[:, None] * source.color.astype(np.float32)
        return light

    def _interpolate(self, points: np.ndarray) -> np.ndarray:
        """(1 + lights, N) shares at points (N, 3), linear between the nodes of the grid."""
        where = (points - self._low) * self._unit - 1
        grid = torch.from_numpy(np.ascontiguousarray(where[:, ::-1]))[None, :, None, None]
        shares = grid_sample(self._shares, grid, padding_mode="border", align_corners=True)
        return shares[0, :, :, 0, 0].numpy()


def _sky_light(normals: np.ndarray) -> np.ndarray:
    """Even light with a slight direction, for meshes whose textures already hold light and shade."""
    value = np.full(len(normals), 0.72, dtype=np.float32)
    for direction, weight in zip(_SKY_DIRECTIONS, _SKY_WEIGHTS, strict=True):
        value += weight * np.maximum(normals @ (direction / np.linalg.norm(direction)).astype(np.float32), 0)
    return np.repeat(value[:, None], 3, axis=1)


def _visibility(
    raycaster: o3d.t.geometry.RaycastingScene, nodes: np.ndarray, light: Light, rng: np.random.Generator
) -> np.ndarray:
    spots = light.center + rng.uniform(-1, 1, (_SHADOW_RAYS, 2)) @ light.half_axes
    return _unoccluded(raycaster, nodes, np.broadcast_to(spots, (len(nodes), *spots.shape)))


def _unoccluded(raycaster: o3d.t.geometry.RaycastingScene, nodes: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """(N,) float32 share of the targets (N, T, 3) that a node (N, 3) sees."""
    starts = np.broadcast_to(nodes[:, None], targets.shape)
    rays = np.concatenate([starts, targets - starts], axis=-1).astype(np.float32)
    hidden = raycaster.test_occlusions(o3d.core.Tensor(rays), tnear=0.0, tfar=1.0).numpy()
    return 1 - hidden.mean(axis=1, dtype=np.float32)
