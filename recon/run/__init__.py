"""Everything that reads or writes the layout of a run directory.

Imports core. Start at `directory.py` (paths and manifest) and `frames.py` (the preprocessed frames).
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .checkpoint import Checkpoint
    from .directory import RunDirectory
    from .frames import RunFrames
    from .manifest import FrameRecord, Manifest, StageRecord
    from .meshes import load_reference_mesh, load_run_mesh
    from .tracking_record import TrackedFrame, TrackingRecord

__all__ = [
    "Checkpoint",
    "FrameRecord",
    "Manifest",
    "RunDirectory",
    "RunFrames",
    "StageRecord",
    "TrackedFrame",
    "TrackingRecord",
    "load_reference_mesh",
    "load_run_mesh",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Checkpoint": ".checkpoint",
        "RunDirectory": ".directory",
        "RunFrames": ".frames",
        **dict.fromkeys(("FrameRecord", "Manifest", "StageRecord"), ".manifest"),
        **dict.fromkeys(("load_reference_mesh", "load_run_mesh"), ".meshes"),
        **dict.fromkeys(("TrackedFrame", "TrackingRecord"), ".tracking_record"),
    },
)
