import numpy as np
import pytest
from uncle.recon.core.mesh import Mesh, PointCloud
from uncle.recon.evaluation.placement import placement_doubts


@pytest.fixture
def box(box_room):
    return box_room.mesh()


def moved(mesh, scale=1.0, shift=0.0):
    return Mesh((mesh.vertices * scale + shift).astype(np.float32), mesh.faces)


def test_meshes_that_fit_raise_no_doubt(box):
    assert placement_doubts(box, moved(box, 1.1, 0.2)) == ()
    assert placement_doubts(box, PointCloud(box.vertices)) == ()


@pytest.mark.parametrize(("scale", "unit"), [(1000, "millimetres"), (100, "centimetres"), (39.37, "inches")])
def test_units_are_named_on_either_side(box, scale, unit):
    for doubts, which in (
        (placement_doubts(box, moved(box, scale)), "the extent of the ground truth is"),
        (placement_doubts(box, PointCloud(moved(box, scale).vertices)), "the extent of the ground truth is"),
        (placement_doubts(moved(box, scale), box), "the extent of the mesh is"),
    ):
        assert len(doubts) == 1
        assert doubts[0].startswith(f"{which} {float(f'{scale:.3g}'):g} times")
        assert unit in doubts[0]


def test_other_frames_are_named(box):
    extent = np.ptp(box.vertices[:, 0])
    doubts = placement_doubts(box, moved(box, shift=[extent + 7, 0, 0]))
    assert len(doubts) == 1
    assert "lie 7 m apart" in doubts[0]


def test_an_empty_mesh_and_vertices_without_faces_count_for_nothing(box):
    assert placement_doubts(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)), box) == ()
    stray = Mesh(np.concatenate([box.vertices, [[9000, 0, 0]]]).astype(np.float32), box.faces)
    assert placement_doubts(box, stray) == ()
