"""What is run, in which order, and what is not run again."""

from dataclasses import replace
from pathlib import Path

import pytest
from uncle.recon.core.errors import ConfigError
from uncle.recon.evaluation.bench import methods
from uncle.recon.evaluation.bench.plan import (
    Choice,
    Job,
    Scene,
    is_done,
    plan,
    scene_name,
    synth_arguments,
    with_timing,
)
from uncle.recon.evaluation.bench.variants import variants_of_methods
from uncle.recon.methods.registry import method_specs

ROOM = Scene("room", Path("room"), "senfunet", ("sl", "sgm", "psmnet"), True, True, 130, "abc")
FILM = Scene("film", Path("film"), "tum", ("depth",), False, True, 99, "def")
PHONE = Scene("phone", Path("phone"), "folder", ("depth",), False, False, 50, "ghi")
CATALOGUE = methods.Catalogue(method_specs())
BOTH = Choice(("uncle", "tsdf"), seeds=2, catalogue=CATALOGUE)


def test_every_sensor_and_the_papers_pairs_are_taken_by_default():
    assert ROOM.sensor_sets(()) == ["sl", "sgm", "psmnet", "sgm+psmnet", "sl+psmnet"]
    assert replace(ROOM, sensors=("sl", "sgm")).sensor_sets(()) == ["sl", "sgm", "sl+sgm"]
    assert FILM.sensor_sets(()) == ["depth"]
    assert ROOM.sensor_sets(("sl+sgm", "tof", "sl+tof", "sgm")) == ["sl+sgm", "sgm"]


def test_seeds_go_round_and_the_baseline_draws_nothing_with_given_poses():
    jobs = plan([ROOM], replace(BOTH, sensors=("sl",)))
    turns = [[(job.setting, job.method) for job in jobs if job.seed == seed] for seed in range(2)]
    everything = [(setting, method) for setting in ("given", "depth", "rgbd") for method in ("uncle", "tsdf")]
    assert turns == [everything, [pair for pair in everything if pair != ("given", "tsdf")]]
    assert [job.seed for job in jobs] == sorted(job.seed for job in jobs)
    assert len({job.key for job in jobs}) == len(jobs)


def test_a_map_without_a_true_mesh_is_scored_by_frames_held_out():
    held_out = {(job.dataset, job.setting): job.hold_out for job in plan([ROOM, FILM], BOTH)}
    assert held_out["film", "given"] == 10
    assert {count for place, count in held_out.items() if place != ("film", "given")} == {0}


def test_without_poses_there_is_nothing_with_given_poses():
    assert {job.setting for job in plan([PHONE], BOTH)} == {"depth", "rgbd"}
    with pytest.raises(ConfigError, match="phone has depth"):
        plan([PHONE], replace(BOTH, settings=("given",)))
    with pytest.raises(ConfigError, match="no method can run"):
        plan([ROOM], replace(BOTH, sensors=("lidar",)))


def test_a_method_is_not_asked_for_what_it_cannot_do():
    jobs = plan([ROOM], replace(BOTH, methods=("senfunet",), sensors=("sl+psmnet",)))
    assert {job.setting for job in jobs} == {"given"}
    assert "tracker" in CATALOGUE.why_not("senfunet", "rgbd")
    assert CATALOGUE.why_not("senfunet", "given") is None


def test_tables_list_methods_in_the_order_of_the_registry_and_strangers_last():
    assert CATALOGUE.in_order(["stranger", "tsdf", "uncle", "tsdf"]) == ["uncle", "tsdf", "stranger"]


def test_a_method_without_facts_can_do_everything_and_draws_at_random():
    assert CATALOGUE.why_not("stranger", "rgbd") is None
    assert CATALOGUE.runs_of("stranger", "given", 3) == 3
    assert CATALOGUE.settings_of("stranger", "depth") == ()
    assert CATALOGUE.settings_of("nice-slam", "depth") == ("nice.color=false",)


def test_the_papers_pair_is_tested_first():
    there = ["uncle", "uncle-paper", "nice-slam", "tsdf"]
    pairs = methods.tested_pairs(there)
    assert pairs[0] == ("uncle-paper", "nice-slam")
    assert set(pairs) == {
        ("uncle-paper", "nice-slam"), ("uncle", "nice-slam"), ("tsdf", "nice-slam"), ("uncle", "uncle-paper"),
        ("uncle", "tsdf"),
    }  # fmt: skip
    assert methods.tested_pairs(["uncle", "tsdf"]) == [("uncle", "tsdf")]


def test_results_of_other_settings_or_frames_have_other_keys():
    choices = [BOTH, replace(BOTH, overrides=("field.iterations=0",)), replace(BOTH, protocol="paper")]
    choices += [replace(BOTH, device="cuda")]
    keys = [
        {job.key for job in plan([scene], choice)} for scene in (ROOM, replace(ROOM, source="x")) for choice in choices
    ]
    assert sum(map(len, keys)) == len(set().union(*keys))
    more = {job.key for job in plan([ROOM], replace(BOTH, seeds=3, methods=("tsdf",)))}
    assert keys[0] & more  # more seeds or fewer methods share what there is


def test_settings_of_one_method_leave_the_others_alone():
    choice = replace(BOTH, overrides=("field.rays=64", "uncle:field.levels=[2,4]", "tsdf:fusion.min_observations=1"))
    assert choice.overrides_of("uncle") == ("field.rays=64", "field.levels=[2,4]")
    assert choice.overrides_of("tsdf") == ("field.rays=64", "fusion.min_observations=1")
    assert replace(BOTH, overrides=("field.name=a:b",)).overrides_of("uncle") == ("field.name=a:b",)
    assert replace(BOTH, overrides=("magic:a=1",)).overrides_of("uncle") == ("magic:a=1",)  # told as unknown later
    fewer = replace(choice, overrides=choice.overrides[:2])
    assert choice.digest(ROOM, "uncle") == fewer.digest(ROOM, "uncle")
    assert choice.digest(ROOM, "tsdf") != fewer.digest(ROOM, "tsdf")


def test_a_variant_that_changed_is_not_done():
    job = Job("room", "sl", "given", "uncle", "mine", 0, ("field.rays=64",), 0, "abc")
    assert is_done(job, {"settings": ["field.rays=64"]})
    assert not is_done(job, {"settings": ["field.rays=128"]})


def test_variants_of_the_ablation_run_beside_the_methods():
    choice = Choice(("tsdf",), ("given",), ("sl",), variants=tuple(variants_of_methods(["uncle"])))
    jobs = plan([ROOM], choice)
    assert [(job.method, job.variant) for job in jobs] == [("tsdf", ""), ("uncle", "unweighted"), ("uncle", "uncle")]
    assert len({job.key for job in jobs}) == 3


def test_the_baseline_is_timed_again_beside_new_runs_of_others():
    jobs = plan([ROOM], replace(BOTH, settings=("given",), sensors=("sl", "sgm"), seeds=1))
    tsdf, uncle = ([job for job in jobs if job.method == method] for method in ("tsdf", "uncle"))
    old = {job.key: {"settings": []} for job in [tsdf[0], *uncle[1:]]}
    again = with_timing(jobs, old, "now")
    assert again[0] == tsdf[0]._replace(timed_in="now")  # sl: made by an earlier call than uncle will be
    assert again[1:] == jobs  # sgm: the baseline itself is missing, or nothing is
    assert again[0].key not in old
    assert with_timing(jobs, {job.key: {"settings": []} for job in jobs}, "now") == jobs


@pytest.mark.parametrize(
    ("path", "name"),
    [("a/room", "room"), ("redkitchen/seq-01", "redkitchen_seq-01"), ("office_0/1", "office_0_1"), ("a/room/", "room")],
)
def test_names_of_data_sets(path, name):
    assert scene_name(Path(path)) == name


def test_made_rooms_are_described_by_their_name():
    assert synth_arguments("rooms/living_room") is None
    assert synth_arguments("synth:7") == ("synth-7", ["--seed", "7", "--sensors", "sl", "sgm", "dense"])
    name, options = synth_arguments("synth:7,size=96,frames=16,sensors=sl+tof")
    assert options == ["--seed", "7", "--frames", "16", "--size", "96", "--sensors", "sl", "tof"]
    assert name != synth_arguments("synth:7,size=97,frames=16,sensors=sl+tof")[0]
    for wrong in ("synth:", "synth:x", "synth:7,sizes=3", "synth:7,size=big"):
        with pytest.raises(ConfigError, match="write synth:SEED"):
            synth_arguments(wrong)
