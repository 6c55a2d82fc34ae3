import numpy as np
import pytest
from uncle.recon.core.errors import DataError

from .conftest import BOX_AREA, CORNERS, QUADS, TRIANGLES


def vertices(tail=""):
    return "".join(f"v {x} {y} {z}{tail}\n" for x, y, z in CORNERS)


def faces(polygons=QUADS, corner=lambda index: str(index + 1)):
    return "".join(f"f {' '.join(corner(i) for i in polygon)}\n" for polygon in polygons)


@pytest.mark.parametrize(
    "text",
    [
        vertices() + faces(),
        vertices() + faces(TRIANGLES),
        vertices() + "o walls\nusemtl red\n" + faces(TRIANGLES[:6]) + "g rest\ns off\n" + faces(QUADS[3:]),
        vertices() + faces(corner=lambda i: str(i - 8)),
        "vt 0 0\nvn 0 0 1\n" + vertices() + faces(corner=lambda i: f"{i + 1}/1/1"),
        vertices() + faces(corner=lambda i: f"{i + 1}//1"),
        vertices(" 1.0") + faces(),
        (vertices() + faces()).replace("\n", "\r\n"),
        (vertices() + faces()).replace(" ", "\t"),
        vertices() + faces().replace("f 1 2 ", "f 1 2 \\\n  "),
        "# by a tool\n" + vertices(" # here") + faces().replace("\n", "  # there\n"),
        "\ufeff" + vertices() + faces(),
        (vertices() + faces()).replace(".", ","),
    ],
    ids=["quads", "triangles", "groups", "negative", "vt-vn", "vn", "w", "crlf", "tabs", "continued", "comments", "bom",
         "decimal-comma"],
)  # fmt: skip
def test_every_face_is_there(read, text):
    result = read("box.obj", text)
    assert result.area == pytest.approx(BOX_AREA)
    assert result.notes == []


def test_negative_indices_count_back_from_the_face(read):
    """Two objects, each with its vertices before its faces."""
    far = vertices().replace("v 0.0", "v 10.0").replace("v 4.0", "v 14.0")
    back = faces(corner=lambda i: str(i - 8))
    result = read("two.obj", "o a\n" + vertices() + back + "o b\n" + far + back)
    assert result.area == pytest.approx(2 * BOX_AREA)
    assert result.surface.vertices[:, 0].max() == 14


def test_utf_16(read):
    assert read("box.obj", (vertices() + faces()).encode("utf-16")).area == pytest.approx(BOX_AREA)


@pytest.mark.parametrize(("tail", "expected"), [(" 1 0.5 0", [255, 128, 0]), (" 255 128 0", [255, 128, 0])])
def test_colours_of_vertices(read, tail, expected):
    assert read("box.obj", vertices(tail) + faces()).surface.colors[2].tolist() == expected


def test_concave_polygons_keep_their_area(read):
    arrow = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 1 0.5 0\nv 0 2 0\n"
    for corners in ("1 2 3 4 5", "3 4 5 1 2", "5 4 3 2 1"):
        assert read("arrow.obj", f"{arrow}f {corners}\n").area == pytest.approx(2.5)


def test_what_is_left_out_is_named(read):
    text = vertices() + "v 9 9 9\n" + faces() + "f 1 2 2\nl 1 2 3\np 4\n"
    result = read("box.obj", text)
    assert result.area == pytest.approx(BOX_AREA)
    assert result.surface.vertices.max() == 4
    notes = " ".join(result.notes)
    for part in ("1 of 9 vertices", "1 faces have fewer", "statements of lines", "statements of points"):
        assert part in notes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (vertices() + faces() + "f 1 2 99\n", "face 7 names vertex 99, but there are only 8 .numbers 1 to 8"),
        (vertices() + faces() + "f -1 -2 -9\n", "line 15: a face names vertex -9, but only 8 stand before"),
        (vertices() + faces() + "f 0 1 2\n", "line 15: not the corners of a face"),
        (vertices() + faces() + "f 1 2 x\n", "line 15: not the corners of a face"),
        (vertices() + "v 1 2\n" + faces(), "line 9: expected one of x y z"),
        (vertices() + "v 1 2 x\n" + faces(), "line 9: expected 3 numbers"),
        (vertices() + faces() + "surf 0 1 0 1 1 2 3\n", "free-form"),
        ("hello\n", "line 1: not a statement of an OBJ file: 'hello'"),
        ("# nothing\n", "holds no vertices"),
        ("v nan 0 0\n" + vertices() + "f 1 2 3\n", "not finite"),
    ],
)
def test_damage_is_one_line_that_names_the_file(read, text, message):
    with pytest.raises(DataError, match=message) as caught:
        read("box.obj", text)
    assert "box.obj" in str(caught.value)


def test_an_empty_file(read):
    with pytest.raises(DataError, match=r"box\.obj is an empty file"):
        read("box.obj", "")


def test_faces_stay_in_the_order_of_the_file(read):
    polygons = [QUADS[0], TRIANGLES[2], QUADS[2]]
    expected = [*TRIANGLES[:2], TRIANGLES[2], *TRIANGLES[4:6]]
    np.testing.assert_array_equal(read("box.obj", vertices() + faces(polygons)).surface.faces, expected)
