"""The commands of `uncle` as functions: check, run, record in the manifest. One module per command.

Imports every room. `uncle X` is `cli/X.py` (options), `recon/stages/X.py` (files), and one room that does the work.
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .map import load_field, map_run
    from .mesh import mesh_run
    from .preprocess import preprocess
    from .report import write_report
    from .snapshot import snapshot_file, snapshot_run
    from .uncertainty import uncertainty_run

__all__ = [
    "load_field",
    "map_run",
    "mesh_run",
    "preprocess",
    "snapshot_file",
    "snapshot_run",
    "uncertainty_run",
    "write_report",
]

__getattr__ = lazy_names(
    __name__,
    {
        **dict.fromkeys(("load_field", "map_run"), ".map"),
        "mesh_run": ".mesh",
        "preprocess": ".preprocess",
        "write_report": ".report",
        **dict.fromkeys(("snapshot_file", "snapshot_run"), ".snapshot"),
        "uncertainty_run": ".uncertainty",
    },
)
