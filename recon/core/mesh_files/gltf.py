"""glTF 2.0 files (.gltf, .glb): the triangles of all nodes of a scene, placed by their transforms."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import DataError
from ..files import read_bytes
from ..world_offset import FAR_M
from .polygons import Polygons, pack, strip_triangles

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_POINTS, _TRIANGLES, _STRIP, _FAN = 0, 4, 5, 6
MAX_COUNT = 200_000_000  # values of an accessor: without a buffer they cost a file nothing
# Extensions that change where the surface is; others concern its colours and light alone.
_UNREAD = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "EXT_mesh_gpu_instancing",
)


def read_gltf(path: Path, data: bytes) -> Polygons:
    """Parse the bytes of the file `path`, and the buffers beside it. Raises DataError."""
    document, chunk = _parse_glb(path, data) if data[:4] == b"glTF" else (data, None)
    try:
        tree = json.loads(document.decode("utf-8-sig"))
        version = str(tree["asset"]["version"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DataError(f"{path} is no glTF file: no JSON with an asset and its version is in it") from error
    if not version.startswith("2"):
        raise DataError(f"{path} is glTF {version}; only version 2 is read")
    used = [name for name in _UNREAD if name in [*tree.get("extensionsRequired", []), *tree.get("extensionsUsed", [])]]
    if used:
        raise DataError(f"{path} uses the extension {used[0]}, which is not read; export it without compression")
    try:
        return _Scene(path, tree, chunk).polygons()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, binascii.Error) as error:
        raise DataError(f"{path} is damaged: {type(error).__name__}: {error}") from error


def _parse_glb(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON and the binary chunk of a GLB file."""
    if len(data) < 20:
        raise DataError(f"{path} is cut off: it has {len(data)} bytes")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise DataError(f"{path} is a GLB file of version {version}; only version 2 is read")
    if length > len(data):
        raise DataError(f"{path} is cut off: its header names {length} bytes, but it has {len(data)}")
    chunks: dict[bytes, bytes] = {}
    place = 12
    while place + 8 <= length:
        size, kind = struct.unpack_from("<I4s", data, place)
        if place + 8 + size > length:
            raise DataError(f"{path} is cut off: a chunk of {size} bytes does not fit into it")
        chunks.setdefault(kind, data[place + 8 : place + 8 + size])
        place += 8 + size
    if b"JSON" not in chunks:
        raise DataError(f"{path} is no GLB file: it has no JSON chunk")
    return chunks[b"JSON"], chunks.get(b"BIN\0")


@dataclass
class _Scene:
    """One document; `notes` grow while it is read."""

    path: Path
    tree: dict[str, Any]
    chunk: bytes | None
    notes: dict[str, int] = field(default_factory=dict)

    def polygons(self) -> Polygons:
        vertices, faces, colors, points = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], [], [np.zeros((0, 3))]
        placed = list(self._placed_meshes())
        # A node that is placed far away holds small coordinates, which are exact.
        is_single = all(np.abs(transform[:3, 3]).max() < FAR_M for transform, _ in placed)
        for transform, number in placed:
            for primitive in self.tree["meshes"][number]["primitives"]:
                position = self._accessor(primitive["attributes"]["POSITION"]).astype(float)
                position = position @ transform[:3, :3].T + transform[:3, 3]
                mode = primitive.get("mode", _TRIANGLES)
                if mode == _POINTS:
                    points.append(position)
                    continue
                triangles = self._triangles(primitive, mode, len(position))
                if np.linalg.det(transform[:3, :3]) < 0:
                    triangles = triangles[:, ::-1]
                faces.append(triangles + sum(map(len, vertices)))
                vertices.append(position)
                colors.append(self._colors(primitive))
        unplaced = len(self.tree.get("meshes", [])) - len({number for _, number in placed})
        if unplaced:
            self.notes["meshes that its scene does not show"] = unplaced
        if not any(map(len, faces)):
            return Polygons(np.concatenate(points), *pack([]), is_single=is_single, notes=self._sentences())
        if len(points) > 1:
            self.notes["sets of points"] = len(points) - 1
        all_colored = bool(colors) and all(color is not None for color in colors)
        joined = np.concatenate([color for color in colors if color is not None]) if all_colored else None
        placed_faces = pack([np.concatenate(faces)])
        notes = self._sentences()
        return Polygons(np.concatenate(vertices), *placed_faces, joined, is_single=is_single, notes=notes)

    def _sentences(self) -> tuple[str, ...]:
        return tuple(f"{count} {what} are left out" for what, count in self.notes.items())

    def _placed_meshes(self) -> Iterator[tuple[np.ndarray, int]]:
        """(4, 4) transform to the scene, and number, of each mesh that the scene shows."""
        nodes = self.tree.get("nodes", [])
        scenes = self.tree.get("scenes", [])
        if scenes:
            roots = scenes[self.tree.get("scene", 0)].get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [number for number in range(len(nodes)) if number not in children]
        pending = [(np.eye(4), number) for number in reversed(roots)]
        visits = 0
        while pending:
            parent, number = pending.pop()
            visits += 1
            if visits > len(nodes):  # nodes form trees: each is reached once
                raise DataError(f"{self.path} is damaged: its nodes do not form a tree")
            node = nodes[number]
            transform = parent @ _node_transform(node)
            if "mesh" in node:
                if "skin" in node:
                    self.notes["poses of skeletons (the mesh is read at rest)"] = 1
                yield transform, node["mesh"]
            pending += [(transform, child) for child in reversed(node.get("children", []))]

    def _triangles(self, primitive: dict[str, Any], mode: int, vertices: int) -> np.ndarray:
        indexed = "indices" in primitive
        corners = self._accessor(primitive["indices"])[:, 0].astype(np.int64) if indexed else np.arange(vertices)
        if len(corners) and corners.max() >= vertices:
            raise DataError(
                f"{self.path}: a face names vertex {corners.max()}, but there are only {vertices}; the file is damaged"
            )
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise DataError(f"{self.path}: {len(corners)} corners are no triangles; the file is damaged")
            return corners.reshape(-1, 3)
        if mode == _STRIP and len(corners) >= 3:
            return strip_triangles(corners)
        if mode == _FAN and len(corners) >= 3:
            return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)
        self.notes["sets of lines"] = self.notes.get("sets of lines", 0) + 1
        return np.zeros((0, 3), np.int64)

    def _colors(self, primitive: dict[str, Any]) -> np.ndarray | None:
        if "COLOR_0" not in primitive["attributes"]:
            return None
        values = self._accessor(primitive["attributes"]["COLOR_0"])[:, :3]
        scale = 255.0 if values.dtype.kind == "f" else 1.0
        return np.round(np.clip(values.astype(float) * scale, 0, 255)).astype(np.uint8)

    def _accessor(self, number: int) -> np.ndarray:
        """(count, width) values; float64 from -1 or 0 to 1 where the file states integers that stand for these."""
        accessor = self.tree["accessors"][number]
        count, width, kind = accessor["count"], _WIDTHS[accessor["type"]], _COMPONENTS[accessor["componentType"]]
        if not 0 <= count <= MAX_COUNT:
            raise DataError(f"{self.path} is damaged: an accessor has {count} values")
        values = np.zeros((count, width), "<" + kind)
        if "bufferView" in accessor:
            values = self._view(accessor["bufferView"], accessor.get("byteOffset", 0), count, width, kind)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            at, new = sparse["indices"], sparse["values"]
            rows = self._view(
                at["bufferView"], at.get("byteOffset", 0), sparse["count"], 1, _COMPONENTS[at["componentType"]]
            )
            values = values.copy()
            values[rows[:, 0]] = self._view(new["bufferView"], new.get("byteOffset", 0), sparse["count"], width, kind)
        if accessor.get("normalized"):
            return np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def _view(self, number: int, offset: int, count: int, width: int, kind: str) -> np.ndarray:
        view = self.tree["bufferViews"][number]
        dtype = np.dtype("<" + kind)
        row = width * dtype.itemsize
        stride = view.get("byteStride", row)
        start = view.get("byteOffset", 0) + offset
        buffer = self._buffers[view["buffer"]]
        end = min(view.get("byteOffset", 0) + view["byteLength"], len(buffer))
        if count and (start < 0 or stride < 0 or start + stride * (count - 1) + row > end):
            raise DataError(f"{self.path} is cut off: {count} values of an accessor do not fit into its buffer")
        return (
            np.ndarray((count, width), dtype, buffer, start, (stride, dtype.itemsize))
            if count
            else np.zeros((0, width), dtype)
        )

    @cached_property
    def _buffers(self) -> list[bytes]:
        return [self._buffer(buffer) for buffer in self.tree.get("buffers", [])]

    def _buffer(self, buffer: dict[str, Any]) -> bytes:
        uri = buffer.get("uri")
        if uri is None:
            data = self.chunk
            if data is None:
                raise DataError(f"{self.path} has a buffer without data")
        elif uri.startswith("data:"):
            data = base64.b64decode(uri.partition(",")[2], validate=True)
        elif "://" in uri:
            raise DataError(f"{self.path} names a buffer elsewhere ({uri[:60]}); save it as one GLB file")
        else:
            place = self.path.parent / unquote(uri)
            try:
                data = read_bytes(place)
            except OSError as error:
                raise DataError(
                    f"{self.path} needs the file {place}, which cannot be read: {error.strerror}"
                ) from error
        if len(data) < buffer["byteLength"]:
            raise DataError(f"{self.path} is cut off: a buffer has {len(data)} of {buffer['byteLength']} bytes")
        return data


def _node_transform(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    transform = np.eye(4)
    rotation = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix()
    transform[:3, :3] = rotation * np.array(node.get("scale", (1, 1, 1)), dtype=float)
    transform[:3, 3] = node.get("translation", (0, 0, 0))
    return transform
