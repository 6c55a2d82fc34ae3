"""The manifest of a run: what is refused, and how it says what to do."""

import json

import pytest
from uncle.recon.core.errors import DataError, RunError
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.manifest import SCHEMA_VERSION, Manifest
from uncle.recon.run.meshes import has_reference_mesh, load_reference_mesh, load_run_mesh

MANIFEST = Manifest(
    dataset="/data/room", dataset_format="folder", name="room", sensors=("depth",), has_timestamps=True,
    camera={"width": 64, "height": 48, "fx": 50.0, "fy": 51.0, "cx": 31.5, "cy": 23.5},
)  # fmt: skip


@pytest.fixture
def run(tmp_path):
    directory = RunDirectory(tmp_path / "run")
    directory.save_manifest(MANIFEST)
    return directory


def test_round_trip(run):
    assert run.load_manifest() == MANIFEST
    camera = run.load_camera()
    assert (camera.width, camera.height) == (64, 48)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50.0, 51.0, 31.5, 23.5)
    run.require()


def test_a_folder_without_a_run_names_the_first_command(tmp_path):
    with pytest.raises(RunError, match="holds no run; make one with `uncle preprocess DATASET --run"):
        RunDirectory(tmp_path).require()


@pytest.mark.parametrize("schema", [1, SCHEMA_VERSION + 1])
def test_runs_of_other_versions_are_refused_with_the_command_that_redoes_them(run, schema):
    run.manifest_path.write_text(json.dumps({"schema_version": schema, "dataset": "/data/room", "older": True}))
    with pytest.raises(RunError) as caught:
        run.load_manifest()
    message = str(caught.value)
    assert f"(schema {schema}, here {SCHEMA_VERSION})" in message
    assert message.endswith(f"redo it with `uncle preprocess /data/room --overwrite --run {run.root}`")
    assert "\n" not in message


@pytest.mark.parametrize("content", ["[]", "{}", json.dumps({"schema_version": SCHEMA_VERSION}), "not json"])
def test_damaged_manifests_are_one_line(run, content):
    run.manifest_path.write_text(content)
    with pytest.raises(RunError) as caught:
        run.load_manifest()
    assert "\n" not in str(caught.value)


def test_a_finished_stage_is_recorded_and_a_missing_one_names_its_command(run):
    with pytest.raises(RunError, match="no finished `map` stage; run `uncle map --run"):
        run.require_stage("map")
    run.finish_stage("map", "hash", 0.0, {"seed": 1})
    assert run.require_stage("map").facts == {"seed": 1}
    assert run.is_current("map", "hash")
    assert not run.is_current("map", "other")


def test_meshes_that_are_missing(run, tmp_path):
    with pytest.raises(RunError, match="uncle mesh"):
        load_run_mesh(run)
    with pytest.raises(RunError, match="uncle preprocess"):
        load_run_mesh(RunDirectory(tmp_path))
    with pytest.raises(DataError, match="no ground-truth mesh"):
        load_reference_mesh(run)
    run.save_manifest(MANIFEST.model_copy(update={"reference_mesh": str(tmp_path / "gone.ply")}))
    with pytest.raises(DataError, match=r"gone\.ply"):
        load_reference_mesh(run)
    assert not has_reference_mesh(run)


def finish(run, *stages):
    made_from = {"preprocess": (), "map": ("preprocess",), "mesh": ("map",), "eval": ("preprocess", "map", "mesh")}
    for stage in stages:
        run.begin_stage(stage)
        run.finish_stage(stage, "hash", 0.0, {}, inputs=made_from[stage])


def test_what_is_made_from_earlier_results_is_outdated_until_it_is_made_again(run):
    finish(run, "preprocess", "map", "mesh", "eval")
    run.require_current("preprocess", "map", "mesh", "eval")
    finish(run, "map")
    with pytest.raises(RunError, match=r"the mesh of .* made from earlier map; redo with `uncle mesh --run"):
        run.require_stage("mesh")
    with pytest.raises(RunError, match=r"the metrics of .*; redo with `uncle eval --run"):
        run.require_current("eval")
    finish(run, "mesh", "eval")
    run.require_current("preprocess", "map", "mesh", "eval")
    finish(run, "preprocess")
    for stage in ("map", "mesh", "eval"):
        with pytest.raises(RunError, match="made from earlier frames"):
            run.require_current(stage)


def test_a_stage_that_was_interrupted_while_it_wrote_has_no_result(run):
    finish(run, "preprocess", "map")
    run.begin_stage("map")
    with pytest.raises(RunError, match=r"`uncle map` has not finished writing; redo with `uncle map --run"):
        run.require_stage("map")
    assert not run.is_current("map", "hash")


def test_a_record_of_other_frames_is_noticed(run):
    """Files of two runs in one folder: the records do not belong together."""
    finish(run, "preprocess", "map", "mesh")
    other = run.load_manifest()
    other.stages["preprocess"] = other.stages["preprocess"].model_copy(update={"output": "of other frames"})
    run.save_manifest(other)
    for stage in ("map", "mesh"):
        with pytest.raises(RunError, match="made from other frames"):
            run.require_stage(stage)
        assert not run.is_current(stage, "hash")


def test_results_without_a_record_are_outdated_by_other_frames(run):
    run.mesh_path.write_text("of an earlier version")
    finish(run, "preprocess")
    with pytest.raises(RunError, match="made from earlier frames"):
        load_run_mesh(run)
