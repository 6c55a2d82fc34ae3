"""Samples that the program itself writes: a run directory with all results, the state of a broken map, training data.

They take half a minute, so that they are kept in a folder for all processes of a call.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import numpy as np
from click.testing import CliRunner
from uncle.cli.main import main
from uncle.datasets.registry import open_dataset
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.events import Event, Progress
from uncle.recon.methods.pretrain.depth_pairs import DepthPairs
from uncle.recon.methods.pretrain.senfunet_scenes import Scene, save_scenes
from uncle.recon.methods.pretrain.true_distance import TrueDistance
from uncle.recon.run.directory import RunDirectory
from uncle.recon.stages import map as map_stage
from uncle.recon.stages.map import map_run

from .corpus import CAMERA, datasets, encoded, views
from .samples import Sample

QUICK = (
    "fusion.voxel_size_m=0.1", "fusion.passes=1", "fusion.min_observations=1", "keyframes.rays=100",
    "field.iterations=3", "field.rays=64", "uncertainty.steps_per_keyframe=2", "uncertainty.steps_per_pass=10",
    "uncertainty.batch=128", "photometric.enabled=false",
)  # fmt: skip
SETTINGS = tuple(word for setting in QUICK for word in ("--set", setting))
SHIPPED = Path(sys.modules[make_config.__module__].__file__ or "").parents[2] / "methods"


class _BrokenError(Exception):
    """Ends a map as a lost process would."""


def build(folder: Path) -> None:
    """Write the samples below `folder`, unless they are there."""
    if (folder / "done").exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    recording, run = folder / "recording", folder / "run"
    datasets()[0].write(recording)
    _uncle("preprocess", recording, "--run", run, "--force")
    _uncle("map", "--run", run, "--device", "cpu", "--track", *SETTINGS)
    _uncle("mesh", "--run", run)
    _uncle("eval", "--run", run, "--samples", "500", "--views", "2")
    shutil.rmtree(run / "snapshots", ignore_errors=True)
    broken = folder / "broken"
    _uncle("preprocess", recording, "--run", broken, "--force")
    _break(RunDirectory(broken))
    data = folder / "data"
    data.mkdir()
    DepthPairs.collect([("room", _WithTruth(recording))], "sl", 4).save(data / "pairs.npz")
    _save_scene(data / "scenes.npz")
    (folder / "done").touch()


def run_sample(folder: Path, name: str = "run") -> Sample:
    """A run directory, "run", or one with an unfinished map, "broken"."""
    return Sample.read(name, folder / name)


def training_data(folder: Path, name: str) -> list[Sample]:
    """The file of depth pairs, "pairs.npz", or of scenes, "scenes.npz"."""
    return [Sample(name, {name: (folder / "data" / name).read_bytes()}, name)]


def tensor_files(folder: Path) -> list[Sample]:
    """A file of every kind of tensors that users name in options and settings."""
    paths = [folder / "run" / "map" / "noise_model.pt", *(
        next((SHIPPED / method / "weights").glob("*.pt")) for method in ("confidence", "nice", "senfunet")
    )]  # fmt: skip
    names = ("noise.pt", "confidence.pt", "decoders.pt", "senfunet.pt")
    return [Sample(name, {name: path.read_bytes()}, name) for name, path in zip(names, paths, strict=True)]


class _WithTruth:
    """The recording, whose second sensor passes for the true depth."""

    sensors = ("sl", "gt")

    def __init__(self, path: Path) -> None:
        self.recording = open_dataset(path)

    def __len__(self) -> int:
        return len(self.recording)

    def depth(self, index: int, sensor: str) -> object:
        return self.recording.depth(index, "tof" if sensor == "gt" else sensor)


def _save_scene(path: Path) -> None:
    depth = np.stack([np.round(view.depth * 1000).astype(np.uint16) for view in views()])
    jpegs = [np.frombuffer(encoded(".jpg", view.color), np.uint8) for view in views()]
    truth = TrueDistance(np.zeros((8, 8, 8), np.int8), np.zeros(3), 0.1, 0.3)
    camera = Camera(*vars(CAMERA).values())
    save_scenes(path, [Scene(camera, {"sl": depth}, jpegs, np.stack([view.pose for view in views()]), truth)])


def _break(run: RunDirectory) -> None:
    """Map until the third frame of the integration pass, with a checkpoint after each frame."""

    def on_event(event: Event) -> None:
        if isinstance(event, Progress) and event.stage.startswith("integrating") and event.done == 2:
            raise _BrokenError

    original = map_stage.Checkpoint
    map_stage.Checkpoint = lambda path, digest: original(path, digest, 0.0)  # type: ignore[assignment,misc]
    try:
        map_run(run, config(), on_event=on_event)
    except _BrokenError:
        return
    finally:
        map_stage.Checkpoint = original  # type: ignore[misc]
    raise RuntimeError("the map was not broken off: it has no stage `integrating`")


def config(method: str = "uncle") -> object:
    """Settings with which a map takes a second."""
    overrides = ["tracking.enabled=true", *QUICK] if method == "uncle" else list(QUICK[:1])
    return make_config(method, overrides, device="cpu", sensors=())


def _uncle(*arguments: object) -> None:
    result = CliRunner().invoke(main, [os.fspath(a) if isinstance(a, Path) else str(a) for a in arguments])
    if result.exit_code:
        raise RuntimeError(f"{arguments}: {result.output}") from result.exception
