import numpy as np
from uncle.datasets.poses import pose_notes
from uncle.recon.core.pose import NO_POSE, Pose

POSE = np.eye(4)


def test_notes_count_the_frames_and_name_the_first():
    bad, corrected = Pose(None, "f.txt: it is a mirror"), Pose(POSE, "g.txt: scaled")
    assert pose_notes([NO_POSE, NO_POSE]) == ()
    assert pose_notes([Pose(POSE), bad]) == (
        "1 of 2 frames have no usable pose (the first: frame 1: f.txt: it is a mirror)",
    )
    assert pose_notes([bad, bad])[0].startswith("2 of 2 frames have no usable pose (the first: frame 0: f.txt")
    assert pose_notes([Pose(POSE), corrected]) == ("1 of 2 poses were corrected (frame 1: g.txt: scaled)",)
