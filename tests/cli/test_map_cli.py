"""`uncle map` and `uncle mesh` as a user meets them."""

import errno

import numpy as np
import pytest
from click.testing import CliRunner, Result
from uncle.cli.main import main
from uncle.recon.core import files as storage
from uncle.recon.core.mesh import Mesh
from uncle.recon.methods import map_output
from uncle.recon.run.directory import RunDirectory

QUICK = [
    "fusion.voxel_size_m=0.05",
    "fusion.passes=0",
    "fusion.min_observations=2",
    "keyframes.rays=200",
    "field.iterations=3",
    "uncertainty.steps_per_keyframe=1",
    "uncertainty.steps_per_pass=5",
    "uncertainty.batch=64",
]


def uncle(*arguments: object) -> Result:
    return CliRunner().invoke(main, list(map(str, arguments)))


def uncle_map(run: RunDirectory, *arguments: object) -> Result:
    overrides = [word for override in QUICK for word in ("--set", override)]
    return uncle("map", "--run", run.root, "--device", "cpu", *overrides, *arguments)


def one_line(result: Result) -> str:
    """The message of a command that failed on purpose."""
    assert result.exit_code == 1, result.output
    assert "Traceback" not in result.output
    message = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert len(message) == 1
    assert result.stderr.rstrip().endswith(message[0])
    return message[0]


@pytest.fixture
def run(make_mappable_run) -> RunDirectory:
    return make_mappable_run(angles=np.linspace(0, 2 * np.pi, 6, endpoint=False))


def test_map_then_mesh(run):
    result = uncle_map(run, "--sensors", "gt", "noisy")
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    assert "Mapped 6 frames" in result.stderr
    assert f"uncle mesh --run {run.root}" in result.stderr
    assert run.load_manifest().stages["map"].facts["sensors"] == ["gt", "noisy"]
    assert "done and unchanged" in uncle_map(run, "--sensors", "gt", "noisy").stderr
    result = uncle("mesh", "--run", run.root)
    assert result.exit_code == 0, result.output
    assert f"Wrote {run.mesh_path}" in result.stderr
    mesh = Mesh.load(run.mesh_path)
    assert len(mesh.vertices) > 500
    assert mesh.sigma is not None
    assert mesh.colors is not None
    facts = run.load_manifest().stages["mesh"].facts
    assert (facts["vertices"], facts["faces"]) == (len(mesh.vertices), len(mesh.faces))


def test_mesh_is_redone_only_where_something_changed(run):
    assert uncle_map(run).exit_code == 0
    assert "Wrote" in uncle("mesh", "--run", run.root).stderr
    assert "done and unchanged" in uncle("mesh", "--run", run.root).stderr
    assert "Wrote" in uncle("mesh", "--run", run.root, "--overwrite").stderr
    assert "Wrote" in uncle("mesh", "--run", run.root, "--voxel", "0.08").stderr
    coarse = len(Mesh.load(run.mesh_path).vertices)
    assert "Wrote" in uncle("mesh", "--run", run.root, "--no-clean").stderr
    assert len(Mesh.load(run.mesh_path).vertices) > 1.5 * coarse
    elsewhere = run.root.parent / "other.ply"
    assert "Wrote" in uncle("mesh", "--run", run.root, "--voxel", "0.08", "--out", elsewhere).stderr
    assert len(Mesh.load(elsewhere).vertices) == coarse
    glb = uncle("mesh", "--run", run.root, "--voxel", "0.08", "--out", run.root.parent / "other.glb")
    assert "other.glb holds no sigma" in glb.stderr
    assert (run.root.parent / "other.glb").read_bytes().startswith(b"glTF")
    np.testing.assert_array_equal(Mesh.load(run.root.parent / "other.glb").faces, Mesh.load(elsewhere).faces)
    assert "done and unchanged" in uncle("mesh", "--run", run.root, "--no-clean").stderr  # --out is no stage
    message = one_line(uncle("mesh", "--run", run.root, "--max-sigma", "1e-9"))
    assert "larger --max-sigma" in message
    run.mesh_path.unlink()
    assert "Wrote" in uncle("mesh", "--run", run.root, "--no-clean").stderr


def test_a_mesh_format_that_is_not_written_is_refused_before_any_work(run):
    """The run has no map yet: nobody looked for it."""
    message = one_line(uncle("mesh", "--run", run.root, "--out", run.root.parent / "other.fbx"))
    assert ".fbx is no mesh format that is written; choose one of .ply, .obj" in message


def test_vertices_that_are_not_sure_enough_are_left_out(run):
    assert uncle_map(run).exit_code == 0
    assert uncle("mesh", "--run", run.root, "--no-clean").exit_code == 0
    everything = Mesh.load(run.mesh_path)
    limit = float(np.median(everything.sigma))
    result = uncle("mesh", "--run", run.root, "--no-clean", "--max-sigma", limit)
    assert result.exit_code == 0, result.output
    sure = Mesh.load(run.mesh_path)
    assert sure.sigma.max() <= limit + 1e-7
    assert 0.3 * len(everything.vertices) < len(sure.vertices) <= 0.55 * len(everything.vertices)
    kept = {tuple(vertex) for vertex in sure.vertices}
    assert kept <= {tuple(vertex) for vertex in everything.vertices[everything.sigma <= limit + 1e-7]}
    assert run.load_manifest().stages["mesh"].facts["max_sigma_m"] == limit
    assert "done and unchanged" in uncle("mesh", "--run", run.root, "--no-clean", "--max-sigma", limit).stderr
    assert "Wrote" in uncle("mesh", "--run", run.root, "--no-clean").stderr
    assert len(Mesh.load(run.mesh_path).vertices) == len(everything.vertices)


def test_baseline(run):
    result = uncle(
        "map", "--run", run.root, "--method", "tsdf", "--voxel", "0.06", "--set", "fusion.min_observations=1"
    )
    assert result.exit_code == 0, result.output
    assert 'method = "tsdf"' in run.config_path.read_text()
    assert "voxel_size_m = 0.06" in run.config_path.read_text()
    assert uncle("mesh", "--run", run.root).exit_code == 0
    assert run.load_manifest().stages["mesh"].facts["clean"] is False


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--sensors", "sl"], 1, "no sensor called 'sl'"),
        (["--sensors"], 2, "at least one sensor"),
        (["--set", "fusion.voxel_size=1"], 1, "did you mean fusion.voxel_size_m?"),
        (["--set", "fusion.voxel_size_m"], 1, "key=value"),
        (["--voxel", "0"], 2, "--voxel"),
        (["--voxel", "nan"], 1, "voxel_size_m"),
        (["--hold-out", "1"], 2, "--hold-out"),
        (["--method", "magic"], 2, "--method"),
        (["--seed", "-1"], 2, "--seed"),
        (["--seed", "99999999999999999999"], 1, "seed"),
        (["--json"], 2, "No such option"),
    ],
)
def test_bad_values(run, arguments, code, said):
    result = uncle_map(run, *arguments)
    assert result.exit_code == code, result.output
    assert said in result.stderr
    assert "Traceback" not in result.output
    assert "map" not in run.load_manifest().stages


def test_what_must_come_first_is_named(tmp_path, run):
    assert "uncle preprocess" in one_line(uncle("map", "--run", tmp_path / "none"))
    assert "uncle map" in one_line(uncle("mesh", "--run", run.root))
    assert "uncle preprocess" in one_line(uncle("mesh", "--run", tmp_path / "none"))


def test_damaged_map_is_named(run):
    assert uncle_map(run).exit_code == 0
    run.field_path.write_bytes(run.field_path.read_bytes()[:1000])
    assert "damaged" in one_line(uncle("mesh", "--run", run.root))


def test_disk_full_while_writing_beta_keeps_earlier_stages(run, monkeypatch):
    written = []

    def write_image(path, image):
        written.append(path)
        if len(written) > 3:
            with storage.explain_write_errors(path):
                raise OSError(errno.ENOSPC, "No space left on device")
        storage.write_image(path, image)

    monkeypatch.setattr(map_output, "write_image", write_image)
    message = one_line(uncle_map(run))
    assert "the disk is full" in message
    assert str(written[-1]) in message
    assert set(run.load_manifest().stages) == {"preprocess"}
    assert run.checkpoint_path.exists()
    monkeypatch.undo()
    result = uncle_map(run, "--resume")
    assert result.exit_code == 0, result.output
    assert "continuing" in result.stderr
    assert len(list((run.root / "beta").rglob("*.png"))) == 6


def test_place_that_cannot_be_written(run, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(storage.os, "replace", refuse)
    assert "read-only" in one_line(uncle_map(run))
    monkeypatch.undo()
    assert uncle_map(run).exit_code == 0
    monkeypatch.setattr(storage.os, "replace", refuse)
    assert "read-only" in one_line(uncle("mesh", "--run", run.root))
    assert not list(run.root.rglob("*.part*"))


def test_missing_image_is_named(run):
    run.depth_path("noisy", 3).unlink()
    assert str(run.depth_path("noisy", 3)) in one_line(uncle_map(run, "--sensors", "noisy"))
