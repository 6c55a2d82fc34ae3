"""Whether the parts of a recording fit one another: units, intrinsics, poses, clocks, registration, images.

Imports `recon.core`. Works on anything with colour, depth and poses by index: a recording, or the frames of a run.
"""

from typing import TYPE_CHECKING

from ...core.lazy import lazy_names

if TYPE_CHECKING:
    from .findings import Finding, Verdict
    from .inspector import Inspection, inspect_recording

__all__ = ["Finding", "Inspection", "Verdict", "inspect_recording"]

__getattr__ = lazy_names(
    __name__,
    {
        **dict.fromkeys(("Finding", "Verdict"), ".findings"),
        **dict.fromkeys(("Inspection", "inspect_recording"), ".inspector"),
    },
)
