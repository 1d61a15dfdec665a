"""The long run: ``python -m tests.fuzz --count 100000 --seed 0``; exits with 1 where a reader broke.

Inputs are tried in a child process with a limit of memory, so that a crash is counted like any other finding.
"""

from __future__ import annotations

import argparse
import pickle
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.fuzz.run import GOOD, Tried, fuzz, keep, table
from tests.fuzz.targets import TARGETS

MEMORY_BYTES = 2 * 2**30
BATCH = 20_000
"""Inputs a child."""


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--only", help="readers whose name begins so")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write the files of input --first here")
    parser.add_argument("--child", type=Path, metavar="DIR", help=argparse.SUPPRESS)
    args = parser.parse_args()
    targets = [target for target in TARGETS if target.name.startswith(args.only or "")]
    if args.keep is not None:
        turns = [target for target in targets for _ in range(target.weight)]
        sys.stdout.write(f"{keep(turns[args.first % len(turns)], args.seed, args.first, args.keep)}\n")
        return 0
    if args.child is not None:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        found = fuzz(targets, args.count, args.seed, args.first, args.child / "current")
        (args.child / "tried").write_bytes(pickle.dumps(found))
        return 0
    tried = _by_children(args.count, args.seed, args.first, args.only or "")
    sys.stdout.write(table(tried) + "\n")
    return int(any(outcome not in GOOD for _, outcome in tried.counts))


def _by_children(count: int, seed: int, first: int, only: str) -> Tried:
    """Try the inputs batch by batch; one that ends its child is counted, and the next child goes on after it."""
    whole, at = Tried(), first
    while at < first + count:
        number = min(BATCH, first + count - at)
        with tempfile.TemporaryDirectory() as folder:
            options = [
                "--child",
                folder,
                "--count",
                str(number),
                "--seed",
                str(seed),
                "--first",
                str(at),
                "--only",
                only,
            ]
            done = subprocess.run([sys.executable, "-m", "tests.fuzz", *options], check=False)
            if done.returncode == 0:
                _add(whole, pickle.loads((Path(folder) / "tried").read_bytes()))
                at += number
            else:
                crashed, _, name = (Path(folder) / "current").read_text().partition(" ")
                whole.counts[name, "crash"] += 1
                whole.bad[f"{name}: the process ended with {done.returncode}"] = f"input {crashed}"
                at = int(crashed) + 1
        sys.stderr.write(f"{at - first:,} inputs\n")
    return whole


def _add(whole: Tried, part: Tried) -> None:
    whole.counts.update(part.counts)
    whole.bad.update({key: value for key, value in part.bad.items() if key not in whole.bad})
    for name, seconds in part.slowest.items():
        whole.slowest[name] = max(seconds, whole.slowest.get(name, 0.0))


if __name__ == "__main__":
    sys.exit(main())
