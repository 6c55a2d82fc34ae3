"""The reconstruction library: maps, uncertainty, meshes and scores. No Click, no data-set layouts, no printing.

`__version__` is that of the installed distribution; `unknown` if there is none.
"""

import os

# Waiting threads of PyTorch, OpenCV and Open3D must not spin: on few or shared cores they starve each other, and a map
# takes many times as long. The OpenMP runtime reads it when PyTorch is loaded, hence here.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("uncle")
    except PackageNotFoundError:
        return "unknown"
