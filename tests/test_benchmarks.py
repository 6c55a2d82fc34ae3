"""The sums behind the benchmark tables."""

import importlib.util
from pathlib import Path

import pytest

SPEC = importlib.util.spec_from_file_location("chain", Path(__file__).parents[1] / "benchmarks" / "chain.py")
chain = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(chain)


def record(method="uncle", seed=0, wall_s=1.0, session="a", hold_out=0, **scores):
    job = chain.Job("room", "sl", method, seed, hold_out)
    return {**job._asdict(), "wall_s": wall_s, "session": session, **scores}


@pytest.mark.parametrize(("seeds", "order"), [(1, "tu t t"), (3, "tu tu tu"), (5, "tu tu tu u u")])
def test_baseline_is_timed_three_times_in_turns(seeds, order):
    jobs = chain.plan("room", ["sl"], ["tsdf", "uncle"], seeds, 0)
    assert "".join(job.method[0] for job in jobs) == order.replace(" ", "")
    assert [job.seed for job in jobs if job.method == "uncle"] == list(range(seeds))
    assert len({job.key for job in jobs}) == len(jobs)


def test_keys_tell_sensors_and_held_out_frames_apart():
    jobs = chain.plan("room", ["sl", "sl+sgm"], ["uncle"], 1, 0) + chain.plan("room", ["sl"], ["uncle"], 1, 10)
    assert len({job.key for job in jobs}) == 3


def test_scores_are_taken_by_threshold_and_sensor():
    score = {"threshold_m": 0.05, "f_score": 0.9, "precision": 0.8, "recall": 0.7}
    uncertainty = dict.fromkeys(chain.UNCERTAINTY, 0.5) | {"ause": 1.0}
    depth = {"l1_m": 0.02, "median_m": 0.01, "completeness": 0.99, "sensor": "depth"}
    mesh = {"scores": [score, {**score, "threshold_m": 0.02, "f_score": 0.6}], "accuracy_mean_m": 0.01}
    found = chain.scores(
        {
            "surface": {"mesh": mesh},
            "held_out": {"depth": depth},
            "uncertainty": {"sl": uncertainty},
        }
    )  # fmt: skip
    assert (found["f_score_5cm"], found["f_score_2cm"], found["recall_5cm"]) == (0.9, 0.6, 0.7)
    assert (found["held_out_l1_m"], found["held_out_seen"]) == (0.02, 0.99)
    assert found["uncertainty"] == {"sl": dict.fromkeys(chain.UNCERTAINTY, 0.5)}


def test_scores_of_a_run_without_any_truth():
    assert chain.scores({"surface": None, "held_out": {}, "uncertainty": {}}) == {"uncertainty": {}}


def test_cell_is_the_median_of_those_that_were_scored():
    records = [record(f=0.9), record(f=0.5), record(f=0.6), record(), record(f=None)]
    assert chain.cell(records, "f", 100, 1, True) == "60.0 [50.0, 90.0]"
    assert chain.cell(records, "f", 100, 1, False) == "60.0"
    assert chain.cell(records, "g", 100, 1, True) == "-"


def test_time_ratio_divides_medians_of_the_same_session():
    ours = [record(wall_s=s) for s in (30.0, 40.0, 90.0)] + [record(wall_s=1000.0, session="later")]
    baseline = [record("tsdf", wall_s=s) for s in (10.0, 20.0, 99.0)] + [record("tsdf", wall_s=1.0, session="earlier")]
    assert chain.time_ratio(ours, baseline) == "2.00"
    assert chain.time_ratio(ours[3:], baseline) == "-"


def test_markdown_has_a_row_per_method_and_leaves_empty_columns_out():
    sensor = dict.fromkeys(chain.UNCERTAINTY, 0.25)
    baseline = [record("tsdf", seed, wall_s=2.0, **({"f_score_5cm": 0.8} if seed == 0 else {})) for seed in range(3)]
    ours = [record(seed=seed, wall_s=5.0, f_score_5cm=0.9, uncertainty={"sl": sensor}) for seed in range(2)]
    scene, sensors = chain.markdown(baseline + ours).split("\n\n")
    assert scene.splitlines() == [
        "| data set | sensors | method | runs | F 5 cm % | map s | time / tsdf |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| room | sl | tsdf | 3 | 80.00 | 2.0 | 1.00 |",
        "| room | sl | uncle | 2 | 90.00 [90.00, 90.00] | 5.0 | 2.50 |",
    ]
    assert sensors.splitlines()[2] == (
        "| room | sl | uncle | sl | 2 | 0.250 [0.250, 0.250] | 0.250 | 0.250 | 25.0 | 25.0 |"
    )
    assert len(sensors.splitlines()) == 3
