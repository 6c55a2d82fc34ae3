"""Bundle adjustment of cameras and landmarks from pixels and depth readings of any number of sensors.

Minimises, over poses T_world_camera and points X, the robust sum of
  |uv - projection(X)|^2 / sigma_px^2    and, for each sensor,    (1/z - 1/depth)^2 / sigma_inverse^2,
with sigma_inverse from the learned uncertainty of the reading, and of motions measured between pairs of frames. What a
sensor reads of a point in several frames counts as one reading: its errors there are much the same.
Gauss-Newton with Levenberg-Marquardt damping, the points eliminated by the Schur complement (Triggs et al. 2000).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from ..core.camera import Camera
from ..core.se3 import apply_motion
from .observations import Observations, depth_information_factor, residuals, robust_weights, sum_by
from .pose_graph_edges import PoseEdges, linearise_edges


@dataclass(frozen=True)
class Adjusted:
    """poses (C, 4, 4), points (P, 3), cost at the end."""

    poses: np.ndarray
    points: np.ndarray
    cost: float


@dataclass(frozen=True)
class _Linearised:
    cost: float
    U: np.ndarray  # (C, 6, 6)
    g_camera: np.ndarray  # (C, 6)
    V: np.ndarray  # (P, 3, 3)
    g_point: np.ndarray  # (P, 3)
    W: np.ndarray  # (M, 6, 3)
    across: np.ndarray | None  # (E, 6, 6)


def adjust(
    camera: Camera,
    poses: np.ndarray,
    points: np.ndarray,
    observations: Observations,
    free_poses: np.ndarray,
    *,
    free_points: bool = True,
    iterations: int = 10,
    edges: PoseEdges | None = None,
) -> Adjusted:
    """Improve poses (C, 4, 4) where `free_poses` (C,) and, if `free_points`, points (P, 3). The cost never grows.

    Where points are held, each camera is placed by itself, and what it reads is its own.
    """
    damping, share = 1e-4, depth_information_factor(observations) if free_points else 1.0
    now = _linearise(camera, poses, points, observations, share, edges)
    for _ in range(iterations):
        step_poses, step_points = _solve(now, observations, edges, free_poses, free_points, damping)
        new_poses, new_points = apply_motion(poses, step_poses), points + step_points
        then = _linearise(camera, new_poses, new_points, observations, share, edges)
        if not then.cost < now.cost:  # also where it is not a number
            damping *= 10
            if damping > 1e3:
                break
            continue
        gain = now.cost - then.cost
        poses, points, now = new_poses, new_points, then
        damping = max(damping / 5, 1e-7)
        if gain < 1e-5 * now.cost:
            break
    return Adjusted(poses, points, now.cost)


def covariances(
    camera: Camera,
    poses: np.ndarray,
    points: np.ndarray,
    observations: Observations,
    free_poses: np.ndarray,
    edges: PoseEdges | None = None,
) -> np.ndarray:
    """Covariance (C, 6, 6) of each pose with all points and the other poses unknown; 0 for poses that are not free.

    Where the pixels' whitened residuals spread by more than they should, the result grows as much. It does not shrink
    where they spread by less: how well pixels agree says nothing of errors that the readings share.
    """
    system = _linearise(camera, poses, points, observations, depth_information_factor(observations), edges)
    free = np.flatnonzero(free_poses)
    damping = 1e-9
    S, _ = _reduced_system(
        system, observations, edges, free, _damped(system.U[free], damping), np.linalg.inv(_damped(system.V, damping))
    )
    r, _, _ = residuals(camera, poses[observations.camera], points[observations.point], observations)
    spread = max(1.48 * np.median(np.abs(r[:, :2])), 1.0) if len(r) else 1.0
    blocks = np.linalg.pinv(S, hermitian=True).reshape(len(free), 6, len(free), 6)
    result = np.zeros((len(poses), 6, 6))
    result[free] = blocks[np.arange(len(free)), :, np.arange(len(free))] * spread**2
    return result


def _linearise(
    camera: Camera,
    poses: np.ndarray,
    points: np.ndarray,
    observations: Observations,
    share_depth: np.ndarray | float,
    edges: PoseEdges | None,
) -> _Linearised:
    """The normal equations at poses and points."""
    r, d_motion, d_point = residuals(camera, poses[observations.camera], points[observations.point], observations)
    weights, cost = robust_weights(r, observations.share_px, share_depth)
    weighted_motion, weighted_point = d_motion * weights[..., None], d_point * weights[..., None]
    transposed = np.swapaxes(weighted_motion, 1, 2)
    U = sum_by(observations.camera, transposed @ d_motion, len(poses))
    g_camera = sum_by(observations.camera, (transposed @ r[..., None])[..., 0], len(poses))
    transposed_point = np.swapaxes(weighted_point, 1, 2)
    V = sum_by(observations.point, transposed_point @ d_point, len(points))
    g_point = sum_by(observations.point, (transposed_point @ r[..., None])[..., 0], len(points))
    across = None
    if edges is not None:
        measured = linearise_edges(poses, edges)
        cost, U, g_camera, across = cost + measured.cost, U + measured.U, g_camera + measured.g, measured.across
    return _Linearised(cost, U, g_camera, V, g_point, transposed @ d_point, across)


def _solve(
    system: _Linearised,
    observations: Observations,
    edges: PoseEdges | None,
    free_poses: np.ndarray,
    free_points: bool,
    damping: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Steps (C, 6) and (P, 3) of the damped normal equations."""
    step_poses, step_points = np.zeros_like(system.g_camera), np.zeros_like(system.g_point)
    free = np.flatnonzero(free_poses)
    U = _damped(system.U[free], damping)
    if not free_points:
        step_poses[free] = -np.linalg.solve(U, system.g_camera[free][..., None])[..., 0]
        return step_poses, step_points
    V_inverse = np.linalg.inv(_damped(system.V, damping))
    if len(free):
        step_poses[free] = _reduced_step(system, observations, edges, free, U, V_inverse)
    back = (np.swapaxes(system.W, 1, 2) @ step_poses[observations.camera][..., None])[..., 0]
    right = system.g_point + sum_by(observations.point, back, len(system.V))
    step_points = -(V_inverse @ right[..., None])[..., 0]
    return step_poses, step_points


def _reduced_step(
    system: _Linearised,
    observations: Observations,
    edges: PoseEdges | None,
    free: np.ndarray,
    U: np.ndarray,
    V_inverse: np.ndarray,
) -> np.ndarray:
    """Steps (F, 6) of the free cameras."""
    S, right = _reduced_system(system, observations, edges, free, U, V_inverse)
    try:
        step: np.ndarray = -cho_solve(cho_factor(S, lower=True), right).reshape(-1, 6)
    except np.linalg.LinAlgError:  # rounding made it indefinite: more damping helps
        return np.zeros((len(free), 6))
    return step


def _reduced_system(
    system: _Linearised,
    observations: Observations,
    edges: PoseEdges | None,
    free: np.ndarray,
    U: np.ndarray,
    V_inverse: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations (6 F, 6 F) and (6 F,) of the free cameras with the points eliminated."""
    position = np.full(len(system.U), -1)
    position[free] = np.arange(len(free))
    used = position[observations.camera] >= 0
    rows, columns = position[observations.camera[used]], observations.point[used]
    W = _block_sparse(rows, columns, system.W[used], len(free), len(system.V))
    Y = _block_sparse(rows, columns, system.W[used] @ V_inverse[columns], len(free), len(system.V))
    S = -(Y @ W.T).toarray()
    for i in range(len(free)):
        S[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += U[i]
    if edges is not None and system.across is not None:
        for i, j, block in zip(position[edges.first], position[edges.second], system.across, strict=True):
            if i >= 0 and j >= 0:
                S[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] += block
                S[6 * j : 6 * j + 6, 6 * i : 6 * i + 6] += block.T
    return S, system.g_camera[free].ravel() - Y @ system.g_point.ravel()


def _damped(blocks: np.ndarray, damping: float) -> np.ndarray:
    result = blocks.copy()
    diagonal = np.einsum("...ii->...i", result)
    diagonal += damping * diagonal + 1e-9
    return result


def _block_sparse(
    rows: np.ndarray, columns: np.ndarray, blocks: np.ndarray, n_rows: int, n_columns: int
) -> sparse.bsr_matrix:
    """Sparse matrix of blocks (M, a, b) at block `rows` and `columns` (M,)."""
    order = np.lexsort((columns, rows))
    pointer = np.searchsorted(rows[order], np.arange(n_rows + 1))
    shape = (n_rows * blocks.shape[1], n_columns * blocks.shape[2])
    return sparse.bsr_matrix((blocks[order], columns[order], pointer), shape=shape)
