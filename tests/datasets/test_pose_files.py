from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.datasets.pose_files import poses_of_files, poses_of_table
from uncle.recon.core.errors import DataError

COUNT = 6
STEMS = [f"{index:04d}" for index in range(COUNT)]


@pytest.fixture(scope="module")
def poses(room) -> list[np.ndarray]:
    return room.poses(COUNT)


def row(pose: np.ndarray) -> str:
    values = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
    return " ".join(f"{value:.9f}" for value in values)


def matrix_row(pose: np.ndarray) -> str:
    return " ".join(f"{value:.9f}" for value in pose.ravel())


def assert_poses(found, expected) -> None:
    for pose, truth in zip(found, expected, strict=True):
        assert (pose.T_world_camera is None) == (truth is None), pose.remark
        if truth is not None:
            np.testing.assert_allclose(pose.T_world_camera, truth, atol=1e-6)


@pytest.mark.parametrize("stems", [STEMS, [f"frame_{index}" for index in range(COUNT)]])
@pytest.mark.parametrize("name", ["{:04d}.txt", "pose_{}.csv", "{:06d}.pose", "{:04d}.TXT"])
def test_pose_files_match_images_by_name_or_number(tmp_path, poses, stems, name):
    for index in (0, 1, 2, 4, 5, 9):
        (tmp_path / name.format(index)).write_text(matrix_row(poses[index % COUNT]))
    found = poses_of_files(tmp_path, stems)
    assert_poses(found.poses, [*poses[:3], None, *poses[4:]])
    assert found.notes[0].startswith("1 of 6 pose files belong to no image (the first: ")


def test_pose_files_that_are_not_read_are_named(tmp_path):
    (tmp_path / "0000.xml").touch()
    assert "0000.xml" in poses_of_files(tmp_path, STEMS).notes[0]
    (tmp_path / "left.txt").touch()
    with pytest.raises(DataError, match=r"no pose file is called like an image \(files like left\.txt"):
        poses_of_files(tmp_path, STEMS)


def write_table(path, rows):
    path.write_text("\n".join(rows) + "\n")
    return path


def test_numbers_of_poses_are_those_of_the_images(tmp_path, poses):
    file = write_table(tmp_path / "poses.txt", [f"{i + 1} {row(pose)}" for i, pose in enumerate(poses)])
    ones = [f"{index + 1:04d}" for index in range(COUNT)]
    assert_poses(poses_of_table(file, ones, None).poses, poses)
    tens = write_table(tmp_path / "tens.txt", [f"{10 * i} {matrix_row(pose)}" for i, pose in enumerate(poses)])
    assert_poses(poses_of_table(tens, [f"rgb{10 * i}" for i in range(COUNT)], None).poses, poses)
    with pytest.raises(DataError, match=r"poses from 1 to 6, images from 0 to 5\), so it cannot be told"):
        poses_of_table(file, STEMS, None)
    twice = write_table(tmp_path / "twice.txt", [f"{i // 2} {row(pose)}" for i, pose in enumerate(poses)])
    with pytest.raises(DataError, match=r"3 of its 6 poses have the number of another; or remove twice\.txt"):
        poses_of_table(twice, STEMS, None)


def test_numbers_that_only_count_are_named(tmp_path, poses):
    file = write_table(tmp_path / "poses.txt", [f"{i} {row(pose)}" for i, pose in enumerate(poses)])
    found = poses_of_table(file, [f"{index}" for index in range(500, 500 + COUNT)], None)
    assert_poses(found.poses, poses)
    assert "they count the images from 0" in found.notes[0]


def test_some_numbers_without_a_partner_are_counted(tmp_path, poses):
    file = write_table(tmp_path / "poses.txt", [f"{i} {row(poses[i])}" for i in (1, 2, 4)])
    found = poses_of_table(file, STEMS[:4], None)
    assert_poses(found.poses, [None, poses[1], poses[2], None])
    assert found.notes == (f"1 of 3 poses of {file} belong to no image",)


def test_names_of_images_in_the_table(tmp_path, poses):
    lines = [f"color\\{stem}.png,{row(pose).replace(' ', ',')}" for stem, pose in zip(STEMS, poses, strict=True)]
    assert_poses(poses_of_table(write_table(tmp_path / "p.csv", lines[::-1]), STEMS, None).poses, poses)


@pytest.mark.parametrize("head", ["", "# camera to world\n", "% x\n\n"])
def test_lines_without_numbers_belong_to_images_in_order(tmp_path, poses, head):
    file = tmp_path / "traj.txt"
    file.write_text(head + "\n".join(map(matrix_row, poses)))
    for stems, is_noted in ((STEMS, False), ([str(i + 1) for i in range(COUNT)], True), (["3", "5", "8"] * 2, False)):
        found = poses_of_table(file, stems, None)
        assert_poses(found.poses, poses)
        assert bool(found.notes) == is_noted


def test_lines_without_numbers_for_some_of_the_images(tmp_path, poses):
    file = write_table(tmp_path / "traj.txt", map(matrix_row, poses))
    found = poses_of_table(file, ["0", "2", "5"], None)
    assert_poses(found.poses, [poses[0], poses[2], poses[5]])
    assert "line n belongs to image number n, from 0" in found.notes[0]
    with pytest.raises(DataError, match="holds 6 poses without number or time stamp, but there are 8 images"):
        poses_of_table(file, [str(i + 1) for i in range(8)], None)


START = 1.6e9


@pytest.mark.parametrize("unit", [1e9, 1e6, 1e3])
def test_time_stamps_of_another_unit_are_recognised(tmp_path, poses, unit):
    lines = [f"{round((START + i / 20) * unit)} {row(pose)}" for i, pose in enumerate(poses)]
    found = poses_of_table(write_table(tmp_path / "t.txt", lines), STEMS, START + np.arange(COUNT) / 20)
    assert_poses(found.poses, poses)
    assert "seconds" in found.notes[0]


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (START + np.arange(COUNT), "its time stamps are 1.000 s apart, .* not interpolated across more than 0.080 s"),
        (START + 3600 + np.arange(COUNT) / 20, "1 hours apart, which looks like another time zone"),
        (np.arange(COUNT) / 20, "one clock counts from 1970"),
        (START - 5000 + np.arange(COUNT) / 20, "they lie 5000 s apart"),
    ],
)
def test_poses_that_do_not_meet_the_images_name_the_true_reason(tmp_path, poses, times, message):
    lines = [f"{time:.4f} {row(pose)}" for time, pose in zip(times, poses, strict=True)]
    with pytest.raises(DataError, match=message + r".*; or remove t\.txt to go on without poses"):
        poses_of_table(write_table(tmp_path / "t.txt", lines), STEMS, START + 0.5 + np.arange(COUNT) / 20)


def test_time_stamps_in_the_names_of_images(tmp_path, poses):
    times = [9.5 + index / 20 for index in range(COUNT)]
    lines = [f"{time:.4f} {row(pose)}" for time, pose in zip(times, poses, strict=True)]
    file = write_table(tmp_path / "t.txt", lines)
    assert_poses(poses_of_table(file, [f"{time:.2f}" for time in times], None).poses, poses)
    found = poses_of_table(file, [f"{time + 0.025:.4f}" for time in times[:-1]], None)
    middle = [(a[:3, 3] + b[:3, 3]) / 2 for a, b in pairwise(poses)]
    np.testing.assert_allclose([pose.T_world_camera[:3, 3] for pose in found.poses], middle, atol=1e-6)


def test_all_lines_unusable_are_counted(tmp_path):
    lines = [f"{START + i:.3f} nan nan nan 0 0 0 1" for i in range(COUNT)]
    with pytest.raises(DataError, match=r"none of the 6 poses of .* \(the first: .*t\.txt, line 1: its numbers"):
        poses_of_table(write_table(tmp_path / "t.txt", lines), STEMS, START + np.arange(COUNT))
