"""``python -m tests.kills.interrupts --count 200 --seed 0`` sends Ctrl-C to every verb in turn at a random moment.

A line for each, with the CPU time from the signal to the end; a busy machine changes only the time on the clock.
Exits with 1 where a verb took more than ``--limit`` seconds, ended by no name, or left something running.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

from solver_backend.exchange.unfinished import is_leftover
from tests.support.interrupted import interrupt
from tests.support.verb_inputs import COMMANDS, PLAYED_OAK, write_inputs

ROOT = Path(__file__).resolve().parents[2]
EARLIEST_S, LATEST_S = 0.05, 12.0
"""CPU time after which the signal comes, by the logarithm: from the first imports to the longest work.
Before that Python itself starts, and its own traceback names the signal."""
ENDS = (0, 3, 130)
"""Exit codes: it had done its work already, or had refused its input by name, or was cancelled."""


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.kills.interrupts", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=2.0, help="seconds of CPU time")
    parser.add_argument("--only", default="", help="verbs whose name begins so")
    args = parser.parse_args()
    rng, failures, worst = np.random.default_rng(args.seed), 0, (0.0, 0.0)
    verbs = [verb for verb in COMMANDS if verb.startswith(args.only)]
    with tempfile.TemporaryDirectory() as name:
        inputs = Path(name) / "inputs"
        inputs.mkdir()
        write_inputs(inputs)
        for number in range(args.count):
            verb = verbs[number % len(verbs)]
            after_s = float(np.exp(rng.uniform(np.log(EARLIEST_S), np.log(LATEST_S))))
            wrong, cpu_s, wall_s = interrupt_verb(verb, inputs, Path(name) / "work", after_s, args.limit)
            failures += bool(wrong)
            worst = max(worst[0], cpu_s), max(worst[1], wall_s)
            told = f"{cpu_s:5.2f} s of CPU, {wall_s:5.2f} s on the clock  {'; '.join(wrong) or 'ended'}"
            sys.stdout.write(f"{number + 1:4}  {verb:<22} after {after_s:6.2f} s  {told}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{args.count} interrupts, {args.count - failures} ended as they should; ")
    sys.stdout.write(f"at most {worst[0]:.2f} s of CPU, {worst[1]:.2f} s on the clock\n")
    return int(failures > 0)


def interrupt_verb(
    verb: str, inputs: Path, folder: Path, after_s: float, limit_s: float
) -> tuple[list[str], float, float]:
    """Interrupt a verb once; return what is wrong, and the seconds from signal to end, of CPU and on the clock.

    Args:
        verb: of ``COMMANDS``.
        inputs: what ``write_inputs`` wrote; links of its files are used.
        folder: where the verb runs, made anew.
        after_s: CPU seconds before the signal.
        limit_s: CPU seconds that the end may take.
    """
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(inputs, folder, symlinks=True, copy_function=os.link)
    before = set(folder.rglob("*"))
    places = {"PYTHONPATH": f"{ROOT}{os.pathsep}{PLAYED_OAK}"}
    found = interrupt(("-m", "solver_backend", *COMMANDS[verb]), folder, after_s, places)
    wrong = []
    if found.code not in ENDS:
        wrong.append(f"exit code {found.code}: {found.errors[-400:]}")
    if "Traceback" in found.errors or "KeyboardInterrupt" in found.errors:
        wrong.append(f"unnamed: {found.errors[-400:]}")
    if found.cpu_s > limit_s:
        wrong.append(f"{found.cpu_s:.1f} s of CPU until its end")
    if found.left_running:
        wrong.append("a process of it still runs")
    wrong += [f"left {path.name}" for path in sorted(set(folder.rglob("*")) - before) if is_leftover(path.name)]
    return wrong, found.cpu_s, found.wall_s


if __name__ == "__main__":
    sys.exit(main())
