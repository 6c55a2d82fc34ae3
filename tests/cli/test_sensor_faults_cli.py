"""A sensor that fails in the middle of a recording, from the images to the mesh, as a user meets it."""

import json
from pathlib import Path

import cv2
import numpy as np
from click.testing import CliRunner, Result
from uncle.cli.main import main
from uncle.datasets.synth.write import SynthOptions, make_dataset

FRAMES = 20
FAULTS = {8: "frozen", 12: "zero", 16: "shifted"}  # from a frame on
QUICK = [
    "fusion.voxel_size_m=0.04",
    "fusion.min_observations=2",
    "field.iterations=5",
    "field.rays=256",
    "keyframes.rays=500",
    "uncertainty.steps_per_pass=60",
]


def uncle(*arguments: object) -> Result:
    result = CliRunner().invoke(main, list(map(str, arguments)))
    assert result.exit_code == 0, result.output
    return result


def map_and_score(data: Path, run: Path) -> tuple[str, dict, float]:
    """What was said, `sensors.json`, and the F-score at 5 cm."""
    overrides = [word for override in QUICK for word in ("--set", override)]
    uncle("preprocess", data, "--run", run)
    said = uncle("map", "--run", run, "--device", "cpu", *overrides).stderr
    uncle("mesh", "--run", run)
    uncle("eval", "--run", run)
    metrics = json.loads((run / "metrics.json").read_text())
    scores = {score["threshold_m"]: score["f_score"] for score in metrics["surface"]["mesh"]["scores"]}
    return said, json.loads((run / "sensors.json").read_text())["sensors"], scores[0.05]


def spoil(data: Path, folder: str) -> None:
    images = sorted((data / "1" / folder).glob("*.png"), key=lambda path: int(path.stem))
    assert len(images) == FRAMES
    fault = ""
    for index, path in enumerate(images):
        fault = FAULTS.get(index, fault)
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if fault == "frozen":
            depth = cv2.imread(str(images[min(FAULTS) - 1]), cv2.IMREAD_UNCHANGED)
        elif fault:
            depth = np.where(depth > 0, depth + 200, 0) if fault == "shifted" else depth * 0
        cv2.imwrite(str(path), depth.astype(np.uint16))


def test_faults_are_reported_and_the_map_survives(tmp_path):
    room = make_dataset(tmp_path / "room", SynthOptions(frames=FRAMES, size_px=128, sensors=("sl", "sgm")))
    said, sensors, sound = map_and_score(room, tmp_path / "sound")
    assert "left out" not in said
    assert all(facts["used_frames"] == FRAMES and not facts["faults"] for facts in sensors.values())
    spoil(room, "left_sgm_depth")
    said, sensors, spoilt = map_and_score(room, tmp_path / "spoilt")
    assert sensors["sgm"]["sentences"] == [
        "sgm: no measurements from frame 12 to 15",
        "sgm: frozen from frame 8 to 11, left out",
        "sgm: inconsistent with the map from frame 16 to 19, left out",
    ]
    assert all(sentence in said for sentence in sensors["sgm"]["sentences"])
    assert (sensors["sgm"]["used_frames"], sensors["sl"]["used_frames"]) == (8, FRAMES)
    facts = json.loads((tmp_path / "spoilt/manifest.json").read_text())["stages"]["map"]["facts"]
    assert facts["faulty_frames"] == {"sgm": {"frozen": 4, "missing": 4, "inconsistent": 4}}
    assert spoilt > sound - 0.02
