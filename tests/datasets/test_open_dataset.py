import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from uncle.datasets import open_dataset, reader_specs, recognise
from uncle.datasets.registry import ReaderSpec, register_reader, unregister_reader
from uncle.recon.core.errors import DataError

LAYOUTS = {
    "folder": ("camera.json", "color/0.png"),
    "senfunet": ("1/left_rgb/0.png",),
    "replica": ("results/frame000000.jpg",),
    "7scenes": ("seq-01/frame-000000.color.png",),
    "tum": ("rgb.txt", "depth.txt"),
    "scannet": ("frames/color/0.jpg", "frames/pose/0.txt"),
}

FORMATS = tuple(reader_specs())


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


class Bag:
    """A reader as an object: of folders that hold a file `made.bag`."""

    def __init__(self, recording=None, error=None):
        self.recording, self.error = recording, error

    def matches(self, path):
        if self.error:
            raise self.error
        return (path / "made.bag").exists()

    def read(self, path):
        return self.recording


@pytest.fixture
def add_reader():
    names = []

    def add(name, reader):
        register_reader(ReaderSpec(name, "made.bag", "bags", reader))
        names.append(name)

    yield add
    for name in names:
        unregister_reader(name)


def test_a_reader_that_was_added_is_recognised_after_those_of_the_package(tmp_path, add_reader):
    add_reader("bag", Bag(recording="the recording"))
    touch(tmp_path, "made.bag")
    assert recognise(tmp_path) == "bag"
    assert open_dataset(tmp_path) == "the recording"
    assert recognise(touch(tmp_path, *LAYOUTS["tum"])) == "tum"
    assert open_dataset(tmp_path, "bag") == "the recording"


def test_the_name_of_a_reader_is_taken_once(add_reader):
    with pytest.raises(DataError, match="'tum' already"):
        add_reader("tum", Bag())
    with pytest.raises(DataError, match="not a reader that was added"):
        unregister_reader("tum")


def test_a_broken_reader_is_reported_and_costs_only_itself(tmp_path, add_reader):
    add_reader("a-broken", Bag(error=RuntimeError("no such field")))
    add_reader("bag", Bag())
    events = []
    assert recognise(touch(tmp_path, "made.bag"), events.append) == "bag"
    assert [event.text for event in events] == ["skipped the reader 'a-broken': RuntimeError: no such field"]


def test_names_of_the_formats_cost_no_heavy_import():
    code = (
        "import sys, uncle.datasets; print(uncle.datasets.reader_specs(), 'torch' in sys.modules, 'cv2' in sys.modules)"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip().endswith("False False")
