"""One folder per `--method`. Start at uncle/pipeline.py; registry.py lists them. May import tracking, mvs and below."""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .base import MapJob, MapResult
    from .registry import method_spec, method_specs, register_method, unregister_method
    from .spec import MethodSpec

__all__ = [
    "MapJob", "MapResult", "MethodSpec", "method_spec", "method_specs", "register_method", "unregister_method",
]  # fmt: skip

__getattr__ = lazy_names(
    __name__,
    {
        **dict.fromkeys(("MapJob", "MapResult"), ".base"),
        **dict.fromkeys(("method_spec", "method_specs", "register_method", "unregister_method"), ".registry"),
        "MethodSpec": ".spec",
    },
)
