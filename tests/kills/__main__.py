"""``python -m tests.kills --count 200 --seed 0`` kills programs at random; exits with 1 where one is
not resumed with every file whole. ``--only`` names one operation."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.kills.operations import OPERATIONS
from tests.kills.run import kill_once, measure, solved_folder

LATEST = 1.1
"""Of an operation's time: the last kills come when it has ended."""


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="operations, commas between")
    args = parser.parse_args()
    operations = [operation for operation in OPERATIONS if not args.only or operation.name in args.only.split(",")]
    rng, failures = np.random.default_rng(args.seed), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        solved = solved_folder(folder / "solved")
        measured = [measure(operation, folder / "work", solved) for operation in operations]
        for number in range(args.count):
            one, share = measured[number % len(measured)], float(rng.uniform(0, LATEST))
            when, wrong = kill_once(one, folder / "work", solved, share)
            failures += bool(wrong)
            said = "; ".join(wrong) or "whole"
            sys.stdout.write(f"{number + 1:4}  {one.operation.name:<12} at {100 * share:5.1f} %  {when:<24} {said}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{args.count} kills, {args.count - failures} resumed with every file whole\n")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
