import struct

import numpy as np
import pytest
from uncle.recon.core.errors import DataError

from .conftest import BOX_AREA, CORNERS, QUADS, TRIANGLES

MIXED = [*TRIANGLES[:6], *QUADS[3:]]


def header(form="ascii", real="float", faces=6, extra="", list_type="list uchar int"):
    axes = "".join(f"property {real} {axis}\n" for axis in "xyz")
    return (
        f"ply\nformat {form} 1.0\ncomment made by a test\nelement vertex 8\n{axes}{extra}element face {faces}\n"
        f"property {list_type} vertex_indices\nend_header\n"
    )


def rows(faces=QUADS, extra=""):
    vertices = "".join(f"{x} {y} {z}{extra}\n" for x, y, z in CORNERS)
    return vertices + "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)


@pytest.mark.parametrize("faces", [QUADS, TRIANGLES, MIXED], ids=["quads", "triangles", "mixed"])
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("real", ["float", "double"])
def test_polygons_of_any_form_are_whole(read, faces, form, real):
    if form == "ascii":
        body = rows(faces).encode()
    else:
        order = "<" if "little" in form else ">"
        body = b"".join(struct.pack(order + ("3f" if real == "float" else "3d"), *corner) for corner in CORNERS)
        body += b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    result = read("box.ply", header(form, real, len(faces)).encode() + body)
    assert result.area == pytest.approx(BOX_AREA)
    assert len(result.surface.faces) == 12
    assert result.notes == []


@pytest.mark.parametrize("name", ["vertex_index", "vertex_indices", "corners"])
@pytest.mark.parametrize("kinds", [("uint8", "uint32"), ("int", "ushort"), ("ushort", "uchar"), ("uint", "short")])
def test_lists_of_any_type_and_name(read, name, kinds):
    letters = {"uint8": "B", "uint32": "I", "int": "i", "ushort": "H", "uchar": "B", "uint": "I", "short": "h"}
    head = header("binary_little_endian", faces=9, list_type=f"list {kinds[0]} {kinds[1]}").replace(
        "vertex_indices", name
    )
    body = b"".join(struct.pack("<3f", *corner) for corner in CORNERS)
    for face in MIXED:
        body += struct.pack(f"<{letters[kinds[0]]}", len(face)) + struct.pack(f"<{len(face)}{letters[kinds[1]]}", *face)
    assert read("box.ply", head.encode() + body).area == pytest.approx(BOX_AREA)


def test_extra_elements_and_properties_are_passed_over_and_named(read):
    text = header(extra="property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float quality\n")
    text = text.replace(
        "property list uchar int vertex_indices\n",
        "property uchar flags\nproperty list uchar float texcoord\nproperty list uchar int vertex_indices\n"
        "element edge 2\nproperty int vertex1\nproperty int vertex2\n",
    )
    vertices = "".join(f"{x} {y} {z} {10 * i} 200 255 0.5\n" for i, (x, y, z) in enumerate(CORNERS))
    faces = "".join(f"7 {2 * (i % 3)} {'0.5 ' * 2 * (i % 3)} 4 {' '.join(map(str, q))}\n" for i, q in enumerate(QUADS))
    result = read("box.ply", text + vertices + faces + "0 1\n1 2\n")
    assert result.area == pytest.approx(BOX_AREA)
    np.testing.assert_array_equal(result.surface.colors[:, 0], np.arange(8) * 10)
    assert len(result.notes) == 1
    assert "element `edge` (2 rows)" in result.notes[0]


def test_colours_of_real_numbers_reach_from_0_to_1(read):
    text = header(extra="property float red\nproperty float green\nproperty float blue\n") + rows(extra=" 1 0.5 0")
    assert read("box.ply", text).surface.colors[3].tolist() == [255, 128, 0]


def test_colours_of_bytes_that_are_all_dark_stay_dark(read):
    text = header(extra="property uchar red\nproperty uchar green\nproperty uchar blue\n") + rows(extra=" 1 1 0")
    assert read("box.ply", text).surface.colors[3].tolist() == [1, 1, 0]


def test_triangle_strips_alternate_their_winding(read):
    text = (
        "ply\nformat ascii 1.0\nelement vertex 7\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n1 1 0\n5 0 0\n6 0 0\n5 1 0\n8 0 1 2 3 -1 4 5 6\n"
    )
    result = read("strip.ply", text)
    assert result.area == pytest.approx(1.5)
    a, b, c = result.surface.vertices[result.surface.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_line_ends_of_windows(read):
    assert read("box.ply", (header() + rows()).replace("\n", "\r\n")).area == pytest.approx(BOX_AREA)
    body = b"".join(struct.pack("<3f", *c) for c in CORNERS) + b"".join(struct.pack("<B4i", 4, *q) for q in QUADS)
    head = header("binary_little_endian").replace("\n", "\r\n").encode()
    assert read("binary.ply", head + body).area == pytest.approx(BOX_AREA)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("4 1 5 7 3", "4 1 5 7 99"), "face 5 names vertex 99, but there are only 8"),
        (lambda text: text.replace("4 1 5 7 3", "4 1 5 7 -1"), "face 5 names vertex -1"),
        (lambda text: text[:-30], "element `face` has 6 rows"),
        (lambda text: text + "1 2 3\n", "3 numbers more than its header names"),
        (lambda text: text.replace("4.0 3.0 2.5", "4.0 3,0 2.5"), "line 18: expected numbers"),
        (lambda text: text.replace("4.0 3.0 2.5", "nan 3.0 2.5"), r"1 of 8 vertices are not finite \(the first: 7\)"),
        (lambda text: text.replace("ply", "plx", 1), "is no PLY file"),
        (lambda text: text[:60], "its header has no end"),
        (lambda text: text.replace("format ascii 1.0\n", ""), "names no known format"),
        (lambda text: text.replace("property float x", "property float u"), "has no x, y and z, but u, y, z"),
        (lambda text: text.replace("element face 6", "element face six"), "not PLY: 'element face six'"),
        (lambda text: text.replace("vertex 8", "vertex 99999999999"), "element `vertex` has 99999999999 rows"),
    ],
)
def test_damage_is_one_line_that_names_the_file(read, change, message):
    with pytest.raises(DataError, match=message) as caught:
        read("box.ply", change(header() + rows()))
    assert "box.ply" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("missing", [1, 10, 100, 190])
def test_binary_that_is_cut_off(read, missing):
    body = b"".join(struct.pack("<3f", *c) for c in CORNERS) + b"".join(struct.pack("<B4i", 4, *q) for q in QUADS)
    with pytest.raises(DataError, match=r"box\.ply is cut off"):
        read("box.ply", header("binary_little_endian").encode() + body[:-missing])


@pytest.mark.parametrize(("real", "letter", "count"), [("float", "f", 1), ("double", "d", 0)])
def test_map_coordinates_of_single_precision_are_questioned(read, real, letter, count):
    place = np.array([448000.0, 5412345.0, 312.0])
    body = b"".join(struct.pack(f"<3{letter}", *(np.array(c) + place)) for c in CORNERS)
    body += b"".join(struct.pack("<B4i", 4, *q) for q in QUADS)
    notes = read("map.ply", header("binary_little_endian", real).encode() + body).notes
    assert sum("rounded by up to 250 mm in the file itself" in note for note in notes) == len(notes) == count
