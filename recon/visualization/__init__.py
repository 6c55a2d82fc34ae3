"""Pictures and tables from files of a run.

Imports evaluation, volume and the rooms below them, never methods. Start at `mesh_pictures.py` (`uncle snapshot`) and
`charts.py` (the parts of all figures).
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .mesh_pictures import draw_mesh
    from .sensor_pictures import draw_sensors
    from .trajectory_charts import draw_camera_path

__all__ = [
    "draw_camera_path",
    "draw_mesh",
    "draw_sensors",
]

__getattr__ = lazy_names(
    __name__,
    {
        "draw_mesh": ".mesh_pictures",
        "draw_sensors": ".sensor_pictures",
        "draw_camera_path": ".trajectory_charts",
    },
)
