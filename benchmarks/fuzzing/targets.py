"""What is tried: how to hand an input to the program, and what makes its result right."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
import cv2
import numpy as np
import torch
from click.testing import CliRunner
from uncle.cli.main import main
from uncle.datasets import camera_files, images, open_dataset, pose_files
from uncle.datasets.calibration import Calibration
from uncle.datasets.depth_units import DepthUnits
from uncle.recon.core.config.map_config import known_keys, make_config
from uncle.recon.core.depth_image import read_depth_values
from uncle.recon.core.errors import DataError
from uncle.recon.core.events import Event
from uncle.recon.core.files import read_image
from uncle.recon.core.mesh import Mesh, load_surface
from uncle.recon.core.pose_tables import read_pose, read_pose_table
from uncle.recon.core.text import read_text
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.evaluation.bench.records import load_records
from uncle.recon.methods.confidence.models import ConfidenceModels
from uncle.recon.methods.nice.decoder_files import load_decoders
from uncle.recon.methods.pretrain.depth_pairs import DepthPairs
from uncle.recon.methods.pretrain.senfunet_scenes import load_scenes
from uncle.recon.methods.senfunet.models import SenfunetModel
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames
from uncle.recon.run.tracking_record import TrackingRecord
from uncle.recon.sensors.noise_prior import NoisePrior
from uncle.recon.stages.map import load_field

from . import corpus, runs
from .samples import Sample


class WrongResultError(Exception):
    """A result that cannot be right, or a message that is not one line."""


@dataclass(frozen=True)
class Target:
    """One way into the program.

    name      for reports
    samples   valid inputs, given the folder with those that the program writes
    call      hands it the path of an input; raises UncleError or ClickException if it is refused,
              WrongResultError if what comes back cannot be right
    """

    name: str
    samples: Callable[[Path], list[Sample]]
    call: Callable[[Path], None]


def expect(condition: object, what: str) -> None:
    """Raises WrongResultError unless `condition`."""
    if not condition:
        raise WrongResultError(what)


# --- files -----------------------------------------------------------------------------------------------------------
def _pose_table(path: Path) -> None:
    table = read_pose_table(path)
    expect(table.T_world_camera.shape == (len(table), 4, 4) and len(table) > 0, "shape of the poses")
    usable = table.T_world_camera[np.isfinite(table.T_world_camera).all(axis=(1, 2))]
    _expect_rigid(usable)
    expect(table.labels is None or table.labels.shape == (len(table),), "a label for each pose")
    expect(not table.names or len(table.names) == len(table), "a name for each pose")


def _expect_rigid(poses: np.ndarray) -> None:
    rotations = poses[:, :3, :3]
    expect(np.allclose(np.swapaxes(rotations, 1, 2) @ rotations, np.eye(3), atol=1e-6), "rotations")


def _frame_poses(path: Path) -> None:
    """As a reader asks: poses of four images with names and time stamps."""
    stems, stamps = [f"{i:04d}" for i in range(4)], 10 + 0.1 * np.arange(4)
    for times in (None, stamps):
        found = pose_files.poses_of_table(path, stems, times)
        expect(len(found.poses) == 4, "a pose for each image")
        _expect_usable([pose.T_world_camera for pose in found.poses])


def _expect_usable(poses: Sequence[np.ndarray | None]) -> None:
    known = [pose for pose in poses if pose is not None]
    expect(np.isfinite(known).all(), "finite poses")
    if known:
        _expect_rigid(np.array(known))


def _single_pose(path: Path) -> None:
    pose = read_pose(path)  # a pose that cannot be read has a remark
    _expect_usable([pose.T_world_camera])
    expect(pose.T_world_camera is not None or "\n" not in pose.remark, "a remark of one line")


def _trajectory(path: Path) -> None:
    finite = Trajectory.load(path).finite()
    expect(np.isfinite(finite.T_world_camera).all() and (np.diff(finite.timestamps) >= 0).all(), "order and values")


def _camera(path: Path) -> None:
    file = camera_files.find_camera_file([path])
    if file is None:
        raise DataError(f"{path} holds no file of the camera")
    calibration = camera_files.read_camera_file(file, Calibration(corpus.CAMERA), [])
    numbers = [*vars(calibration.camera).values(), calibration.depth_units_per_m, *calibration.distortion]
    expect(all(math.isfinite(number) for number in numbers), "finite numbers")
    expect(min(calibration.camera.fx, calibration.camera.fy, calibration.depth_units_per_m) > 0, "positive numbers")


def _depth_image(path: Path) -> None:
    values = read_depth_values(path)
    expect(values.ndim == 2 and values.size and values.dtype in (np.uint16, np.int32, np.float32), "an image")
    expect((values >= 0).all(), "depth that is not negative")
    metres = DepthUnits(1000.0).metres(values)
    expect(np.isfinite(metres).all(), "finite depth")


def _color_image(path: Path) -> None:
    image = read_image(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    expect(image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8, "an image")
    images.read_color(path, corpus.CAMERA, resize=True)


def _mesh(path: Path) -> None:
    notes: list[Event] = []
    surface = load_surface(path, notes.append)
    for note in notes:
        expect("\n" not in str(vars(note)["text"]), "notes of one line")
    points = surface.vertices if isinstance(surface, Mesh) else surface.points
    expect(len(points) and np.isfinite(points).all() and points.dtype == np.float32, "finite points")
    if isinstance(surface, Mesh):
        expect(surface.faces.min() >= 0 and surface.faces.max() < len(points), "corners that exist")
        expect(surface.colors is None or surface.colors.shape == points.shape, "a colour for each vertex")
        expect(surface.sigma is None or surface.sigma.shape == (len(points),), "a sigma for each vertex")


def _settings(path: Path) -> None:
    """Lines of `--set`."""
    lines = read_text(path).split("\n")
    make_config("uncle", [line for line in lines if line])


def _settings_samples(folder: Path) -> list[Sample]:
    lines = [f"{key}={str(value).lower()}" for key, value in known_keys().items() if not isinstance(value, tuple)]
    usual = [line for line in lines if line.split("=")[1] not in ("", "none") and not line.startswith("method")]
    groups = [usual[start : start + 6] for start in range(0, len(usual), 6)]
    texts = [*groups, ["sensors=['sl', 'tof']", "fusion.voxel_size_m = 0.02", 'uncertainty.inputs=["depth"]']]
    return [Sample(f"settings-{i}", {"set.txt": "\n".join(text).encode()}, "set.txt") for i, text in enumerate(texts)]


# --- files that the program writes -----------------------------------------------------------------------------------
def _tensors(path: Path) -> None:
    if path.name == "noise.pt":
        prior = NoisePrior.load(path)
        expect(len(prior.digest) == 16, "a digest")
        prior.require_fit(prior.sensors, make_config("uncle", []).uncertainty)
    elif path.name == "confidence.pt":
        models = ConfidenceModels.load((path.parent.name,), (str(path),), torch.device("cpu"))
        expect(models.image(path.parent.name, torch.ones(32, 32)).shape == (32, 32), "an image of confidence")
    elif path.name == "decoders.pt":
        load_decoders(path)
    else:
        SenfunetModel.load(("sl", "sgm"), path)


def _pairs(path: Path) -> None:
    pairs = DepthPairs.load(path)
    expect(pairs.reading.shape == pairs.truth.shape and len(pairs.reading) == len(pairs), "images of one shape")


def _scenes(path: Path) -> None:
    for scene in load_scenes(path):
        for index in range(len(scene)):
            expect(scene.color(index).shape[2] == 3, "colour")
            for sensor in scene.depths:
                expect(scene.depth(index, sensor).ndim == 2, "depth")


def _records(path: Path) -> None:
    expect(isinstance(load_records(path), dict), "a dictionary")


def _records_samples(folder: Path) -> list[Sample]:
    text = b'{"room/sl/uncle/0": {"wall_s": 1.5, "f_score_5cm": 0.9, "session": "a"}, "b": {}}'
    return [Sample("results", {"results.json": text}, "results.json")]


def _run_files(path: Path) -> None:
    """Manifest, frames, tracking record, trajectory and map of a run, as the stages read them."""
    run = RunDirectory(path)
    run.is_current("map", "x")
    run.require_current("map", "mesh", "eval")
    frames = RunFrames(run)
    for index in range(len(frames)):
        frame = frames[index]
        shapes = {depth.shape for depth in frame.depths.values()} | {frame.color.shape[:2]}
        expect(shapes == {(frames.camera.height, frames.camera.width)}, "images of one size")
        if frame.T_world_camera is not None:
            expect(frame.T_world_camera.shape == (4, 4), "a pose of 4x4")
    if run.tracking_path.exists():
        TrackingRecord.load(run.tracking_path).lost_ranges()
    points = torch.zeros(1, 3)
    expect(torch.isfinite(load_field(run)(points)[0]).all(), "finite distances")


# --- folders ---------------------------------------------------------------------------------------------------------
def _dataset(path: Path) -> None:
    recording = open_dataset(path)
    expect(len(recording) > 0 and recording.sensors, "frames and sensors")
    for note in recording.notes:
        expect("\n" not in note, "notes of one line")
    for index in range(len(recording)):
        _expect_usable([recording.pose(index)])
        expect(math.isfinite(recording.timestamp(index)), "a finite time stamp")
        try:
            frame = recording[index]
        except DataError as error:
            expect("\n" not in str(error), "a message of one line")
            continue
        size = (recording.camera.height, recording.camera.width)
        expect(frame.color.shape == (*size, 3), "colour of the size of the camera")
        for depth in frame.depths.values():
            expect(depth.shape == size and torch.isfinite(depth).all() and (depth >= 0).all(), "finite depth")


# --- commands --------------------------------------------------------------------------------------------------------
def _command(*arguments: str, path: Path, may_fail: bool = False) -> None:
    """`uncle` with `{}` for the path. With `may_fail`, exit code 1 is a result."""
    words = [word.replace("{}", str(path)).replace("{out}", f"{path}.out") for word in arguments]
    result = CliRunner().invoke(main, ["--quiet", *words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    expect("Traceback" not in result.output, "no traceback")
    errors = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    if result.exit_code == 0 or (may_fail and result.exit_code == 1 and not errors):
        expect(not errors, "no error with exit code 0")
        return
    expect(result.exit_code in (1, 2) and len(errors) == 1, f"one line of error, found {result.stderr!r}")
    expect(result.stderr.rstrip().splitlines()[-1] == errors[0], f"nothing behind the error: {result.stderr!r}")
    raise click.ClickException(errors[0])


def _commands() -> list[Target]:
    """The commands on whole folders; the slow ones on few inputs."""

    def datasets(folder: Path) -> list[Sample]:
        return corpus.datasets()

    def run(folder: Path) -> list[Sample]:
        return [runs.run_sample(folder)]

    def broken(folder: Path) -> list[Sample]:
        return [runs.run_sample(folder, "broken")]

    def paired(samples: list[Sample]) -> list[Sample]:
        """With the undamaged file as the ground truth beside."""
        return [
            Sample(s.name, {**s.files, f"truth/{s.main}": s.files[s.main]}, s.main)
            for s in samples
            if s.main in s.files
        ]

    def trajectories(folder: Path) -> list[Sample]:
        return paired(corpus.trajectories())

    def meshes(folder: Path) -> list[Sample]:
        return paired(corpus.meshes())

    def evaluate(path: Path, options: Sequence[str] = ()) -> None:
        _command("eval", str(path), str(path.parent / "truth" / path.name), "--json", *options, path=path)

    def command(name: str, samples: Callable[[Path], list[Sample]], *words: str, may_fail: bool = False) -> Target:
        call = partial(_call_command, (name.split()[1], *words), may_fail)
        return Target(name, samples, call)

    return [
        command("uncle preprocess", datasets, "{}", "--run", "{out}", "--force"),
        command("uncle inspect", datasets, "{}", "--json", may_fail=True),
        Target("uncle eval TRAJECTORY", trajectories, evaluate),
        Target("uncle eval MESH", meshes, partial(evaluate, options=("--samples", "200"))),
        command("uncle inspect RUN", run, "{}", "--report", "{out}/page.html", may_fail=True),
        command("uncle map", run, "--run", "{}", "--overwrite", "--device", "cpu", *runs.SETTINGS),
        command("uncle map --resume", broken, "--run", "{}", "--resume", "--device", "cpu", "--track", *runs.SETTINGS),
        command("uncle mesh", run, "--run", "{}", "--overwrite"),
        command("uncle eval RUN", run, "--run", "{}", "--samples", "200", "--views", "1", "--json"),
        command("uncle uncertainty", run, "--run", "{}", "--json"),
        command("uncle report", run, "--run", "{}", "--renderer", "raycast"),
    ]


def _call_command(words: Sequence[str], may_fail: bool, path: Path) -> None:
    _command(*words, path=path, may_fail=may_fail)


def _of(make: Callable[[], list[Sample]]) -> Callable[[Path], list[Sample]]:
    return lambda folder: make()


FILES = (
    Target("poses of any tool", _of(corpus.trajectories), _pose_table),
    Target("poses of images", _of(corpus.trajectories), _frame_poses),
    Target("one pose", _of(corpus.single_poses), _single_pose),
    Target("trajectory of a run", lambda folder: corpus.trajectories()[:1], _trajectory),
    Target("camera", _of(corpus.cameras), _camera),
    Target("depth image", _of(corpus.depth_images), _depth_image),
    Target("colour image", _of(corpus.color_images), _color_image),
    Target("mesh or cloud", _of(corpus.meshes), _mesh),
    Target("settings", _settings_samples, _settings),
    Target("results of bench", _records_samples, _records),
    Target("data set", _of(corpus.datasets), _dataset),
)
WRITTEN = (
    Target("tensor files", runs.tensor_files, _tensors),
    Target("depth pairs", lambda folder: runs.training_data(folder, "pairs.npz"), _pairs),
    Target("scenes", lambda folder: runs.training_data(folder, "scenes.npz"), _scenes),
    Target("run directory", lambda folder: [runs.run_sample(folder)], _run_files),
)
TARGETS: dict[str, Target] = {target.name: target for target in (*FILES, *WRITTEN, *_commands())}
