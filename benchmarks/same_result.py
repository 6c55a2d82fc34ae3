"""Digests of fixed-seed results, to show that a change of the code changes no result; see README.md.

Each case runs `uncle preprocess`, `uncle map` (CPU, seed 0) and `uncle mesh` in a new run directory.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uncle.recon.core.errors import ConfigError, RunError, UncleError
from uncle.recon.core.files import write_text
from uncle.recon.evaluation.bench.process import uncle
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.manifest import library_versions

Digests = dict[str, str]  # part of the result -> SHA-256
CASE = re.compile(r"(?P<name>[\w.-]+)=(?P<dataset>[^:]+):(?P<frames>(?:-?\d*(?::-?\d*){1,2})?):(?P<options>.*)")
SHORT_NICE = "--set nice_mapping.iterations=10 --set nice_mapping.first_iterations=60"
# Built-in cases over the folder of --data.
FULL_CASES = (
    "given=rooms/living_room::--sensors sl psmnet",
    "track=rooms/living_room::--sensors sl psmnet --track",
    "kitchen=7scenes/redkitchen/seq-01:0:60:",
    "kitchen_track=7scenes/redkitchen/seq-01:0:60:--track",
    "uncle_paper=rooms/living_room:0:20:--sensors sl psmnet --method uncle-paper",
    "vox_fusion=rooms/living_room:0:20:--sensors sl psmnet --method vox-fusion",
    "senfunet=rooms/living_room:0:40:--sensors sl psmnet --method senfunet",
)
# Built-in cases over a synthetic room, which --quick makes.
QUICK_CASES = (
    "given=room:0:40:--sensors sl sgm",
    "track=room:0:40:--sensors sl sgm --track",
    "depth_track=room:0:40:--sensors sl --track --no-color",
    f"uncle_paper=room:0:4:--sensors sl sgm --method uncle-paper {SHORT_NICE}",
    f"nice_slam_pre=room:0:4:--sensors sl sgm --method nice-slam-pre {SHORT_NICE}",
    "vox_fusion=room:0:5:--sensors sl --method vox-fusion",
    "senfunet=room:0:20:--sensors sl sgm --method senfunet",
    "tsdf=room:0:40:--sensors sl sgm --method tsdf",
)
QUICK_ROOM = ("--frames", "40", "--size", "192", "--seed", "0", "--sensors", "sl", "sgm")


@dataclass(frozen=True)
class Case:
    """One reconstruction: frames as START:STOP:STEP, "" for all; options of `uncle map`."""

    name: str
    dataset: Path
    frames: str
    options: tuple[str, ...]


def parse_case(text: str, data: Path = Path()) -> Case:
    """A case written as NAME=DATASET:FRAMES:MAP_OPTIONS, DATASET relative to `data`. Raises ConfigError."""
    match = CASE.fullmatch(text)
    if match is None:
        raise ConfigError(f"cannot read the case {text!r}; write NAME=DATASET:START:STOP:MAP_OPTIONS (all: DATASET::)")
    return Case(match["name"], data / match["dataset"], match["frames"], tuple(shlex.split(match["options"])))


def run_case(case: Case, run: Path) -> Digests:
    """Reconstruct a case in the run directory `run` and return the digests of the result. Raises RunError."""
    frames = ["--frames", case.frames] if case.frames else []
    uncle("preprocess", case.dataset, "--run", run, "--overwrite", *frames)
    uncle("map", "--run", run, "--overwrite", "--device", "cpu", "--seed", "0", *case.options)
    uncle("mesh", "--run", run, "--overwrite")
    return digests_of(run)


def digests_of(root: Path) -> Digests:
    """Digests of mesh, trajectory, beta maps and tracking record of a finished run, as far as it has them.

    Of the mesh the arrays count (the body of the PLY file), not the names of its properties.
    """
    run = RunDirectory(root)
    parts = {"mesh": _sha256(run.mesh_path.read_bytes().split(b"end_header\n", 1)[1])}
    parts["trajectory"] = _sha256(run.trajectory_path.read_bytes())
    beta_maps = sorted((root / "beta").rglob("*.png"))
    if beta_maps:
        listing = [f"{path.relative_to(root)} {_sha256(path.read_bytes())}" for path in beta_maps]
        parts["beta"] = _sha256("\n".join(listing).encode())
    if run.tracking_path.is_file():
        parts["tracking"] = _sha256(run.tracking_path.read_bytes())
    return parts


def differences(results: dict[str, Digests], reference: dict[str, Digests]) -> list[str]:
    """One line for each case whose digests are not those of the reference."""
    lines = []
    for name, digests in results.items():
        expected = reference.get(name)
        if expected is None:
            lines.append(f"{name}: not in the reference")
            continue
        parts = [part for part in sorted({*digests, *expected}) if digests.get(part) != expected.get(part)]
        if parts:
            lines.append(f"{name}: {', '.join(parts)} differ")
    return lines


def load_results(path: Path) -> dict[str, Digests]:
    """The digests by case of a file that an earlier call wrote. Raises RunError."""
    try:
        cases = json.loads(path.read_text())["cases"]
        return {name: dict(digests) for name, digests in cases.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RunError(f"cannot read {path}: {error!r}; make it with this program, without --against") from error


def save_results(path: Path, results: dict[str, Digests]) -> None:
    """Write the digests with the machine and the versions they depend on. Raises RunError."""
    content: dict[str, Any] = {"machine": platform.machine(), "versions": library_versions(), "cases": results}
    write_text(path, json.dumps(content, indent=1) + "\n")


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def chosen_cases(options: argparse.Namespace) -> list[Case]:
    """The cases of the command line; makes the room of --quick. Raises ConfigError, RunError."""
    cases = [parse_case(text) for text in options.cases]
    if options.data is not None:
        cases += [parse_case(text, options.data) for text in FULL_CASES]
    if options.quick:
        room = options.work / "data" / "room"
        if not (room / "synth.json").exists():
            uncle("synth", room, "--overwrite", *QUICK_ROOM)
        cases += [parse_case(text, room.parent) for text in QUICK_CASES]
    if options.only:
        cases = [case for case in cases if case.name in options.only]
    names = [case.name for case in cases]
    if not cases:
        raise ConfigError("no case is left; give cases, --data or --quick, and names of these to --only")
    if len(set(names)) < len(names):
        raise ConfigError(f"two cases have the same name: {', '.join(names)}")
    return cases


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="NAME=DATASET:FRAMES:MAP_OPTIONS")
    parser.add_argument("--data", type=Path, metavar="FOLDER", help="also the built-in cases over the data in FOLDER")
    parser.add_argument("--quick", action="store_true", help="also the built-in cases over a small synthetic room")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="run only these cases")
    parser.add_argument("--against", type=Path, metavar="FILE", help="compare with the digests of an earlier call")
    parser.add_argument("--out", type=Path, default=Path("same-result.json"), metavar="FILE",
                        help="file for the digests [same-result.json]")  # fmt: skip
    parser.add_argument("--work", type=Path, default=Path("same-result"), metavar="FOLDER",
                        help="folder for the run directories [same-result]")  # fmt: skip
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases, write the digests, and compare them; 1 if a case fails or differs."""
    options = parse(arguments)
    reference = load_results(options.against) if options.against is not None else None
    results: dict[str, Digests] = {}
    failed = 0
    for case in chosen_cases(options):
        try:
            results[case.name] = run_case(case, options.work / case.name)
        except UncleError as error:
            failed += 1
            print(f"{case.name}: failed: {error}", flush=True)
            continue
        save_results(options.out, results)
        print(f"{case.name}: done", flush=True)
    if reference is None:
        return 1 if failed else 0
    lines = differences(results, reference)
    print("\n".join(lines) or f"all {len(results)} cases are equal")
    return 1 if failed or lines else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
