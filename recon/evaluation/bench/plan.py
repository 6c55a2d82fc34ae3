"""What `uncle bench paper` runs: data sets, sets of sensors, settings, methods and seeds, as jobs in order."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from ...core.errors import ConfigError
from .methods import BASELINE, Catalogue
from .process import Record
from .variants import Settings, Variant

# setting -> (title, options of `uncle map`)
SETTINGS: dict[str, tuple[str, tuple[str, ...]]] = {
    "given": ("given poses", ()),
    "depth": ("depth-only tracking", ("--track", "--no-color")),
    "rgbd": ("RGB-D tracking", ("--track",)),
}
HOLD_OUT = 10  # every n-th frame, where there is no true mesh to score a map with given poses by
_PAPER_PAIRS = ("sgm+psmnet", "sl+psmnet")


@dataclass(frozen=True)
class Scene:
    """A data set as it was preprocessed into the run `base`. `sensors` are all but the ground truth."""

    name: str
    base: Path
    format: str
    sensors: tuple[str, ...]
    has_mesh: bool
    has_poses: bool
    frames: int
    source: str  # changes when the frames do

    @classmethod
    def of_run(cls, name: str, base: Path) -> Scene:
        """The scene `name` of the preprocessed run `base`."""
        manifest = json.loads((base / "manifest.json").read_text())
        frames = json.loads((base / "frames" / "frames.json").read_text())
        return cls(
            name, base, manifest["dataset_format"], tuple(s for s in manifest["sensors"] if s != "gt"),
            manifest["reference_mesh"] is not None, any(frame["T_world_camera"] for frame in frames), len(frames),
            manifest["stages"]["preprocess"]["config_hash"],
        )  # fmt: skip

    def sensor_sets(self, wanted: Sequence[str]) -> list[str]:
        """Those of `wanted` (joined by +) that this data set has; without any, each sensor, and pairs.

        The pairs are the paper's where there are any of them, else all.
        """
        if wanted:
            return [names for names in wanted if set(names.split("+")) <= set(self.sensors)]
        pairs = ["+".join(pair) for pair in combinations(self.sensors, 2)]
        paper = [pair for pair in _PAPER_PAIRS if set(pair.split("+")) <= set(self.sensors)]
        return [*self.sensors, *(paper or pairs)]


@dataclass(frozen=True)
class Choice:
    """What a user may choose. `sensors` empty: every one and pairs; `variants` are jobs of the ablation beside.

    `catalogue` holds the facts of all methods, also of those that are not chosen.
    """

    methods: tuple[str, ...]
    settings: tuple[str, ...] = tuple(SETTINGS)
    sensors: tuple[str, ...] = ()
    seeds: int = 1
    overrides: Settings = ()  # of every method, or of one: "METHOD:KEY=VALUE"
    protocol: str = "standard"
    device: str = "auto"
    variants: tuple[Variant, ...] = ()
    catalogue: Catalogue = field(default_factory=Catalogue)

    def overrides_of(self, method: str) -> Settings:
        """Those of every method and its own, as `uncle map --set` takes them."""
        found = []
        for override in self.overrides:
            name, _, setting = override.partition(":")
            if name == method:
                found.append(setting)
            elif name not in self.catalogue.facts:
                found.append(override)  # a plain one; a wrong name is then told by whoever reads the settings
        return tuple(found)

    def digest(self, scene: Scene, method: str) -> str:
        """Tells results apart that were not made alike."""
        made_with = [self.overrides_of(method), self.protocol, self.device, scene.source]
        return hashlib.sha256(json.dumps(made_with).encode()).hexdigest()[:8]


class Job(NamedTuple):
    """One map, scored; with `timed_in` (a session) only timed."""

    dataset: str
    sensors: str  # joined by +
    setting: str
    method: str
    variant: str  # of the ablation; "": none
    seed: int
    settings: Settings  # of the variant
    hold_out: int  # 0: none
    made_with: str  # `Choice.digest`
    timed_in: str = ""

    @property
    def key(self) -> str:
        """Name of the job in the file of results: everything but the settings of the variant."""
        names = [self.dataset, self.sensors, self.setting, self.method, self.variant, str(self.seed), self.timed_in]
        return "|".join(name for name in (*names, self.made_with) if name)


def plan(scenes: Iterable[Scene], choice: Choice) -> list[Job]:
    """Jobs in order: everything with the first seed, then with the next, so that one can stop at any time.

    Raises ConfigError if there is nothing to do.
    """
    scenes, jobs = list(scenes), []
    for seed in range(choice.seeds):
        for scene in scenes:
            for setting in possible_settings(scene, choice.settings):
                for sensors in scene.sensor_sets(choice.sensors):
                    jobs += _turn(scene, choice, setting, sensors, seed)
    if not jobs:
        there = "; ".join(f"{scene.name} has {', '.join(scene.sensors)}" for scene in scenes)
        raise ConfigError(f"no method can run on these sensors and settings ({there})")
    return jobs


def possible_settings(scene: Scene, wanted: Sequence[str]) -> list[str]:
    """Without poses there are none to be given."""
    return [setting for setting in wanted if setting != "given" or scene.has_poses]


def _turn(scene: Scene, choice: Choice, setting: str, sensors: str, seed: int) -> list[Job]:
    """Every method once."""
    hold_out = HOLD_OUT if setting == "given" and not scene.has_mesh else 0
    entries = [
        Variant(method, "", ())
        for method in choice.methods
        if not choice.catalogue.why_not(method, setting)
        and seed < choice.catalogue.runs_of(method, setting, choice.seeds)
    ]
    entries += choice.variants
    return [
        Job(scene.name, sensors, setting, method, variant, seed, settings, hold_out, choice.digest(scene, method))
        for method, variant, settings in entries
    ]


def is_done(job: Job, record: Record) -> bool:
    """Whether `record` is of the same settings: a variant may have changed since."""
    return tuple(record["settings"]) == job.settings


def with_timing(jobs: Sequence[Job], records: dict[str, Record], session: str) -> list[Job]:
    """`jobs`, and before them the baseline to be timed again where it was run by an earlier call than others will be.

    Times of different calls are not compared, because the machine may have changed.
    """
    done = {job: job.key in records and is_done(job, records[job.key]) for job in jobs}
    needed = {_place(job) for job, is_old in done.items() if not is_old and job.method != BASELINE}
    made_anew = {_place(job) for job, is_old in done.items() if not is_old and job.method == BASELINE}
    again = {_place(job): job._replace(timed_in=session) for job in jobs if job.method == BASELINE}
    return [*(job for place, job in again.items() if place in needed - made_anew), *jobs]


def _place(job: Job) -> tuple[str, ...]:
    return job.dataset, job.sensors, job.setting


# --- data sets -------------------------------------------------------------------------------------------------------
def scene_name(path: Path) -> str:
    """A name for the results: the last part of the path, with the part before where it says too little."""
    path = path.resolve()
    return f"{path.parent.name}_{path.name}" if re.fullmatch(r"(seq-)?\d+", path.name) else path.name


def synth_arguments(spec: str) -> tuple[str, list[str]] | None:
    """Name and `uncle synth` options of "synth:SEED[,frames=N][,size=N][,sensors=A+B]"; None for anything else.

    Raises ConfigError if it cannot be understood.
    """
    if not spec.startswith("synth:"):
        return None
    seed, *pairs = spec.removeprefix("synth:").split(",")
    values = dict(pair.partition("=")[::2] for pair in pairs)
    unknown = set(values) - {"frames", "size", "sensors"}
    numbers = [seed, *(values[name] for name in ("frames", "size") if name in values)]
    if unknown or not all(number.isdecimal() for number in numbers):
        raise ConfigError(f"cannot read {spec!r}; write synth:SEED or synth:SEED,frames=60,size=128,sensors=sl+sgm")
    options = [word for name in ("frames", "size") if name in values for word in (f"--{name}", values[name])]
    sensors = values.get("sensors", "sl+sgm+dense").split("+")
    name = "_".join([f"synth-{seed}", *(f"{key}{value}" for key, value in values.items() if key != "sensors")])
    name += f"_{values['sensors']}" if "sensors" in values else ""
    return name, ["--seed", seed, *options, "--sensors", *sensors]
