"""Signs that a mesh and its ground truth are not in one frame, or not in one unit of length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.mesh import Mesh, PointCloud


@dataclass(frozen=True)
class PlacementParameters:
    """What counts as a doubt.

    units        how often a unit of length fits into a metre
    tolerance    factor by which a ratio of extents may differ from such a number; surfaces are seldom equally complete
    max_gap_m    distance of the bounding boxes from which they are taken to be in different frames
    """

    units: tuple[tuple[float, str], ...] = ((1000.0, "millimetres"), (100.0, "centimetres"), (39.37, "inches"))
    tolerance: float = 1.25
    max_gap_m: float = 0.1


DEFAULT_PARAMETERS = PlacementParameters()


def placement_doubts(
    mesh: Mesh, reference: Mesh | PointCloud, parameters: PlacementParameters = DEFAULT_PARAMETERS
) -> tuple[str, ...]:
    """One line for each reason to doubt that both are in metres in one frame; none for an empty mesh."""
    if len(mesh.faces) == 0:
        return ()
    boxes = [_bounding_box(surface) for surface in (mesh, reference)]
    diagonals = [float(np.linalg.norm(high - low)) for low, high in boxes]
    names = ("mesh", "ground truth")
    for large in (0, 1):
        ratio = diagonals[large] / max(diagonals[1 - large], 1e-12)
        for factor, unit in parameters.units:
            if factor / parameters.tolerance < ratio < factor * parameters.tolerance:
                lengths = f"{diagonals[large]:.4g} m and {diagonals[1 - large]:.4g} m"
                doubt = (
                    f"the extent of the {names[large]} is {_rounded(ratio)} times that of the {names[1 - large]} "
                    f"({lengths}): it seems to be in {unit}; divide its coordinates by {factor:g}"
                )
                return (doubt,)
    (low, high), (other_low, other_high) = boxes
    gap = float(np.linalg.norm(np.maximum(0.0, np.maximum(low - other_high, other_low - high))))
    if gap > parameters.max_gap_m:
        return (f"mesh and ground truth lie {gap:.4g} m apart: they are in different frames; align one to the other",)
    return ()


def _rounded(ratio: float) -> str:
    """Three digits: 1000, 98.4."""
    return f"{float(f'{ratio:.3g}'):g}"


def _bounding_box(surface: Mesh | PointCloud) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(surface, Mesh) and len(surface.faces):
        points = surface.vertices[np.unique(surface.faces)]
    else:
        points = surface.vertices if isinstance(surface, Mesh) else surface.points
    points = points.astype(np.float64)
    return points.min(axis=0), points.max(axis=0)
