"""Types and tools that every room shares. No algorithm, no run directory.

Imports no other room. Start at `frame.py` (a frame and a recording), `camera.py` and `se3.py` (geometry),
`config/map_config.py` (every setting), `errors.py` and `events.py` (how the library speaks to its caller).
"""

from typing import TYPE_CHECKING

from .lazy import lazy_names

if TYPE_CHECKING:
    from .camera import Camera
    from .config.map_config import MapConfig, make_config
    from .errors import ConfigError, DataError, DependencyError, FrameError, RunError, UncleError
    from .frame import Frame, Recording
    from .mesh import Mesh
    from .trajectory import Trajectory

__all__ = [
    "Camera",
    "ConfigError",
    "DataError",
    "DependencyError",
    "Frame",
    "FrameError",
    "MapConfig",
    "Mesh",
    "Recording",
    "RunError",
    "Trajectory",
    "UncleError",
    "make_config",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Camera": ".camera",
        **dict.fromkeys(("MapConfig", "make_config"), ".config.map_config"),
        **dict.fromkeys(
            ("ConfigError", "DataError", "DependencyError", "FrameError", "RunError", "UncleError"), ".errors"
        ),
        **dict.fromkeys(("Frame", "Recording"), ".frame"),
        "Mesh": ".mesh",
        "Trajectory": ".trajectory",
    },
)
