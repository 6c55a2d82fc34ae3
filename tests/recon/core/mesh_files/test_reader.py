import numpy as np
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.core.mesh import Mesh

from .conftest import CORNERS, TRIANGLES


@pytest.mark.parametrize("name", ["room.fbx", "room.xml", "room"])
def test_other_formats_are_named(read, name):
    with pytest.raises(DataError, match=r"no mesh format that is read; give one of \.ply, \.obj"):
        read(name, "text")


def test_coordinates_that_float32_cannot_hold_are_named(read):
    """Places so far apart that no offset brings all of them near the origin."""
    text = "".join(f"v {x + 500_000 * z} {y + 10_800_000 * z} {z}\n" for x, y, z in CORNERS)
    text += "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in TRIANGLES)
    notes = read("wide.obj", text).notes
    assert len(notes) == 1
    assert "are rounded by up to 500 mm" in notes[0]


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off", ".gltf", ".glb"])
def test_what_is_written_is_what_the_name_says(tmp_path, suffix):
    colors = np.arange(24, dtype=np.uint8).reshape(8, 3) * 10
    sigma = np.arange(1, 9, dtype=np.float32) / 100
    mesh = Mesh(np.array(CORNERS, np.float32) / 3, np.array(TRIANGLES, np.int32), colors, sigma)
    path = tmp_path / f"mesh{suffix}"
    mesh.save(path)
    again = Mesh.load(path)
    corners = [m.vertices[m.faces].reshape(-1, 9) for m in (mesh, again)]
    np.testing.assert_array_equal(*corners)
    if suffix != ".stl":
        np.testing.assert_array_equal(again.colors, colors)
    if suffix == ".ply":
        np.testing.assert_array_equal(again.sigma, sigma)
    magic = {".ply": b"ply\n", ".obj": b"v ", ".stl": b"binary STL", ".off": b"COFF\n", ".gltf": b"{", ".glb": b"glTF"}
    assert path.read_bytes().startswith(magic[suffix])
