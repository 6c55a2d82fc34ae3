"""The map: truncated signed distances on a sparse voxel grid, and the field made of them.

Imports core. Start at `tsdf_volume.py` (fusion; the inner loop is in `integration.py`), then `neural_field.py` and
`mesh_extraction.py`.
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .mesh_extraction import make_mesh
    from .neural_field import NeuralField
    from .sparse_grid import SparseGrid
    from .tsdf_surface import TsdfSurface
    from .tsdf_volume import TsdfVolume

__all__ = [
    "NeuralField",
    "SparseGrid",
    "TsdfSurface",
    "TsdfVolume",
    "make_mesh",
]

__getattr__ = lazy_names(
    __name__,
    {
        "make_mesh": ".mesh_extraction",
        "NeuralField": ".neural_field",
        "SparseGrid": ".sparse_grid",
        "TsdfSurface": ".tsdf_surface",
        "TsdfVolume": ".tsdf_volume",
    },
)
