"""One folder per `--method`.

Imports tracking, mvs and the rooms below them. Start at `uncle/pipeline.py`, the default method; `registry.py` lists
all methods and `spec.py` says what one consists of.
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .base import MapJob, MapResult
    from .registry import method_spec, method_specs, register_method, unregister_method
    from .spec import MethodSpec

__all__ = [
    "MapJob",
    "MapResult",
    "MethodSpec",
    "method_spec",
    "method_specs",
    "register_method",
    "unregister_method",
]

__getattr__ = lazy_names(
    __name__,
    {
        **dict.fromkeys(("MapJob", "MapResult"), ".base"),
        **dict.fromkeys(("method_spec", "method_specs", "register_method", "unregister_method"), ".registry"),
        "MethodSpec": ".spec",
    },
)
