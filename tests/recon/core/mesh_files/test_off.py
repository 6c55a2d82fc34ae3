import pytest
from uncle.recon.core.errors import DataError

from .conftest import BOX_AREA, CORNERS, QUADS, TRIANGLES


def body(tail="", faces=QUADS, face_tail=""):
    rows = "".join(f"{x} {y} {z}{tail}\n" for x, y, z in CORNERS)
    return rows + "".join(f"{len(face)} {' '.join(map(str, face))}{face_tail}\n" for face in faces)


@pytest.mark.parametrize(
    "text",
    [
        "OFF\n8 6 0\n" + body(),
        "OFF 8 6 0\n" + body(),
        "OFF8 6 0\n" + body(),
        "# a comment\nOFF\n\n8 6 # counts\n" + body(),
        "OFF\n8 9 0\n" + body(faces=[*TRIANGLES[:6], *QUADS[3:]]),
        "OFF\n8 6 0\n" + body(face_tail=" 255 0 0"),
        "NOFF\n8 6 0\n" + body(" 0 0 1"),
    ],
)
def test_every_face_is_there(read, text):
    assert read("box.off", text).area == pytest.approx(BOX_AREA)


@pytest.mark.parametrize(
    ("magic", "tail"), [("COFF", " 255 128 0 255"), ("COFF", " 1.0 0.502 0.0 1.0"), ("CNOFF", " 0 0 1 255 128 0 255")]
)
def test_colours_of_vertices(read, magic, tail):
    assert read("box.off", f"{magic}\n8 6 0\n" + body(tail)).surface.colors[0].tolist() == [255, 128, 0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("OFF\n8 7 0\n" + body(), "8 vertices and 7 faces, but only 14 lines follow"),
        ("OFF\n8 5 0\n" + body(), "1 lines more"),
        ("OFF\n8 6 0\n" + body().replace("4 1 5 7 3", "4 1 5 7 88"), "face 5 names vertex 88"),
        ("OFF\n8 6 0\n" + body().replace("4 1 5 7 3", "4 1 5 7"), "line 16: not a face"),
        ("OFF\n8 6 0\n" + body().replace("4.0 3.0 2.5", "4.0 3.0 inf"), "not finite"),
        ("OFF\n8 six 0\n" + body(), "does not name the numbers"),
        ("OFF\ninf 6 0\n" + body(), "does not name the numbers"),
        ("4OFF\n8 6 0\n" + body(" 1"), "another dimension"),
        ("ply\n", "is no OFF file"),
    ],
)
def test_damage_is_one_line_that_names_the_file(read, text, message):
    with pytest.raises(DataError, match=message) as caught:
        read("box.off", text)
    assert "box.off" in str(caught.value)
