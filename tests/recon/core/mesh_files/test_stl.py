import struct

import numpy as np
import pytest
from uncle.recon.core.errors import DataError

from .conftest import BOX_AREA, CORNERS, TRIANGLES


def binary(title=b"a box"):
    facets = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(value for corner in triangle for value in CORNERS[corner]), 0)
        for triangle in TRIANGLES
    )
    return title.ljust(80) + struct.pack("<I", len(TRIANGLES)) + facets


def text(triangles=TRIANGLES, name="box"):
    facets = "".join(
        " facet normal 0 0 0\n  outer loop\n"
        + "".join(f"   vertex {CORNERS[i][0]:e} {CORNERS[i][1]:e} {CORNERS[i][2]:e}\n" for i in triangle)
        + "  endloop\n endfacet\n"
        for triangle in triangles
    )
    return f"solid {name}\n{facets}endsolid {name}\n"


@pytest.mark.parametrize(
    "content",
    [binary(), binary(b"solid of a tool"), text(), text().upper(), text(TRIANGLES[:4]) + text(TRIANGLES[4:], "two"),
     text().replace("\n", "\r\n")],
    ids=["binary", "binary-solid", "ascii", "upper", "two-solids", "crlf"],
)  # fmt: skip
def test_every_triangle_is_there_and_corners_are_shared(read, content):
    result = read("box.stl", content)
    assert result.area == pytest.approx(BOX_AREA)
    assert len(result.surface.vertices) == 8
    assert result.notes == []


def test_text_in_map_coordinates_keeps_its_decimals(read):
    """Float32 would move its corners by up to 25 cm."""
    place = np.array([448000.25, 5412345.125, 312.5])
    corners = np.array(CORNERS)[np.array(TRIANGLES)] / 10 + place
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {:.4f} {:.4f} {:.4f}\n".format(*corner) for corner in triangle)
        + "endloop\nendfacet\n"
        for triangle in corners
    )
    result = read("map.stl", f"solid map\n{facets}endsolid map\n")
    assert result.area == pytest.approx(BOX_AREA / 100, rel=1e-4)
    assert len(result.surface.vertices) == 8
    assert result.notes == []


def test_binary_map_coordinates_are_questioned(read):
    """The file has lost what is finer than half a metre, before it is read."""
    corners = (np.array(CORNERS)[np.array(TRIANGLES)] + [448000, 5412345, 312]).astype("<f4")
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in corners)
    notes = read("map.stl", b"map".ljust(80) + struct.pack("<I", len(corners)) + facets).notes
    assert "rounded by up to 250 mm in the file itself, which has single precision" in notes[0]


def test_bytes_behind_the_end_are_named(read):
    result = read("box.stl", binary() + b"\0" * 7)
    assert result.area == pytest.approx(BOX_AREA)
    assert "7 bytes" in result.notes[0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (binary()[:-1], "is cut off: 12 triangles take 684 bytes, but it has 683"),
        (text()[:-40], "is cut off"),
        (text().replace("   vertex 0.000000e+00 0.000000e+00 0.000000e+00\n", "", 1), "facet 1 has 2 corners"),
        (text().replace("4.000000e+00", "four"), "expected 3 numbers"),
        (b"nonsense", "is no STL file"),
        (binary()[:84].replace(struct.pack("<I", 12), struct.pack("<I", 0)), "holds no triangles"),
        (binary().replace(struct.pack("<f", 4.0), struct.pack("<f", np.nan)), "not finite"),
    ],
)
def test_damage_is_one_line_that_names_the_file(read, content, message):
    with pytest.raises(DataError, match=message) as caught:
        read("box.stl", content)
    assert "box.stl" in str(caught.value)
