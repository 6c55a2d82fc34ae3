"""Frames of a run as they are read back."""

import json

import numpy as np
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.core.files import write_text
from uncle.recon.run.frames import RunFrames


def test_a_frame_without_a_pose_is_none_or_an_error_that_names_it(make_box_run, box_room):
    run = make_box_run()
    records = json.loads(run.frames_path.read_text())
    records[3]["T_world_camera"] = None
    write_text(run.frames_path, json.dumps(records))
    frames = RunFrames(run)
    assert not frames.has_poses
    assert frames.pose(3) is None
    with pytest.raises(DataError, match=r"frame 3 of .*run has no camera pose"):
        frames.known_pose(3)
    np.testing.assert_allclose(frames.known_pose(0), box_room.pose(0.0))
