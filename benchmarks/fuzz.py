"""Damaged inputs for every parser and command until the time is up; see README.md."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path


def main() -> int:
    """Exit code 1 if an input did not end in a right result or one line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0, help="of the first batch; every batch has the next one")
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="TEXT", help="targets whose name contains one of these"
    )
    parser.add_argument("--out", type=Path, default=Path("fuzz-out"), help="corpus, defects and table")
    parser.add_argument(
        "--repeat", type=Path, metavar="FOLDER", help="try a defect of OUT/defects again, in this process"
    )
    parser.add_argument("--worker", nargs=2, type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        from fuzzing import worker

        worker.main(*arguments.worker)
        return 0
    if arguments.repeat:
        return _repeat(arguments.repeat)
    return _fuzz(arguments)


def _fuzz(arguments: argparse.Namespace) -> int:
    from fuzzing.runner import Fuzzer
    from fuzzing.runs import build
    from fuzzing.targets import TARGETS

    names = [name for name in TARGETS if not arguments.only or any(text in name for text in arguments.only)]
    began = time.monotonic()
    _say("making the corpus")
    build(arguments.out / "corpus")
    fuzzer = Fuzzer(names, arguments.out.resolve(), arguments.seed, _say)
    try:
        fuzzer.run(60 * arguments.minutes)
    except KeyboardInterrupt:
        _say("stopped")
    table = fuzzer.table(time.monotonic() - began)
    (arguments.out / "table.md").write_text(table)
    print(table)
    return int(any(tally.defects for tally in fuzzer.tallies.values()))


def _repeat(folder: Path) -> int:
    from fuzzing.targets import TARGETS
    from fuzzing.trial import call

    defect = json.loads((folder / "defect.json").read_text())
    outcome = call(TARGETS[defect["target"]], folder / "input" / defect["main"])
    print(f"{outcome.kind}: {outcome.text or 'no message'}")
    return int(outcome.is_failure)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
