"""Scores of a mesh against a reference surface: precision, recall, F-score (Knapitsch et al. 2017), mean distances.

The two protocols are described in docs/evaluation.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from ..core.errors import DataError
from ..core.mesh import Mesh, PointCloud
from ..core.mesh_raycaster import Surface, distance_to, sample_points, sample_surface

ScoringProtocol = Literal["standard", "paper"]
CompletenessTarget = Literal["samples", "surface"]
PointFilter = Callable[[np.ndarray], np.ndarray]  # (N, 3) points, metres -> (N,) bool


@dataclass(frozen=True)
class MeshScoringParameters:
    """Distances that decide scores of a mesh, metres.

    icp_distance_m   largest distance between corresponding points in ICP
    seen_distance_m  a reference vertex counts as seen within this distance of a seen point; those are one in each
                     1.5 cm voxel
    """

    icp_distance_m: float = 0.1
    seen_distance_m: float = 0.03


DEFAULT_PARAMETERS = MeshScoringParameters()


@dataclass(frozen=True)
class ThresholdScore:
    """precision: ratio of the predicted surface within `threshold_m` of the reference; recall: the reverse; 0..1."""

    threshold_m: float
    precision: float
    recall: float
    f_score: float


@dataclass(frozen=True)
class MeshScoringOptions:
    """What a caller can choose.

    thresholds_m     distances below which a point counts as correct
    samples          points drawn on each mesh; only with the protocol "standard"
    seed             of the samples
    icp              whether the mesh is aligned by ICP first; None: as the protocol has it
    protocol         "standard": area-uniform samples; accuracy is measured to the reference surface; no ICP.
                     "paper": vertices against a sampled cloud of the other mesh; with ICP (`paper_distances`)
    completeness_to  "samples": completeness is measured to the samples of the mesh (the usual definition);
                     "surface": to its triangles; only with the protocol "standard"
    """

    thresholds_m: tuple[float, ...] = (0.05, 0.02)
    samples: int = 250_000
    seed: int = 0
    icp: bool | None = None
    protocol: ScoringProtocol = "standard"
    completeness_to: CompletenessTarget = "samples"


DEFAULT_OPTIONS = MeshScoringOptions()


@dataclass(frozen=True)
class MeshScoringSettings:
    """How a mesh was scored.

    completeness_to   what represents the predicted mesh when distances from the reference are measured
    samples           points drawn on each mesh before culling; None where the protocol uses vertices instead
    """

    protocol: ScoringProtocol
    completeness_to: CompletenessTarget
    samples: int | None
    seed: int
    icp: bool
    culled: bool


@dataclass(frozen=True)
class MeshMetrics:
    """accuracy: distance predicted -> reference; completeness: reference -> predicted; metres, None if undefined.

    predicted_points, reference_points   numbers of scored points, after culling
    T_reference_mesh                     (4, 4) alignment by ICP; the identity without it
    """

    scores: tuple[ThresholdScore, ...]
    accuracy_mean_m: float | None
    accuracy_median_m: float | None
    completeness_mean_m: float | None
    completeness_median_m: float | None
    predicted_points: int
    reference_points: int
    T_reference_mesh: tuple[tuple[float, ...], ...]
    settings: MeshScoringSettings
    note: str | None = None


def evaluate_mesh(
    mesh: Mesh,
    reference: Mesh | PointCloud,
    options: MeshScoringOptions = DEFAULT_OPTIONS,
    *,
    visible: PointFilter | None = None,
    seen_reference: np.ndarray | None = None,
    parameters: MeshScoringParameters = DEFAULT_PARAMETERS,
) -> MeshMetrics:
    """Score `mesh` against `reference`, both in metres in the same frame.

    The points of a cloud stand for its surface: they are the samples of the reference, and distances end at the nearest
    one. The protocol "paper" needs a mesh.

    visible         keeps the predicted points that a camera could see; the others are not scored
    seen_reference  (M, 3) points of the reference that a camera saw; the others are not scored

    An empty mesh, or one without visible points, scores 0 with an explanation in `note`. Raises DataError if no point
    of the reference is left, a vertex is not finite, or the protocol needs a mesh; ValueError for thresholds or samples
    that are not positive.
    """
    _check_options(options)
    if options.protocol == "paper" and isinstance(reference, PointCloud):
        raise DataError("the protocol `paper` needs a ground truth with triangles, not a point cloud; use `standard`")
    with_icp = options.protocol == "paper" if options.icp is None else options.icp
    T = align_by_icp(mesh, reference, parameters.icp_distance_m) if with_icp and len(mesh.faces) else np.eye(4)
    aligned = transformed(mesh, T) if with_icp else mesh
    if options.protocol == "paper" and isinstance(reference, Mesh):
        accuracy, completeness = paper_distances(aligned, reference, options.seed, visible, seen_reference, parameters)
        settings = MeshScoringSettings("paper", "samples", None, options.seed, with_icp, visible is not None)
    else:
        accuracy, completeness = standard_distances(
            aligned, reference, options.samples, options.seed, options.completeness_to, visible, seen_reference
        )
        settings = MeshScoringSettings(
            "standard", options.completeness_to, options.samples, options.seed, with_icp, visible is not None
        )
    if len(completeness) == 0:
        raise DataError("no part of the reference mesh can be scored: it has no area, or the cameras saw none of it")
    return MeshMetrics(
        tuple(score_at(threshold, accuracy, completeness) for threshold in options.thresholds_m),
        *_mean_and_median(accuracy),
        *_mean_and_median(completeness),
        len(accuracy),
        len(completeness),
        tuple(tuple(float(x) for x in row) for row in T),
        settings,
        None if len(accuracy) else "the mesh has no surface that can be scored; all its scores are 0",
    )


def standard_distances(
    mesh: Mesh,
    reference: Mesh | PointCloud,
    samples: int,
    seed: int,
    completeness_to: CompletenessTarget = "samples",
    visible: PointFilter | None = None,
    seen_reference: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Distances in metres of area-uniform samples: (N,) mesh -> reference surface, (M,) reference -> mesh."""
    predicted = _keep(sample_surface(mesh, samples, np.random.default_rng([seed, 0])), visible)
    if seen_reference is None:
        seen_reference = sample_points(reference, samples, np.random.default_rng([seed, 1]))
    if completeness_to == "surface":
        completeness = Surface(mesh).distance(seen_reference)
    else:
        completeness = nearest_distance(seen_reference, predicted)
    return distance_to(reference)(predicted), completeness


def paper_distances(
    mesh: Mesh,
    reference: Mesh,
    seed: int,
    visible: PointFilter | None = None,
    seen_reference: np.ndarray | None = None,
    parameters: MeshScoringParameters = DEFAULT_PARAMETERS,
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) mesh -> reference and (M,) back, metres, as in the script of the published figures.

    Sources are the vertices of both meshes. The targets are clouds: the mesh with fewer vertices is sampled with as
    many points as the other has vertices; of the other the vertices are used (docs/evaluation.md).
    """
    rng = np.random.default_rng(seed)
    predicted, true = mesh.vertices.astype(np.float64), reference.vertices.astype(np.float64)
    if len(true) < len(predicted):
        predicted_cloud, true_cloud = predicted, sample_surface(reference, len(predicted), rng)
    else:
        predicted_cloud, true_cloud = sample_surface(mesh, len(true), rng), true
    if seen_reference is not None:
        true = true[near_to(seen_reference, parameters.seen_distance_m)(true)]
    return nearest_distance(_keep(predicted, visible), true_cloud), nearest_distance(true, predicted_cloud)


def score_at(threshold_m: float, accuracy: np.ndarray, completeness: np.ndarray) -> ThresholdScore:
    """Precision of distances (N,), recall of distances (M,), metres, and their harmonic mean; 0 without points."""
    precision = float((accuracy < threshold_m).mean()) if len(accuracy) else 0.0
    recall = float((completeness < threshold_m).mean()) if len(completeness) else 0.0
    total = precision + recall
    return ThresholdScore(float(threshold_m), precision, recall, 2 * precision * recall / total if total > 0 else 0.0)


def align_by_icp(
    mesh: Mesh, reference: Mesh | PointCloud, distance_m: float = DEFAULT_PARAMETERS.icp_distance_m
) -> np.ndarray:
    """(4, 4) T_reference_mesh by point-to-point ICP on the vertices, starting from the identity."""
    import open3d as o3d

    target = reference.vertices if isinstance(reference, Mesh) else reference.points
    clouds = [
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
        for points in (mesh.vertices, target)
    ]
    registration = o3d.pipelines.registration
    estimation = registration.TransformationEstimationPointToPoint()
    result = registration.registration_icp(clouds[0], clouds[1], distance_m, np.eye(4), estimation)
    return np.asarray(result.transformation)


def transformed(mesh: Mesh, T_target_mesh: np.ndarray) -> Mesh:
    """`mesh` with the rigid (4, 4) `T_target_mesh` applied to its vertices."""
    vertices = mesh.vertices @ T_target_mesh[:3, :3].T + T_target_mesh[:3, 3]
    return replace(mesh, vertices=vertices.astype(np.float32))


def color_by_distance(mesh: Mesh, reference: Mesh | PointCloud, limit_m: float, colormap: str = "turbo") -> Mesh:
    """`mesh` with its vertices coloured by their distance to the reference; the colour scale ends at `limit_m`."""
    import matplotlib

    distance = distance_to(reference)(mesh.vertices)
    ratio = np.clip(distance / limit_m, 0.0, 1.0)
    return replace(mesh, colors=np.round(matplotlib.colormaps[colormap](ratio)[:, :3] * 255).astype(np.uint8))


def nearest_distance(points: np.ndarray, cloud: np.ndarray) -> np.ndarray:
    """(N, 3) points -> (N,) distance to the nearest of the (M, 3) `cloud`, metres; inf if the cloud is empty."""
    return np.asarray(cKDTree(cloud).query(points)[0]) if len(cloud) else np.full(len(points), np.inf)


def near_to(cloud: np.ndarray, distance_m: float = DEFAULT_PARAMETERS.seen_distance_m) -> PointFilter:
    """The filter that keeps points within `distance_m` of the (M, 3) `cloud`."""
    tree = cKDTree(cloud)
    return lambda points: np.isfinite(tree.query(points, distance_upper_bound=distance_m)[0])


def _keep(points: np.ndarray, keep: PointFilter | None) -> np.ndarray:
    return points if keep is None or len(points) == 0 else points[keep(points)]


def _mean_and_median(distance: np.ndarray) -> tuple[float | None, float | None]:
    if len(distance) == 0 or not np.isfinite(distance).all():
        return None, None
    return float(distance.mean(dtype=np.float64)), float(np.median(distance))


def _check_options(options: MeshScoringOptions) -> None:
    if not options.thresholds_m or min(options.thresholds_m) <= 0:
        raise ValueError("thresholds_m must be positive and not empty")
    if options.samples < 1:
        raise ValueError("samples must be at least 1")
