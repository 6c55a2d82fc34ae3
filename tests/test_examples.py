"""The examples and the snippets of docs/python.md run as they are; a package adds a method and a reader."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from uncle.datasets import open_dataset
from uncle.datasets.registry import unregister_reader
from uncle.datasets.synth.write import SynthOptions, make_dataset
from uncle.recon.core.mesh import Mesh
from uncle.recon.methods import method_spec, unregister_method
from uncle.recon.run import RunDirectory, RunFrames
from uncle.recon.sensors import load_noise_models, predict_beta
from uncle.recon.stages import map_run, preprocess_run

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
FRAMES = 6


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    options = SynthOptions(frames=FRAMES, size_px=96, sensors=("sl", "sgm"))
    return make_dataset(tmp_path_factory.mktemp("examples") / "room", options)


@pytest.fixture(scope="module")
def mapped(dataset):
    """A run with a map of the default method."""
    run, recording = RunDirectory(dataset.parent / "run"), open_dataset(dataset)
    preprocess_run(recording, run, dataset=dataset)
    settings = ["fusion.voxel_size_m=0.06", "fusion.min_observations=1", "field.iterations=2"]
    settings += ["uncertainty.steps_per_pass=50", "photometric.enabled=false"]
    map_run(run, method_spec("uncle").configure(settings, sensors=("sl", "sgm"), device="cpu"))
    return run


@pytest.fixture
def run(mapped, tmp_path):
    """A copy that a test may change."""
    return RunDirectory(shutil.copytree(mapped.root, tmp_path / "run"))


@pytest.fixture
def example(monkeypatch, capsys):
    """Runs a script as `python examples/NAME ARGUMENTS`; returns what it printed."""

    def start(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return start


def test_beta_is_plotted(mapped, tmp_path, example):
    printed = example("01_plot_beta.py", mapped.root, "--sensor", "sl", "--frame", 2, "--out", tmp_path / "beta.png")
    assert "median beta of sl" in printed
    assert (tmp_path / "beta.png").stat().st_size > 5000


def test_beta_weights_the_integration_of_open3d(mapped, dataset, tmp_path, example):
    out = tmp_path / "weighted.ply"
    example("02_beta_as_weight_in_open3d.py", mapped.root, "--sensors", "sl", "sgm", "--voxel", 0.06, "--out", out)
    vertices = Mesh.load(out).vertices
    reference = Mesh.load(dataset / "mesh_gt.ply").vertices
    assert len(vertices) > 1000
    assert (vertices > reference.min(0) - 0.3).all()
    assert (vertices < reference.max(0) + 0.3).all()


def test_own_reader(dataset, tmp_path, example):
    recording = open_dataset(dataset)
    folder = tmp_path / "stacked"
    folder.mkdir()
    np.savez(
        folder / "recording.npz",
        color=np.stack([recording.color(i).numpy() for i in range(FRAMES)]),
        depth=np.stack([recording.depth(i, "sl").numpy() for i in range(FRAMES)]),
        T_world_camera=np.stack([recording.pose(i) for i in range(FRAMES)]),
        matrix=recording.camera.matrix,
    )
    try:
        assert "6 frames of the format stacked" in example("03_own_reader.py", folder, "--run", tmp_path / "run")
    finally:
        unregister_reader("stacked")
    frames = RunFrames(RunDirectory(tmp_path / "run"))
    assert frames.sensors == ("depth",)
    np.testing.assert_allclose(frames.depth(3, "depth"), recording.depth(3, "sl"), atol=1e-3)
    np.testing.assert_allclose(frames.pose(3), recording.pose(3), atol=1e-9)


def test_own_method(run, example):
    try:
        assert f"{FRAMES} frames" in example("04_own_method.py", run.root, "--voxel", 0.06)
    finally:
        unregister_method("nearest")
    assert run.require_stage("map").facts["method"] == "nearest"
    assert len(Mesh.load(run.mesh_path).vertices) > 1000


def test_every_script_is_listed():
    text = (EXAMPLES / "README.md").read_text()
    assert all(f"`{script.name}`" in text for script in EXAMPLES.glob("*.py"))


def test_a_noise_model_predicts_the_beta_of_the_run(mapped):
    frames, models = RunFrames(mapped), load_noise_models(mapped.root)
    assert set(models) == {"sl", "sgm"}
    for sensor, model in models.items():
        depth, color, normals = frames.depth(1, sensor), frames.color(1), frames.normals(1, sensor)
        beta = predict_beta(model, depth, color, frames.camera, normals)
        np.testing.assert_allclose(beta, frames.beta(1, sensor), atol=1e-4)  # as precise as the file
        estimated = predict_beta(model, depth, color, frames.camera)
        valid = (depth > 0).numpy()
        assert np.median((estimated - beta).abs()[valid] / beta[valid]) < 0.05  # normals in files are rounded
        assert ((estimated > 0).numpy() == valid).all()


# --- docs/python.md --------------------------------------------------------------------------------------------------
def test_snippets_of_the_python_page_run_in_order(dataset, tmp_path, monkeypatch, capsys):
    """All of them as one script; imports may stand below the snippet that needs them."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL)
    imports = [block for block in blocks if all(line.startswith(("from", "import")) for line in block.split("\n")[:-1])]
    assert len(blocks) > 6
    (tmp_path / "room").symlink_to(dataset)
    monkeypatch.chdir(tmp_path)
    try:
        exec(compile("\n".join([*imports, *blocks]), "python.md", "exec"), {"__name__": "python.md"})
    finally:
        unregister_method("mean")
        unregister_reader("bags")
    assert f"{FRAMES} frames" in capsys.readouterr().out
    assert RunDirectory(tmp_path / "run").require_stage("map").facts["method"] == "mean"


# --- packages --------------------------------------------------------------------------------------------------------
def add_package(folder: Path, name: str, group: str, entry: str, module: str) -> None:
    """A package of one module as an installer leaves it in `folder`."""
    (folder / f"{name}.py").write_text(module)
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\n{entry}\n")


@pytest.fixture(scope="module")
def uncle_with_packages(tmp_path_factory):
    """Runs the program with the example package installed, a broken one, and one whose method has a name of ours."""
    place, source = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("source") / "plugin"
    shutil.copytree(EXAMPLES / "plugin", source)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index"]
    subprocess.run([*pip, "--no-deps", "--no-build-isolation", "--target", place, source], check=True)
    add_package(place, "broken", "uncle.methods", "broken = broken:METHOD_SPEC", "import no_such_library\n")
    clash = 'from uncle.recon.methods import MethodSpec\nMETHOD_SPEC = MethodSpec("tsdf", "mine", "batch", "x:y")\n'
    add_package(place, "clash", "uncle.methods", "tsdf = clash:METHOD_SPEC", clash)
    add_package(place, "other", "uncle.readers", "other = other:READER_SPEC", "READER_SPEC = 'no specification'\n")
    paths = [str(place), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}

    def uncle(*arguments):
        command = [sys.executable, "-m", "uncle.cli.main", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)

    return uncle


@pytest.fixture(scope="module")
def npz_folder(dataset, tmp_path_factory):
    """The data set as the reader of the example package wants it."""
    folder, recording = tmp_path_factory.mktemp("npz"), open_dataset(dataset)
    camera = recording.camera
    values = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "camera.json").write_text(json.dumps(values))
    for index in range(FRAMES):
        depths = {f"depth_{sensor}": recording.depth(index, sensor).numpy() for sensor in ("sl", "sgm")}
        color, pose = recording.color(index).numpy(), recording.pose(index)
        np.savez(folder / f"frame_{index:04d}.npz", color=color, pose=pose, **depths)
    return folder


def test_a_package_adds_a_method_and_a_reader(uncle_with_packages, npz_folder, dataset, tmp_path):
    run = RunDirectory(tmp_path / "run")
    done = uncle_with_packages("preprocess", npz_folder, "--run", run.root)
    assert done.returncode == 0, done.stderr
    assert run.load_manifest().dataset_format == "npz"
    assert done.stderr.count("skipped 'other' of the package other (uncle.readers): TypeError: other:READER_SPEC") == 1
    np.testing.assert_allclose(RunFrames(run).depth(2, "sl"), open_dataset(dataset).depth(2, "sl"), atol=1e-3)

    options = ["--run", run.root, "--method", "inverse-power", "--voxel", 0.06, "--set", "fusion.min_observations=1"]
    done = uncle_with_packages("map", *options, "--set", "plugin.power=1")
    assert done.returncode == 0, done.stderr
    assert "skipped 'broken' of the package broken (uncle.methods): ModuleNotFoundError: No module" in done.stderr
    assert "skipped 'tsdf' of the package clash (uncle.methods): there is a method called 'tsdf' already" in done.stderr
    assert done.stderr.count("skipped") == 2
    assert tomllib.loads(run.config_path.read_text())["plugin"] == {"power": 1.0}
    assert uncle_with_packages("map", *options, "--set", "plugin.power=1").stderr.count("done and unchanged") == 1
    assert "Wrote" in uncle_with_packages("mesh", "--run", run.root).stderr
    assert len(Mesh.load(run.mesh_path).vertices) > 1000


def test_settings_of_a_package_are_checked(uncle_with_packages, mapped):
    options = ["--run", mapped.root, "--method", "inverse-power", "--set"]
    assert "plugin.power: Input should be less than or equal to 4" in uncle_with_packages(
        "map", *options, "plugin.power=9").stderr  # fmt: skip
    assert "did you mean plugin.power?" in uncle_with_packages("map", *options, "plugin.pover=1").stderr


def test_help_lists_what_packages_add(uncle_with_packages):
    assert "inverse-power: fusion with weights" in " ".join(uncle_with_packages("map", "--help").stdout.split())
    assert "npz: a NumPy file for each frame" in " ".join(uncle_with_packages("preprocess", "--help").stdout.split())
