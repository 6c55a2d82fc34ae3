"""The tables of the comparison, from made-up runs."""

from pathlib import Path

import pytest
from scipy import stats
from uncle.recon.evaluation.bench.methods import Catalogue
from uncle.recon.evaluation.bench.paper_tables import paper_tables, statistics_json
from uncle.recon.evaluation.bench.plan import Choice, Scene
from uncle.recon.evaluation.bench.published import REPLICA, published
from uncle.recon.evaluation.bench.scores import UNCERTAINTY
from uncle.recon.methods.registry import method_specs

ROOM = Scene("room", Path("room"), "senfunet", ("sl", "psmnet"), True, True, 130, "abc")
HALL = Scene("hall", Path("hall"), "senfunet", ("sl",), True, True, 130, "abc")
ALL = ("uncle-paper", "nice-slam", "senfunet", "tsdf")


CHOICE = Choice(ALL, catalogue=Catalogue({name: method_specs()[name] for name in ALL}))


def record(method, seed=0, f=0.5, dataset="room", setting="given", sensors="sl", **more):
    made = {"dataset": dataset, "sensors": sensors, "setting": setting, "method": method, "variant": "", "seed": seed}
    return made | {"timed_in": "", "session": "a", "wall_s": 10.0, "f_score_5cm": f, "placement": "cpu"} | more


def rows_of(tables, title):
    """Rows as dictionaries by heading."""
    found = [table for table in tables if table.title == title]
    return [dict(zip(found[0].header, row, strict=True)) for row in found[0].rows] if found else []


def test_a_row_has_the_median_its_range_and_what_the_paper_has():
    records = [record("uncle-paper", seed, f) for seed, f in enumerate((0.9, 0.5, 0.6))] + [record("tsdf", f=0.7)]
    tables = paper_tables([ROOM], CHOICE, records, {})
    paper, tsdf = rows_of(tables, "Single sensor, given poses")
    assert (paper["method"], paper["runs"], paper["F 5 cm %"]) == ("uncle-paper", "3", "60.00 [50.00, 90.00]")
    assert paper["paper"] == "Replica: F 5 cm 92.28, depth L1 1.85"
    assert (tsdf["F 5 cm %"], tsdf["paper"], tsdf["ATE cm"]) == ("70.00 *", "-", "-")
    notes = next(table.notes for table in tables if table.title == "Single sensor, given poses")
    assert any("from another scene" in note for note in notes)


def test_what_cannot_be_done_and_what_failed_are_rows_with_a_footnote():
    failures = {("room", "sl", "depth", "nice-slam"): ["on sl of room, seed 0 failed: the camera was lost"]}
    tables = paper_tables([ROOM], CHOICE, [record("uncle-paper", setting="depth", ate_m=0.02)], failures)
    table = next(table for table in tables if table.title == "Single sensor, depth-only tracking")
    by_name = {row[2].split()[0]: row for row in table.rows if row[1] == "sl"}
    assert by_name["nice-slam"][2:5] == ["nice-slam [1]", "0", "-"]
    assert by_name["senfunet"][2:5] == ["senfunet [2]", "0", "-"]
    assert table.notes[0] == "[1] nice-slam: on sl of room, seed 0 failed: the camera was lost"
    assert table.notes[1].startswith("[2] senfunet: it fuses with given poses")
    assert [row[2] for row in table.rows if row[1] == "psmnet"] == ["senfunet [2]"]  # said once
    assert "tsdf" not in by_name  # not run yet


def test_the_same_sensors_of_several_data_sets_are_summed_up():
    records = [record("tsdf", 0, 0.4), record("tsdf", 1, 0.6), record("tsdf", 0, 0.9, "hall")]
    rows = rows_of(paper_tables([ROOM, HALL], CHOICE, records, {}), "Single sensor, given poses")
    assert [row["data set"] for row in rows] == ["room", "hall", "all scenes"]
    assert rows[2]["F 5 cm %"] == "mean 70.00"


def test_the_best_of_the_same_sensors_is_marked_by_its_median_and_less_is_better_in_errors():
    records = [record("uncle-paper", seed, f, depth_l1_m=0.02) for seed, f in enumerate((0.9, 0.5, 0.6))]
    records += [record("tsdf", f=0.6, depth_l1_m=0.03), record("tsdf", f=0.1, sensors="psmnet")]
    rows = rows_of(paper_tables([ROOM], CHOICE, records, {}), "Single sensor, given poses")
    assert [row["F 5 cm %"][-1] for row in rows] == ["*", "*", "0"]  # a tie; nobody else has psmnet
    assert [row["depth L1 cm"][-1] for row in rows] == ["*", "0", "-"]


def test_tests_between_methods_are_welchs():
    ours, theirs = (0.80, 0.82, 0.81), (0.70, 0.75, 0.71)
    records = [record("uncle-paper", seed, f) for seed, f in enumerate(ours)]
    records += [record("nice-slam", seed, f) for seed, f in enumerate(theirs)] + [record("tsdf")]
    expected = stats.ttest_ind(ours, theirs, equal_var=False)
    (row,) = rows_of(paper_tables([ROOM], CHOICE, records, {}), "Do methods differ?")
    assert (row["method"], row["against"], row["verdict"]) == ("uncle-paper", "nice-slam", "better")
    assert (row["t"], row["p"]) == (f"{expected.statistic:.2f}", f"{expected.pvalue:.4f}")
    assert row["mean ± std"] == "81.00 ± 1.00"
    (test,) = statistics_json(records)["tests"]
    assert test["p"] == pytest.approx(expected.pvalue)
    single = paper_tables([ROOM], CHOICE, records[:1], {})
    assert any("raise --seeds" in note for table in single for note in table.notes)


def test_times_are_over_those_of_the_baseline_in_the_same_call():
    records = [record("nice-slam", wall_s=60.0, session="b"), record("tsdf", wall_s=1.0, session="a")]
    records += [record("tsdf", f=None, wall_s=20.0, session="b", timed_in="b")]
    tables = paper_tables([ROOM], CHOICE, records, {})
    rows = {row["method"]: row for row in rows_of(tables, "Time and memory")}
    assert (rows["nice-slam"]["time / tsdf"], rows["tsdf"]["timed"]) == ("3.00", "2")
    assert {row["method"]: row["runs"] for row in rows_of(tables, "Single sensor, given poses")}["tsdf"] == "1"


def test_uncertainty_has_a_row_per_sensor_and_names_who_has_none():
    trust = {sensor: dict.fromkeys(UNCERTAINTY, 0.25) for sensor in ("sl", "psmnet")}
    records = [record("uncle-paper", sensors="sl+psmnet", uncertainty=trust), record("tsdf", uncertainty={})]
    tables = paper_tables([ROOM], CHOICE, records, {})
    rows = rows_of(tables, "Is the stated uncertainty right?")
    assert [(row["sensor"], row["NLL nats"]) for row in rows] == [("sl", "0.250"), ("psmnet", "0.250")]
    assert next(t.notes for t in tables if t.title.startswith("Is the"))[0].endswith("scored: tsdf.")
    assert {entry["sensor"] for entry in statistics_json(records)["uncertainty"]} == {"sl", "psmnet"}


def test_the_ablation_is_a_table_of_its_own():
    records = [record("uncle", seed, f, variant="unweighted") for seed, f in enumerate((0.5, 0.52))]
    records += [record("uncle", seed, f, variant="mine") for seed, f in enumerate((0.7, 0.72))]
    tables = paper_tables([ROOM], CHOICE, records, {})
    rows = rows_of(tables, "Ablation of the uncertainty")
    assert [row["F 5 cm %"] for row in rows] == ["51.00 ± 1.41", "71.00 ± 1.41 +"]
    assert not rows_of(tables, "Single sensor, given poses")


def test_all_figures_have_mean_median_min_max_and_std():
    records = [record("tsdf", seed, f) for seed, f in enumerate((0.5, 0.6, 0.9))]
    row = next(r for r in rows_of(paper_tables([ROOM], CHOICE, records, {}), "All figures") if "F 5" in r["figure"])
    assert [row[name] for name in ("runs", "mean", "median", "min", "max", "std")] == [
        "3", "66.67", "60.00", "50.00", "90.00", "20.82",
    ]  # fmt: skip
    figure = next(f for f in statistics_json(records)["figures"] if f["figure"] == "f_score_5cm")
    assert figure["mean"] == pytest.approx(2 / 3)


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        (("x", "senfunet", "given", "psmnet+sl", "vox-fusion"), "Replica: F 5 cm 72.57"),
        (("x", "senfunet", "rgbd", "sgm+psmnet", "uncle-paper"), "Replica: F 5 cm 69.76, depth L1 4.13, ATE 19.88"),
        (("x", "senfunet", "depth", "psmnet", "nice-slam"), "Replica: F 5 cm 49.8, depth L1 10.65, ATE 27.9"),
        (("x", "senfunet", "depth", "psmnet", "uncle"), "-"),
        (("redkitchen_seq-01", "7scenes", "depth", "depth", "uncle-paper"), "ATE 6.21"),
        (("rgbd_dataset_freiburg1_desk2", "tum", "depth", "depth", "nice-slam"), "ATE 47.81"),
        (("rgbd_dataset_freiburg1_desk", "tum", "depth", "depth", "nice-slam"), "ATE 40.40"),
        (("rgbd_dataset_freiburg1_xyz", "tum", "given", "depth", "nice-slam"), "-"),
    ],
)
def test_published_figures_stand_where_they_belong(place, expected):
    assert published(*place) == expected


def test_names_of_published_sensors_are_sorted():
    assert all(names == "+".join(sorted(names.split("+"))) for _, names in REPLICA)
