"""The one place where mesh and point cloud files are read: the suffix names the format, the content has to agree."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import DataError
from ..files import read_bytes
from ..world_offset import Offset
from .clouds import read_pcd, read_points
from .gltf import read_gltf
from .obj import read_obj
from .off import read_off
from .ply import read_ply
from .polygons import Polygons, Triangles, to_triangles
from .stl import read_stl

_PARSERS: dict[str, Callable[[Path, bytes], Polygons]] = {
    ".ply": read_ply, ".obj": read_obj, ".stl": read_stl, ".off": read_off, ".gltf": read_gltf, ".glb": read_gltf,
    ".pcd": read_pcd, ".xyz": read_points, ".xyzn": read_points, ".xyzrgb": read_points, ".pts": read_points,
    ".asc": read_points,
}  # fmt: skip
READABLE_SUFFIXES = tuple(_PARSERS)


def read_triangles(path: Path, offset_m: Offset | None = None) -> Triangles:
    """The triangles of a mesh file, or the points of a cloud, checked; `offset_m` as in `to_triangles`.

    Raises DataError.
    """
    parser = _PARSERS.get(path.suffix.lower())
    if not path.is_file():
        raise DataError(f"there is no mesh at {path}")
    if parser is None:
        raise DataError(
            f"{path}: {path.suffix or 'a file without suffix'} is no mesh format that is read; give one of "
            f"{', '.join(READABLE_SUFFIXES)}"
        )
    try:
        data = read_bytes(path)
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}") from error
    if not data:
        raise DataError(f"{path} is an empty file")
    try:
        return to_triangles(path, parser(path, data), offset_m)
    except MemoryError as error:
        raise DataError(f"{path} does not fit into memory; give a smaller part of it") from error
