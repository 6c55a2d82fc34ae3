"""`uncle inspect` on a recording in files: lines, JSON and exit codes."""

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from uncle.cli.main import main


@pytest.fixture
def dataset(tmp_path, box_recording):
    """The box room as a plain folder with poses."""
    root = tmp_path / "data"
    for name in ("color", "depth", "poses"):
        (root / name).mkdir(parents=True)
    (root / "camera.json").write_text(json.dumps(box_recording.camera.to_dict()))
    for index in range(len(box_recording)):
        color = cv2.cvtColor(box_recording.color(index).numpy(), cv2.COLOR_RGB2BGR)
        cv2.imwrite(str(root / f"color/{index:04d}.png"), color)
        depth = box_recording.depth(index, "depth").numpy() * 1000
        cv2.imwrite(str(root / f"depth/{index:04d}.png"), np.rint(depth).astype(np.uint16))
        np.savetxt(root / f"poses/{index:04d}.txt", box_recording.pose(index))
    return root


def invoke(*arguments):
    return CliRunner().invoke(main, [*map(str, arguments)])


def test_a_good_recording(dataset):
    result = invoke("inspect", dataset)
    assert result.exit_code == 0, result.output
    assert "wrong" not in result.stdout
    assert any(line.startswith("ok") and "depth scale" in line for line in result.stdout.splitlines())


def test_a_wrong_unit_is_named_and_mended(dataset, tmp_path):
    camera = json.loads((dataset / "camera.json").read_text())
    (dataset / "camera.json").write_text(json.dumps({**camera, "depth_scale": 5000}))
    result = invoke("inspect", dataset, "--json")
    assert result.exit_code == 1
    first = next(one for one in json.loads(result.stdout)["findings"] if one["verdict"] == "wrong")
    assert (first["check"], first["value"]) == ("depth scale", 5.0)
    stopped = invoke("preprocess", dataset, "--run", tmp_path / "run")
    assert stopped.exit_code == 1
    assert "5 times too small" in stopped.stderr
    assert invoke("preprocess", dataset, "--run", tmp_path / "run", "--fix").exit_code == 0
    assert invoke("inspect", tmp_path / "run").exit_code == 0


def test_a_folder_of_no_known_format_is_an_error_in_one_line(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    result = invoke("inspect", tmp_path)
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: cannot tell the format of")
