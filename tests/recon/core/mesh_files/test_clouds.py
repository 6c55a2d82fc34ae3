import struct

import numpy as np
import open3d as o3d
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.core.mesh import Mesh, PointCloud, load_surface

from .conftest import CORNERS

TEXT = "".join(f"{x} {y} {z}\n" for x, y, z in CORNERS)
PCD = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS intensity x y z\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 8\nHEIGHT 1\n"
    "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 8\nDATA "
)
ASCII_ROWS = "".join(f"9 {x} {y} {z}\n" for x, y, z in CORNERS)
BINARY_ROWS = b"".join(struct.pack("<4f", 9, *corner) for corner in CORNERS)
PLY = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cloud.ply", PLY + TEXT),
        ("cloud.xyz", TEXT),
        ("cloud.xyz", "# x y z\n" + TEXT.replace(" ", ", ")),
        ("cloud.xyz", "X;Y;Z\n" + TEXT.replace(".", ",").replace(" ", ";")),
        ("cloud.xyz", TEXT.replace(".", ",")),
        ("cloud.xyzrgb", TEXT.replace("\n", " 0.1 0.2 0.3\n")),
        ("cloud.xyzn", TEXT.replace("\n", " 0 0 1\r\n")),
        ("cloud.pts", "8\n" + TEXT.replace("\n", " -1200 255 0 7\n")),
        ("cloud.pcd", PCD + "ascii\n" + ASCII_ROWS),
        ("cloud.pcd", (PCD + "binary\n").encode() + BINARY_ROWS),
        ("cloud.obj", "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)),
    ],
)
def test_points_are_read(read, name, content):
    cloud = read(name, content).surface
    assert isinstance(cloud, PointCloud)
    np.testing.assert_allclose(cloud.points, CORNERS)


def test_compressed_pcd(tmp_path):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(CORNERS * 50)))
    o3d.io.write_point_cloud(str(tmp_path / "c.pcd"), cloud, compressed=True)
    np.testing.assert_allclose(load_surface(tmp_path / "c.pcd").points, CORNERS * 50)


def test_points_without_a_measurement_are_left_out_and_named(read):
    result = read("cloud.pcd", PCD + "ascii\n" + ASCII_ROWS.replace("9 4.0 3.0 2.5", "9 nan nan nan"))
    np.testing.assert_allclose(result.surface.points, CORNERS[:7])
    assert "1 of 8 points are not finite" in result.notes[0]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cloud.pts", "9\n" + TEXT, "announces 9 points and holds 8"),
        ("cloud.xyz", TEXT + "1 2\n", "line 9: expected 3 numbers"),
        ("cloud.xyz", "1 2\n", "expected a point"),
        ("cloud.xyz", "1,5 2.5 3,5\n", "its commas may separate numbers or stand for decimal points"),
        ("cloud.xyz", "hello world\n", "line 1: expected a point"),
        ("cloud.pcd", (PCD + "binary\n").encode() + BINARY_ROWS[:-1], "is cut off"),
        ("cloud.pcd", PCD + "ascii\n" + ASCII_ROWS[:-9], "8 points of 4 numbers"),
        (
            "cloud.pcd",
            PCD.replace("FIELDS", "FIELDS more and") + "ascii\n" + ASCII_ROWS,
            "6 fields of 4 types",
        ),
        ("cloud.pcd", "ply\n", "is no PCD file"),
        ("cloud.ply", PLY + "nan nan nan\n" * 8, "none of its 8 points is finite"),
    ],
)
def test_damage_is_one_line_that_names_the_file(read, name, content, message):
    with pytest.raises(DataError, match=message) as caught:
        read(name, content)
    assert name in str(caught.value)


def test_a_cloud_is_no_mesh(tmp_path):
    (tmp_path / "cloud.xyz").write_text(TEXT)
    with pytest.raises(DataError, match=r"cloud\.xyz holds no triangles, only 8 points"):
        Mesh.load(tmp_path / "cloud.xyz")
