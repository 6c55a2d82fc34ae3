"""Everything that reads or writes the layout of a run directory.

Imports core. Start at `directory.py` (paths and manifest), `frames.py` (the preprocessed frames) and
`lock.py` (who may write).
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .checkpoint import Checkpoint
    from .directory import RunDirectory
    from .frames import RunFrames
    from .lock import reading, writing, writing_to
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
    "reading",
    "writing",
    "writing_to",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Checkpoint": ".checkpoint",
        "RunDirectory": ".directory",
        "RunFrames": ".frames",
        **dict.fromkeys(("reading", "writing", "writing_to"), ".lock"),
        **dict.fromkeys(("FrameRecord", "Manifest", "StageRecord"), ".manifest"),
        **dict.fromkeys(("load_reference_mesh", "load_run_mesh"), ".meshes"),
        **dict.fromkeys(("TrackedFrame", "TrackingRecord"), ".tracking_record"),
    },
)
