"""Worlds far from their origin: what is chosen, and that files keep their places to a tenth of a millimetre."""

import numpy as np
import pytest
from uncle.recon.core.errors import RunError
from uncle.recon.core.mesh import Mesh, load_surface
from uncle.recon.core.world_offset import FAR_M, NO_OFFSET, world_offset

UTM = (500_120.0, 4_512_340.0, 130.0)
CORNERS = np.array([[0, 0, 0], [1, 0, 0.1234], [0, 1, -0.00071], [1.5, 1, 3]], np.float32)
FACES = np.array([[0, 1, 2], [1, 3, 2]], np.int32)


def test_near_worlds_have_no_offset_and_far_ones_a_round_one_in_their_middle():
    rng = np.random.default_rng(0)
    positions = rng.uniform(-5, 5, (50, 3))
    assert world_offset(positions) == NO_OFFSET
    assert world_offset(positions + np.array([0.9 * FAR_M, 0, 0])) == NO_OFFSET
    offset = world_offset(positions + UTM)
    assert offset == UTM
    positions[3] = 1e9, 0, 0  # one wrong pose decides nothing
    positions[4] = np.nan
    assert world_offset(positions + UTM) == UTM
    assert world_offset(np.zeros((0, 3))) == NO_OFFSET


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".gltf", ".glb"])
def test_meshes_far_away_keep_their_shape_and_place(tmp_path, suffix):
    Mesh(CORNERS, FACES, offset_m=UTM).save(tmp_path / f"far{suffix}")
    again = Mesh.load(tmp_path / f"far{suffix}")
    assert np.linalg.norm(np.subtract(again.offset_m, UTM)) < 20
    places = again.vertices.astype(np.float64) + again.offset_m
    np.testing.assert_allclose(places, CORNERS.astype(np.float64) + UTM, atol=1e-5, rtol=0)
    there = Mesh.load(tmp_path / f"far{suffix}", offset_m=UTM)
    np.testing.assert_allclose(there.vertices, CORNERS, atol=1e-6)


def test_a_format_without_the_precision_is_refused(tmp_path):
    with pytest.raises(RunError, match="STL has no double precision"):
        Mesh(CORNERS, FACES, offset_m=UTM).save(tmp_path / "far.stl")
    Mesh(CORNERS, FACES).save(tmp_path / "near.stl")


def test_points_far_away_are_relative_to_the_same_offset(tmp_path):
    rows = CORNERS.astype(np.float64) + UTM
    (tmp_path / "cloud.xyz").write_text("\n".join(f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in rows))
    cloud = load_surface(tmp_path / "cloud.xyz", offset_m=UTM)
    np.testing.assert_allclose(cloud.points, CORNERS, atol=1e-6)


def test_near_meshes_are_written_as_ever(tmp_path):
    Mesh(CORNERS, FACES).save(tmp_path / "near.ply")
    assert b"property float x" in (tmp_path / "near.ply").read_bytes()
    assert Mesh.load(tmp_path / "near.ply").offset_m == NO_OFFSET
