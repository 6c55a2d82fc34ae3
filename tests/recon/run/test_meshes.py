"""The mesh of a run and the ground truth of its data set."""

import numpy as np
import pytest
from uncle.recon.core.errors import DataError, RunError
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.meshes import has_reference_mesh, load_reference_mesh, load_run_mesh


def test_missing_runs_and_meshes_name_the_command(tmp_path, make_box_run):
    with pytest.raises(RunError, match="uncle preprocess"):
        load_run_mesh(RunDirectory(tmp_path / "nowhere"))
    with pytest.raises(RunError, match="uncle mesh"):
        load_run_mesh(make_box_run())


def test_a_run_has_a_mesh_and_a_reference(make_box_run, box_room):
    run = make_box_run()
    box_room.mesh(grow_m=0.01).save(run.mesh_path)
    assert has_reference_mesh(run)
    difference = np.abs(load_run_mesh(run).vertices - load_reference_mesh(run).vertices)
    np.testing.assert_allclose(difference, 0.01, atol=1e-6)


def test_a_reference_that_is_gone_or_was_never_named(make_box_run, tmp_path):
    run = make_box_run()
    (tmp_path / "reference.ply").unlink()
    assert not has_reference_mesh(run)
    with pytest.raises(DataError, match=r"reference\.ply no longer exists"):
        load_reference_mesh(run)
    manifest = run.load_manifest()
    manifest.reference_mesh = None
    run.save_manifest(manifest)
    assert not has_reference_mesh(run)
    with pytest.raises(DataError, match="no ground-truth mesh"):
        load_reference_mesh(run)
