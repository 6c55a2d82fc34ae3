import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from uncle.datasets import FORMATS, open_dataset, recognise
from uncle.recon.core.errors import DataError

LAYOUTS = {
    "folder": ("camera.json", "color/0.png"),
    "senfunet": ("1/left_rgb/0.png",),
    "replica": ("results/frame000000.jpg",),
    "7scenes": ("seq-01/frame-000000.color.png",),
    "tum": ("rgb.txt", "depth.txt"),
    "scannet": ("frames/color/0.jpg", "frames/pose/0.txt"),
}


def touch(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    return root


@pytest.mark.parametrize("format", FORMATS)
def test_each_format_is_recognised_by_its_folder(tmp_path, format):
    assert recognise(touch(tmp_path, *LAYOUTS[format])) == format


def test_every_format_is_described_in_the_docs():
    text = (Path(__file__).resolve().parents[2] / "docs" / "data-formats.md").read_text()
    assert set(FORMATS) <= set(re.findall(r"^\| `([^`]+)`", text, re.MULTILINE))


def test_unknown_layout_says_what_was_looked_for(tmp_path):
    touch(tmp_path, "holiday/photo.jpg")
    with pytest.raises(DataError, match=r"left_rgb.*rgb\.txt.*--format") as caught:
        open_dataset(tmp_path)
    assert "\n" not in str(caught.value)


def test_missing_empty_and_file(tmp_path):
    with pytest.raises(DataError, match="does not exist"):
        open_dataset(tmp_path / "nowhere")
    with pytest.raises(DataError, match="empty folder"):
        open_dataset(tmp_path)
    with pytest.raises(DataError, match="is a file"):
        open_dataset(touch(tmp_path, "a.bag") / "a.bag")


def test_unknown_format_name_lists_the_known(tmp_path):
    with pytest.raises(DataError, match="7scenes"):
        open_dataset(touch(tmp_path, "x"), "kitti")


@pytest.mark.parametrize("format", FORMATS)
def test_forced_format_on_another_folder_is_an_error(tmp_path, format):
    with pytest.raises(DataError, match=re.escape(str(tmp_path))):
        open_dataset(touch(tmp_path, "photo.jpg"), format)


@pytest.mark.parametrize("format", FORMATS)
def test_right_layout_without_content_is_an_error(tmp_path, format):
    with pytest.raises(DataError):
        open_dataset(touch(tmp_path, *LAYOUTS[format]))


def test_forced_format_wins_over_recognition(write_folder, room):
    folder = write_folder()
    room.write_matrix(folder / "pose" / "0000.txt", np.eye(4))
    assert open_dataset(folder).format == "folder"
    assert open_dataset(folder, "scannet").format == "scannet"


def test_names_of_the_formats_cost_no_heavy_import():
    code = "import sys, uncle.datasets; print(uncle.datasets.FORMATS, 'torch' in sys.modules, 'cv2' in sys.modules)"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip().endswith("False False")
