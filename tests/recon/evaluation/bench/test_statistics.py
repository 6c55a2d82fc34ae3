"""Statistics over seeds, against the textbook and SciPy."""

import numpy as np
import pytest
from scipy import stats
from uncle.recon.evaluation.bench.statistics import ALL_SCENES, Metric, collect, describe, summarise

F = Metric("F", "f", 100, 1, 1)


def record(method, seed, f, dataset="room"):
    return {"dataset": dataset, "method": method, "seed": seed, "f": f}


def group(record):
    return record["dataset"], record["method"]


def test_welchs_test_is_that_of_the_textbook():
    rng = np.random.default_rng(0)
    values, baseline = rng.normal(1.0, 0.1, 5), rng.normal(0.5, 0.4, 7)
    found = describe(list(values), list(baseline), 1)
    a, b = values.var(ddof=1) / 5, baseline.var(ddof=1) / 7
    t = (values.mean() - baseline.mean()) / np.sqrt(a + b)
    freedom = (a + b) ** 2 / (a**2 / 4 + b**2 / 6)
    assert found["t"] == pytest.approx(t)
    assert found["p"] == pytest.approx(2 * stats.t.sf(abs(t), freedom))
    assert (found["runs"], found["min"], found["max"]) == (5, values.min(), values.max())
    assert found["mean"] == pytest.approx(values.mean())
    assert found["median"] == pytest.approx(np.median(values))
    assert found["std"] == pytest.approx(values.std(ddof=1))


@pytest.mark.parametrize(("better", "verdict"), [(1, "better"), (-1, "worse"), (0, "")])
def test_more_is_better_or_worse_as_the_metric_says(better, verdict):
    assert describe([1.0, 1.1, 0.9], [0.1, 0.2, 0.0], better)["verdict"] == verdict
    assert describe([1.0, 1.1, 0.9], [0.9, 1.2, 0.6], better)["verdict"] == ""  # not significant


@pytest.mark.parametrize(("values", "baseline"), [([1.0], [0.0, 0.1]), ([1.0, 1.1], [0.0]), ([1.0, 1.0], [0.0, 0.0])])
def test_without_a_spread_there_is_no_test(values, baseline):
    found = describe(values, baseline, 1)
    assert (found["t"], found["p"], found["verdict"]) == (None, None, "")
    assert found["std"] == (None if len(values) == 1 else pytest.approx(np.std(values, ddof=1)))


def test_means_of_the_data_sets_are_the_samples_over_all_scenes():
    records = [
        record(method, seed, base + gain + 0.001 * seed, dataset)
        for dataset, base in (("a", 0.4), ("b", 0.5), ("c", 0.6))
        for method, gain in (("plain", 0.0), ("ours", 0.1))
        for seed in range(2)
    ]
    rows = summarise(records, [F], group, "plain", ("dataset", "method"))
    whole = next(row for row in rows if (row["dataset"], row["method"]) == (ALL_SCENES, "ours"))
    expected = stats.ttest_ind([0.5005, 0.6005, 0.7005], [0.4005, 0.5005, 0.6005], equal_var=False)
    assert whole["runs"] == 3
    assert (whole["t"], whole["p"]) == (pytest.approx(expected.statistic), pytest.approx(expected.pvalue))
    single = next(row for row in rows if (row["dataset"], row["method"]) == ("a", "ours"))
    assert single["verdict"] == "better"
    assert next(row for row in rows if row["method"] == "plain")["p"] is None  # nothing is tested against itself


def test_a_figure_that_was_not_scored_is_no_sample():
    records = [record("ours", 0, 0.5), record("ours", 1, None), {"dataset": "room", "method": "ours", "seed": 2}]
    assert collect(records, [F], group) == {("room", "ours"): {"f": [0.5]}}
