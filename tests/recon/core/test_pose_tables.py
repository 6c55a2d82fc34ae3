"""The same poses, written by different tools."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.recon.core.errors import DataError
from uncle.recon.core.pose_tables import read_pose, read_pose_table

COUNT = 6
TIMES = 1_700_000_000.25 + 0.1 * np.arange(COUNT)
POSES = np.tile(np.eye(4), (COUNT, 1, 1))
POSES[:, :3, :3] = Rotation.from_rotvec(np.outer(np.arange(COUNT) + 2, [0.1, 0.2, -0.3])).as_matrix()
POSES[:, :3, 3] = np.outer(np.arange(COUNT) + 2, [0.5, -0.25, 0.125])
XYZ, QUATERNIONS = POSES[:, :3, 3], Rotation.from_matrix(POSES[:, :3, :3]).as_quat()
W_FIRST = QUATERNIONS[:, [3, 0, 1, 2]]
NS = np.round(TIMES * 1e9).astype(np.int64)


def lines(*columns, separator=" "):
    """A line for each pose, of the numbers of all `columns` (N, ...)."""
    rows = [[value for column in columns for value in np.ravel(column[index]).tolist()] for index in range(COUNT)]
    return "".join(separator.join(map(str, row)) + "\n" for row in rows)


def numbered(form, rows):
    """Each of the `rows` after its number in the given form."""
    return "".join(f"{form.format(number)} {row}\n" for number, row in zip(IDS, rows.splitlines(), strict=True))


def block(pose):
    return "".join(" ".join(map(str, row)) + "\n" for row in pose)


def euler():
    return Rotation.from_matrix(POSES[:, :3, :3]).as_euler("xyz")


EUROC_HEADER = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
    "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1]\n"
)
RTABMAP_HEADER = "#timestamp x y z qx qy qz qw id\n"
ZEROS = np.zeros((COUNT, 3))
IDS = np.arange(COUNT) + 1
SECONDS = {
    "tum": lines(TIMES, XYZ, QUATERNIONS),
    "tum-commas": "# timestamp tx ty tz qx qy qz qw\n" + lines(TIMES, XYZ, QUATERNIONS, separator=","),
    "tum-decimal-commas": lines(TIMES, XYZ, QUATERNIONS).replace(".", ","),
    "tum-quaternion-first": lines(TIMES, W_FIRST, XYZ),
    "rtabmap": RTABMAP_HEADER + lines(TIMES, XYZ, QUATERNIONS, IDS),
    "rtabmap-no-header": lines(TIMES, XYZ, QUATERNIONS, IDS),
    "nanoseconds": lines(NS, XYZ, QUATERNIONS),
    "euroc": EUROC_HEADER + lines(NS, XYZ, W_FIRST, ZEROS, separator=","),
    "euroc-no-header": lines(NS, XYZ, W_FIRST, ZEROS, separator=","),
    "named-seconds": "t,qw,qx,qy,qz,tx,ty,tz\n" + lines(TIMES, W_FIRST, XYZ, separator=","),
}
NUMBERED = {
    "kitti-360": lines(IDS, POSES[:, :3]),
    "kitti-360-4x4": lines(IDS, POSES),
    "open3d": "".join(f"{number} {number} {COUNT}\n{block(pose)}" for number, pose in zip(IDS, POSES, strict=True)),
    "g2o": numbered("VERTEX_SE3:QUAT {}", lines(XYZ, QUATERNIONS)) + "FIX 1\nEDGE_SE3:QUAT 1 2 0 0 0 0 0 0 1 1 0 0\n",
    "toro": numbered("VERTEX3 {}", lines(XYZ, euler())),
    "names": numbered("rgb/frame_{:03d}.png", lines(XYZ, QUATERNIONS)),
}
COUNTED = {
    "kitti": lines(POSES[:, :3]),
    "4x4": lines(POSES),
    "vectors": lines(XYZ, QUATERNIONS),
    "blocks": "\n".join(block(pose) for pose in POSES),
}


def read(tmp_path, text):
    (tmp_path / "poses.any").write_text(text)
    table = read_pose_table(tmp_path / "poses.any")
    np.testing.assert_allclose([pose.T_world_camera for pose in table.poses], POSES, atol=1e-6)
    return table


@pytest.mark.parametrize("name", SECONDS)
def test_formats_with_time_stamps(tmp_path, name):
    table = read(tmp_path, SECONDS[name])
    unit_s = 1e-9 if "nano" in name or "euroc" in name else 1.0
    assert table.are_times
    assert table.unit_s == (1e-9 if name == "euroc" else None)
    np.testing.assert_allclose(table.labels * unit_s, TIMES, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", NUMBERED)
def test_formats_with_frame_numbers(tmp_path, name):
    table = read(tmp_path, NUMBERED[name])
    assert not table.are_times
    if name == "names":
        assert table.names == tuple(f"rgb/frame_{number:03d}.png" for number in IDS)
    else:
        np.testing.assert_array_equal(table.labels, IDS)


@pytest.mark.parametrize("name", COUNTED)
def test_formats_with_neither(tmp_path, name):
    table = read(tmp_path, COUNTED[name])
    assert table.labels is None
    assert table.names == ()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("euroc-no-header", "is read as EuRoC, `tx ty tz qw qx qy qz`"),
        ("euroc-no-header", "columns behind the first 8 are not used"),
        ("tum-quaternion-first", "its first four numbers are unit quaternions"),
        ("g2o", "matched by their ids"),
    ],
)
def test_what_is_assumed_is_named(tmp_path, name, words):
    notes = read(tmp_path, (SECONDS | NUMBERED)[name]).notes
    assert any(words in note for note in notes)


@pytest.mark.parametrize("name", ["tum", "euroc", "rtabmap", "named-seconds"])
def test_what_the_file_says_needs_no_note(tmp_path, name):
    assert read(tmp_path, SECONDS[name]).notes == ()


def test_poses_that_cannot_be_used_have_a_reason(tmp_path):
    rows = SECONDS["tum"].splitlines()
    rows[1] = f"{TIMES[1]} 1e300 0 0 0 0 0 1"
    rows[2] = f"{TIMES[2]} 0 0 0 0 0 0 0"
    rows[4] = f"{TIMES[4]} nan nan nan nan nan nan nan"
    (tmp_path / "a.tum").write_text("\n".join(rows))
    table = read_pose_table(tmp_path / "a.tum")
    poses = table.poses
    assert np.isnan(table.T_world_camera).all(axis=(1, 2)).tolist() == [False, True, True, False, True, False]
    assert len(table.remarks) == 1
    assert table.remarks[0].startswith("3 of 6 poses cannot be used (the first: ")
    for index, reason in ((1, "too large"), (2, "has the length 0"), (4, "not finite")):
        assert f"a.tum, line {index + 1}: " in poses[index].remark
        assert reason in poses[index].remark


@pytest.mark.parametrize(
    "row", ["2 0 0 0 0 2 0 0 0 0 2 0", "1e200 0 0 0 0 1 0 0 0 0 1 0", "1 0 0 1e300 0 1 0 0 0 0 1 0"]
)
def test_matrices_that_are_no_poses_have_a_reason(tmp_path, row):
    (tmp_path / "a.txt").write_text(f"{row}\n1 0 0 5 0 1 0 6 0 0 1 7\n")
    poses = read_pose_table(tmp_path / "a.txt").poses
    assert poses[0].T_world_camera is None
    assert poses[0].remark.startswith(f"{tmp_path / 'a.txt'}, line 1: its ")
    assert poses[1].T_world_camera[:3, 3].tolist() == [5, 6, 7]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no poses"),
        ("# timestamp tx ty tz qx qy qz qw\n", "holds no poses"),
        ("1 2 3\n4 5 6\n", "expected poses"),
        (SECONDS["tum"] + "1 2 3\n", "line 7: expected poses"),
        (SECONDS["tum"].replace("1.5", "x"), "is no number"),
        ("1 0 0 0 0.5 0.1 0 0\n2 0 0 0 0.5 0.1 0 0\n", "no four of its numbers are a unit quaternion"),
        ("2 0 0 0 0 2 0 0 0 0 2 0\n" * 3, "none of the 3 poses of .* can be used"),
        ("nan " * 12, "line 1: its numbers are not finite"),
        ("VERTEX_SE2 0 1 2 3\n", "a graph without poses in space"),
        ("VERTEX_SE3:QUAT 0 1 2 3\n", "line 1: expected 8 numbers"),
    ],
)
def test_damage_is_one_line_that_names_the_file(tmp_path, text, message):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        read_pose_table(tmp_path / "a.txt")
    assert "a.txt" in str(caught.value)


def test_motions_between_pairs_of_frames_are_no_trajectory(tmp_path):
    matrix = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    (tmp_path / "pairs.log").write_text("".join(f"0 {i} 9\n{matrix}" for i in range(1, 4)))
    with pytest.raises(DataError, match="motions between pairs of frames are no trajectory"):
        read_pose_table(tmp_path / "pairs.log")


def one_pose(kind: str) -> str:
    """The fourth of `POSES` as the text of a file of its own."""
    pose = POSES[3]
    rows = [" ".join(f"{value:.9f}" for value in row) for row in pose]
    return {
        "4x4": "\n".join(rows),
        "3x4": "\n".join(rows[:3]),
        "one line": " ".join(rows),
        "12 numbers": " ".join(rows[:3]),
        "decimal comma": "\r\n".join(rows).replace(".", ","),
        "csv": "\n".join(row.replace(" ", ",") for row in rows),
        "semicolons": "\n".join(row.replace(".", ",").replace(" ", ";") for row in rows),
        "brackets": str(pose.tolist()),
        "fortran": "\n".join(" ".join(f"{value:.9E}".replace("E", "D") for value in row) for row in pose),
        "byte order mark": "\ufeff" + "\n".join(rows),
        "comment": "# camera to world\n" + "\n".join(rows) + "\n\n",
        "transposed": block(pose.T),
        "quaternion": " ".join(map(str, [*XYZ[3], *QUATERNIONS[3]])),
        "quaternion first": " ".join(map(str, [*W_FIRST[3], *XYZ[3]])),
    }[kind]


MATRICES = ["4x4", "3x4", "one line", "12 numbers", "decimal comma", "csv", "semicolons", "brackets", "fortran"]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize(
    "kind", [*MATRICES, "byte order mark", "comment", "transposed", "quaternion", "quaternion first"]
)
def test_a_file_of_one_pose(tmp_path, kind, encoding):
    (tmp_path / "p.txt").write_bytes(one_pose(kind).encode(encoding))
    pose = read_pose(tmp_path / "p.txt")
    np.testing.assert_allclose(pose.T_world_camera, POSES[3], atol=1e-6)


def test_a_file_of_anything_else_has_its_reason(tmp_path):
    (tmp_path / "p.txt").write_text("1 2 3\n")
    pose = read_pose(tmp_path / "p.txt")
    assert pose.T_world_camera is None
    assert "p.txt, line 1: expected a 4x4 or 3x4 matrix" in pose.remark


def test_the_identity_at_the_start_tells_the_order_of_a_quaternion(tmp_path):
    start = np.array([0.0, 0, 0, 1, 0, 0, 0])
    rows = [start, *np.hstack([XYZ, W_FIRST])]
    (tmp_path / "t.txt").write_text("".join(" ".join(map(str, [i, *row])) + "\n" for i, row in enumerate(rows)))
    table = read_pose_table(tmp_path / "t.txt")
    np.testing.assert_allclose(table.T_world_camera, [np.eye(4), *POSES], atol=1e-6)
    assert "the identity" in table.notes[0]
