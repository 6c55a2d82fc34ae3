import base64
import json
import struct

import numpy as np
import pytest
from uncle.recon.core.errors import DataError

from .conftest import BOX_AREA, CORNERS, TRIANGLES


def document(**changes):
    """A box as glTF with its buffer inside; `changes` replace parts of the tree."""
    positions = np.array(CORNERS, "<f4").tobytes()
    indices = np.array(TRIANGLES, "<u2").tobytes()
    data = positions + indices
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 96},
            {"buffer": 0, "byteOffset": 96, "byteLength": 72},
        ],
        "buffers": [{"byteLength": 168, "uri": "data:;base64," + base64.b64encode(data).decode()}],
    }
    return json.dumps(tree | changes)


def glb(text, binary=b""):
    text = text.encode() + b" " * (-len(text.encode()) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def test_one_mesh(read):
    assert read("box.gltf", document()).area == pytest.approx(BOX_AREA)
    assert read("box.glb", glb(document())).area == pytest.approx(BOX_AREA)


def test_every_node_stands_where_its_parents_put_it(read):
    turn = [float(np.sqrt(0.5)), 0, 0, float(np.sqrt(0.5))]  # 90 degrees about x: (x, y, z) -> (x, -z, y)
    nodes = [
        {"children": [1, 2], "scale": [2, 2, 2]},
        {"mesh": 0, "translation": [10, 0, 0]},
        {"mesh": 0, "rotation": turn},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -50, 1]},
    ]
    result = read("scene.gltf", document(nodes=nodes, scenes=[{"nodes": [0, 3]}]))
    assert result.area == pytest.approx(2 * 4 * BOX_AREA + BOX_AREA)
    np.testing.assert_allclose(result.surface.vertices.max(axis=0), [28, 6, 6], atol=1e-5)
    np.testing.assert_allclose(result.surface.vertices.min(axis=0), [0, -5, -50], atol=1e-5)


def test_mirrored_nodes_keep_their_outside(read):
    plain = read("plain.gltf", document()).surface
    mirrored = read("mirrored.gltf", document(nodes=[{"mesh": 0, "scale": [-1, 1, 1]}])).surface

    def volume(mesh):
        a, b, c = mesh.vertices.astype(float)[mesh.faces].transpose(1, 0, 2)
        return (np.cross(a, b) * c).sum() / 6

    assert volume(mirrored) == pytest.approx(volume(plain))


def test_strips_fans_and_meshes_that_no_scene_shows(read):
    square = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 0, 5), (1, 0, 5), (1, 1, 5), (0, 1, 5)], "<f4")
    primitives = [{"attributes": {"POSITION": 0}, "mode": 5}, {"attributes": {"POSITION": 1}, "mode": 6}]
    views = [{"buffer": 0, "byteLength": 96}]
    accessors = [
        {"bufferView": 0, "byteOffset": 48 * i, "componentType": 5126, "count": 4, "type": "VEC3"} for i in range(2)
    ]
    text = document(
        meshes=[{"primitives": primitives}, {"primitives": primitives}], accessors=accessors, bufferViews=views,
        buffers=[{"byteLength": 96, "uri": "square.bin"}],
    )  # fmt: skip
    with pytest.raises(DataError, match=r"needs the file .*square\.bin"):
        read("square.gltf", text)
    read_square = lambda: read("square.gltf", text)  # noqa: E731
    with pytest.raises(DataError):
        read("square.bin", square.tobytes())
    result = read_square()
    assert result.area == pytest.approx(2.0)
    assert any("1 meshes that its scene does not show" in note for note in result.notes)


def test_integers_that_stand_for_real_numbers(read):
    """KHR_mesh_quantization: 16-bit positions with padding between the rows."""
    rows = np.zeros((8, 4), "<i2")
    rows[:, :3] = np.array(CORNERS) / 4 * 32767
    data = rows.tobytes() + np.array(TRIANGLES, "<u2").tobytes()
    text = document(
        extensionsRequired=["KHR_mesh_quantization"],
        accessors=[
            {"bufferView": 0, "componentType": 5122, "normalized": True, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        bufferViews=[
            {"buffer": 0, "byteLength": 64, "byteStride": 8}, {"buffer": 0, "byteOffset": 64, "byteLength": 72},
        ],
        buffers=[{"byteLength": 136}],
        nodes=[{"mesh": 0, "scale": [4, 4, 4]}],
    )  # fmt: skip
    assert read("box.glb", glb(text, data)).area == pytest.approx(BOX_AREA, rel=1e-3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (glb(document())[:-10], "is cut off"),
        (document()[:-10], "is no glTF file"),
        (document(asset={"version": "1.0"}), "only version 2"),
        (document(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression, which is not read"),
        (document(nodes=[{"mesh": 7}]), "is damaged"),
        (document(nodes=[{"mesh": 0, "children": [0]}]), "do not form a tree"),
        (document(scenes=[{"nodes": []}]), "holds no triangles"),
        (document().replace('"count": 8', '"count": 7'), "a face names vertex 7, but there are only 7"),
        (document().replace('"count": 36', '"count": 39'), "do not fit into its buffer"),
        (document().replace('"byteLength": 168', '"byteLength": 500'), "has 168 of 500 bytes"),
        (document(accessors=[{"componentType": 5126, "count": 10**12, "type": "VEC3"}]), "an accessor has 10000"),
        ("[]", "is no glTF file"),
    ],
)
def test_damage_is_one_line_that_names_the_file(read, content, message):
    name = "box.glb" if isinstance(content, bytes) else "box.gltf"
    with pytest.raises(DataError, match=message) as caught:
        read(name, content)
    assert name in str(caught.value)
