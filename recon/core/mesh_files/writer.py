"""Triangle meshes written as PLY, OBJ, STL, OFF, glTF and GLB; the suffix chooses. Only PLY holds sigma."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import RunError
from ..files import write_bytes
from ..world_offset import NO_OFFSET, Offset

_Colors = np.ndarray | None


def require_writable_suffix(path: Path) -> None:
    """Raises RunError if no mesh can be written under this name."""
    if path.suffix.lower() not in WRITABLE_SUFFIXES:
        raise RunError(
            f"cannot write {path}: {path.suffix or 'a name without suffix'} is no mesh format that is written; "
            f"choose one of {', '.join(WRITABLE_SUFFIXES)}"
        )


def write_triangles(
    path: Path, vertices: np.ndarray, faces: np.ndarray, colors: _Colors = None, sigma: np.ndarray | None = None,
    offset_m: Offset = NO_OFFSET,
) -> None:  # fmt: skip
    """Write vertices (V, 3), faces (F, 3), colors (V, 3) uint8 RGB and sigma (V,) in the format of the suffix.

    Coordinates are not turned, also where a format has a convention for the axis that points up. With an offset, which
    is added to the vertices, PLY holds double precision, OBJ and OFF more digits, and glTF the translation of a node.
    Raises RunError.
    """
    require_writable_suffix(path)
    suffix = path.suffix.lower()
    vertices = np.asarray(vertices, dtype=np.float32)
    if offset_m != NO_OFFSET and suffix not in (".gltf", ".glb"):
        if suffix == ".stl":
            raise RunError(
                f"cannot write {path}: STL has no double precision, which coordinates this far from the origin need; "
                "write PLY, OBJ or GLB"
            )
        vertices = vertices.astype(np.float64) + offset_m
    if suffix == ".ply":
        write_bytes(path, _ply(vertices, faces, colors, sigma))
    elif suffix in (".gltf", ".glb"):
        write_bytes(path, _GLTF[suffix](vertices, faces, colors, offset_m))
    else:
        write_bytes(path, _ENCODERS[suffix](vertices, faces, colors))


def _ply(vertices: np.ndarray, faces: np.ndarray, colors: _Colors, sigma: np.ndarray | None) -> bytes:
    kind = "<f8" if vertices.dtype == np.float64 else "<f4"
    fields = [("x", kind), ("y", kind), ("z", kind)]
    if colors is not None:
        fields += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    if sigma is not None:
        fields += [("sigma", "<f4")]
    table = np.zeros(len(vertices), dtype=fields)
    for axis, name in enumerate("xyz"):
        table[name] = vertices[:, axis]
    if colors is not None:
        for channel, name in enumerate(("red", "green", "blue")):
            table[name] = colors[:, channel]
    if sigma is not None:
        table["sigma"] = sigma
    triangles = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, faces
    return _ply_header(fields, len(table), len(triangles)).encode() + table.tobytes() + triangles.tobytes()


def _ply_header(fields: list[tuple[str, str]], vertices: int, faces: int) -> str:
    names = {"<f4": "float", "<f8": "double", "u1": "uchar"}
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment sigma: 1 sigma in metres",
        f"element vertex {vertices}",
    ]
    lines += [f"property {names[kind]} {name}" for name, kind in fields]
    lines += [f"element face {faces}", "property list uchar int vertex_indices", "end_header"]
    return "\n".join(lines) + "\n"


def _obj(vertices: np.ndarray, faces: np.ndarray, colors: _Colors) -> bytes:
    rows = [f"v {row}" for row in _as_text(vertices)]
    if colors is not None:
        tints = [f" {r:.6g} {g:.6g} {b:.6g}" for r, g, b in (colors / 255).tolist()]
        rows = [row + tint for row, tint in zip(rows, tints, strict=True)]
    rows += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(rows) + "\n").encode()


def _as_text(vertices: np.ndarray) -> list[str]:
    """A line for each vertex, with all digits of its precision."""
    digits = 17 if vertices.dtype == np.float64 else 9
    return [f"{x:.{digits}g} {y:.{digits}g} {z:.{digits}g}" for x, y, z in vertices.tolist()]


def _stl(vertices: np.ndarray, faces: np.ndarray, _: _Colors) -> bytes:
    facets = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    facets["corners"] = corners
    return b"binary STL".ljust(80) + struct.pack("<I", len(faces)) + facets.tobytes()


def _off(vertices: np.ndarray, faces: np.ndarray, colors: _Colors) -> bytes:
    rows = _as_text(vertices)
    if colors is not None:
        rows = [f"{row} {r} {g} {b} 255" for row, (r, g, b) in zip(rows, colors.tolist(), strict=True)]
    rows += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    magic = "OFF" if colors is None else "COFF"
    return "\n".join([magic, f"{len(vertices)} {len(faces)} 0", *rows, ""]).encode()


def _gltf_document(
    vertices: np.ndarray, faces: np.ndarray, colors: _Colors, offset_m: Offset
) -> tuple[dict[str, object], bytes]:
    """The JSON of a scene of one mesh, without the place of its buffer, and the buffer."""
    node: dict[str, object] = {"mesh": 0} | ({} if offset_m == NO_OFFSET else {"translation": list(offset_m)})
    blocks = [vertices.tobytes(), faces.astype("<u4").tobytes()]
    accessors: list[dict[str, object]] = [
        {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 3 * len(faces), "type": "SCALAR"},
    ]
    if len(vertices):
        accessors[0] |= {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    attributes = {"POSITION": 0}
    if colors is not None:
        opaque = np.column_stack([colors, np.full(len(colors), 255, np.uint8)])  # rows of four bytes, as required
        blocks.append(opaque.astype(np.uint8).tobytes())
        accessors.append(
            {"bufferView": 2, "componentType": 5121, "normalized": True, "count": len(colors), "type": "VEC4"}
        )
        attributes["COLOR_0"] = 2
    starts = np.cumsum([0, *map(len, blocks)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": at, "byteLength": len(block)} for at, block in zip(starts, blocks, strict=False)
    ]
    tree: dict[str, object] = {
        "asset": {"version": "2.0", "generator": "uncle"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": views,
    }
    return tree, b"".join(blocks)


def _gltf(vertices: np.ndarray, faces: np.ndarray, colors: _Colors, offset_m: Offset) -> bytes:
    tree, buffer = _gltf_document(vertices, faces, colors, offset_m)
    uri = "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()
    return json.dumps(tree | {"buffers": [{"byteLength": len(buffer), "uri": uri}]}).encode()


def _glb(vertices: np.ndarray, faces: np.ndarray, colors: _Colors, offset_m: Offset) -> bytes:
    tree, buffer = _gltf_document(vertices, faces, colors, offset_m)
    text = json.dumps(tree | {"buffers": [{"byteLength": len(buffer)}]}).encode()
    chunks = [(text + b" " * (-len(text) % 4), b"JSON"), (buffer + b"\0" * (-len(buffer) % 4), b"BIN\0")]
    body = b"".join(struct.pack("<I4s", len(chunk), kind) + chunk for chunk, kind in chunks)
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


_ENCODERS: dict[str, Callable[[np.ndarray, np.ndarray, _Colors], bytes]] = {
    ".obj": _obj, ".stl": _stl, ".off": _off,
}  # fmt: skip
_GLTF = {".gltf": _gltf, ".glb": _glb}
WRITABLE_SUFFIXES = (".ply", *_ENCODERS, *_GLTF)
