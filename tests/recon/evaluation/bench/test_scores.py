"""What is taken from the metrics of a run."""

from uncle.recon.evaluation.bench.scores import UNCERTAINTY, scores, trajectory_scores


def test_scores_are_taken_by_threshold_and_sensor():
    score = {"threshold_m": 0.05, "f_score": 0.9, "precision": 0.8, "recall": 0.7}
    uncertainty = dict.fromkeys(UNCERTAINTY, 0.5) | {"readings": 9}
    depth = {"l1_m": 0.02, "median_m": 0.01, "completeness": 0.99, "sensor": "depth"}
    mesh = {"scores": [score, {**score, "threshold_m": 0.02, "f_score": 0.6}]}
    mesh |= {"accuracy_mean_m": 0.01, "completeness_mean_m": 0.03}
    surface = {"mesh": mesh, "novel_views": {"l1_all_m": 0.04}}
    color = {"psnr_db": 25.0, "l1": 0.03, "completeness": 0.9, "frames": 3}
    held_out = {"held_out": {"depth": depth}, "held_out_color": color}
    found = scores({"surface": surface, **held_out, "uncertainty": {"sl": uncertainty}})
    assert (found["f_score_5cm"], found["f_score_2cm"], found["recall_5cm"]) == (0.9, 0.6, 0.7)
    assert (found["accuracy_mean_m"], found["completeness_mean_m"], found["depth_l1_m"]) == (0.01, 0.03, 0.04)
    assert (found["held_out_l1_m"], found["held_out_seen"]) == (0.02, 0.99)
    assert found["held_out_psnr_db"] == 25.0
    assert found["uncertainty"] == {"sl": dict.fromkeys(UNCERTAINTY, 0.5)}


def test_scores_of_a_run_without_any_truth():
    assert scores({"surface": None, "held_out": {}, "uncertainty": {}}) == {"uncertainty": {}}
    assert trajectory_scores({"trajectory": None}) == {}


def test_trajectory_scores_are_as_it_is_and_aligned():
    trajectory = {"ate_m": {"rmse": 0.2}, "ate_aligned_m": {"rmse": 0.1}, "completeness": 0.9}
    assert trajectory_scores({"trajectory": trajectory}) == {"ate_m": 0.2, "ate_aligned_m": 0.1, "posed": 0.9}
