"""Everything that reads or writes the layout of a run directory. May import core."""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .directory import RunDirectory
    from .frames import RunFrames
    from .manifest import Manifest

__all__ = ["Manifest", "RunDirectory", "RunFrames"]

__getattr__ = lazy_names(
    __name__, {"Manifest": ".manifest", "RunDirectory": ".directory", "RunFrames": ".frames"}
)  # fmt: skip
