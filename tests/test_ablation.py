"""The variants of the ablation, their statistics, and its tables."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.errors import ConfigError
from uncle.recon.evaluation.bench.statistics import ALL_SCENES
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS
from uncle.recon.sensors.noise_model import input_mask

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # the programs import each other by their bare names
ablation = importlib.import_module("ablation")


def record(variant, seed, f_score, dataset="room", **more):
    job = ablation.Job(dataset, "sl", variant, (), seed, False)
    return {**job._asdict(), "f_score_2cm": f_score, "session": "a", **more}


def test_every_variant_is_made_of_settings_that_there_are():
    variants = ablation.choose_variants(["paper", "own"])
    assert len(variants) > 15
    configs = [make_config("uncle", list(settings)) for settings in variants.values()]
    seen = [input_mask(SENSOR_INPUTS, config.uncertainty.inputs) for config in configs]
    paper = [configs[list(variants).index(name)].uncertainty for name in ablation.GROUPS["paper"]]
    assert len({(config.inputs, config.beta_min_m) for config in paper}) == 8
    assert {config.beta_min_m for config in paper} == {1e-3, 1e-1}
    counts = {name: int(seen[list(variants).index(name)].sum()) for name in variants}
    assert counts["1K2FS"] == 2 < counts["1K7FS"] < counts["5K2FS"] < counts["5K7FS"] < counts["uncle"]
    assert not make_config("uncle", list(variants["unweighted"])).uncertainty.enabled


def test_variants_are_chosen_by_group_by_name_and_on_the_way():
    chosen = ablation.choose_variants(["uncle", "1K2FS"], [["mine", "field.rays=64", "field.samples=4"]])
    assert list(chosen) == ["unweighted", "uncle", "1K2FS", "mine"]
    assert chosen["mine"] == ("field.rays=64", "field.samples=4")
    assert list(ablation.choose_variants(["paper"]))[1:] == list(ablation.GROUPS["paper"])
    with pytest.raises(ConfigError, match="'6K2FS'; there are paper, uncle-paper, own"):
        ablation.choose_variants(["6K2FS"])


def test_seeds_go_round_so_that_one_can_stop_early():
    jobs = ablation.plan(["a", "b"], ["sl"], ablation.choose_variants(["uncle"]), 2, False)
    assert [job.seed for job in jobs] == [0] * 4 + [1] * 4
    assert len({job.key for job in jobs}) == 8
    tracked = ablation.plan(["a", "b"], ["sl"], ablation.choose_variants(["uncle"]), 2, True)
    assert not {job.key for job in jobs} & {job.key for job in tracked}


def test_a_variant_that_changed_is_not_done():
    job = ablation.Job("room", "sl", "mine", ("field.rays=64",), 0, False)
    assert ablation.is_done(job, {"settings": ["field.rays=64"]})
    assert not ablation.is_done(job, {"settings": ["field.rays=128"]})


def test_tables_have_the_papers_layout():
    records = [record("unweighted", seed, 0.5 + 0.01 * seed) for seed in range(3)]
    records += [record("good", seed, 0.7 + 0.01 * seed) for seed in range(3)]
    records += [record("bad", seed, 0.3 + 0.01 * seed) for seed in range(3)] + [record("same", 0, 0.5)]
    rows = ablation.summarise(records)
    assert ablation.overview(rows) == [
        "| variant | room sl: F 2 cm % | better | worse |",
        "| --- | --- | --- | --- |",
        "| unweighted | 51.00 ± 1.00 |  |  |",
        "| good | 71.00 ± 1.00 + | 1 | 0 |",
        "| bad | 31.00 ± 1.00 - | 0 | 1 |",
        "| same | 50.00 | 0 | 0 |",
    ]
    good = ablation.details(rows)[3]
    t = 0.2 / np.sqrt(2 * 0.01**2 / 3)
    assert good.startswith(f"| room | sl | good | F 2 cm % | 3 | 71.00 | 71.00 | 70.00 | 1.00 | {t:.2f} |")
    assert good.endswith("| better |")


def test_several_scenes_are_also_tested_on_their_means():
    records = [
        record(variant, seed, base + gain + 0.001 * seed, dataset)
        for dataset, base in (("a", 0.4), ("b", 0.5), ("c", 0.6))
        for variant, gain in (("unweighted", 0.0), ("uncle", 0.1))
        for seed in range(2)
    ]
    rows = ablation.summarise(records)
    whole = next(row for row in rows if row["dataset"] == ALL_SCENES and row["variant"] == "uncle")
    expected = stats.ttest_ind([0.5005, 0.6005, 0.7005], [0.4005, 0.5005, 0.6005], equal_var=False)
    assert (whole["runs"], whole["t"], whole["p"]) == (
        3,
        pytest.approx(expected.statistic),
        pytest.approx(expected.pvalue),
    )
    assert whole["verdict"] == ""
    single = next(row for row in rows if row["dataset"] == "a" and row["variant"] == "uncle")
    assert single["verdict"] == "better"


def test_sensors_have_a_table_of_their_own():
    figures = {"rank_correlation": 0.25, "ause": 0.25}
    records = [record("unweighted", 0, 0.5), record("uncle", 0, 0.5, uncertainty={"sl": figures})]
    assert ablation.sensors_table(records)[2:] == ["| room | sl | uncle | sl | 0.250 | 0.250 |"]


def test_one_pass_sets_the_settings_of_its_variant(tmp_path, monkeypatch):
    calls = []
    metrics = {"surface": None, "held_out": {}, "uncertainty": {}, "trajectory": {"ate_m": {"rmse": 0.02}}}
    monkeypatch.setattr(ablation, "new_run", lambda base, run: calls.append((base, run)))
    monkeypatch.setattr(ablation, "uncle", lambda *words: calls.append(words) or 1.5)
    monkeypatch.setattr(ablation, "map_costs", lambda run, wall_s: {"wall_s": wall_s})
    monkeypatch.setattr(ablation, "evaluate", lambda run: metrics)
    found = ablation.execute(ablation.Job("room", "sl+sgm", "mine", ("a=1", "b=2"), 3, True), tmp_path)
    assert calls[0] == (tmp_path / "room" / "base", tmp_path / "room" / "work")
    text = " ".join(map(str, calls[1]))
    assert text.endswith("--sensors sl sgm --seed 3 --track --set a=1 --set b=2")
    assert (found["ate_m"], found["wall_s"], found["variant"]) == (0.02, 1.5, "mine")
    surface = {"mesh": {"scores": [], "accuracy_mean_m": 0.01}, "novel_views": {"l1_all_m": 0.03}}
    metrics["surface"] = surface
    found = ablation.execute(ablation.Job("room", "sl", "mine", (), 0, False), tmp_path)
    assert (found["accuracy_mean_m"], found["depth_l1_m"]) == (0.01, 0.03)
    assert "ate_m" not in found
