"""``python -m tests.kills.interrupts --count 200 --seed 0`` sends Ctrl-C to every verb in turn at a random moment.

``--each`` interrupts every verb of both programs once while it is at work, and writes a table of Markdown. A line for
each, with the CPU time from the signal to the end; a busy machine changes only the wall-clock time. Exits with 1 where
a verb took more than ``--limit`` seconds, ended by no name, or left something running or half-written.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.outputs import is_leftover
from tests.support.interrupted import Interrupted, interrupt
from tests.support.verb_inputs import COMMANDS, PLAYED_OAK, write_inputs

ROOT = Path(__file__).resolve().parents[2]
EARLIEST_S, LATEST_S = 0.05, 12.0
"""CPU time after which the signal comes, by the logarithm: from the first imports to the longest work.
Before that Python itself starts, and its own traceback names the signal."""
SOONEST_S = 0.2  # CPU time below which ``--each`` no longer looks for a moment at which a short verb is at work.
CANCELLED = 130
ENDS = (0, 3, CANCELLED)
"""Exit codes: it had done its work already, or had refused its input by name, or was cancelled."""
SOLVER, ADDON = "solver_backend", "blender_addon"


@dataclass(frozen=True)
class EndedVerb:
    """How a verb ended after its signal."""

    found: Interrupted
    wrong: list[str]
    """What is not as it should be."""
    new: list[str]
    """Files that it left, whole or for the next run to go on from."""

    def line(self) -> str:
        """Return it in words."""
        return f"{self.found.cpu_s:5.2f} s of CPU, {self.found.wall_s:5.2f} s on the clock  {self.state()}"

    def state(self) -> str:
        """Return what is wrong, or how it ended."""
        return "; ".join(self.wrong) or ("cancelled" if self.found.code == CANCELLED else "ended by itself")


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.kills.interrupts", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=2.0, help="seconds of CPU time")
    parser.add_argument("--only", default="", help="verbs whose name begins so")
    parser.add_argument("--each", action="store_true", help="every verb of both programs once")
    parser.add_argument("--program", choices=(SOLVER, ADDON), help="with --each: of this program alone")
    parser.add_argument("--after", type=float, default=2.0, help="with --each: seconds of CPU time before the signal")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        inputs = Path(name) / "inputs"
        inputs.mkdir()
        write_inputs(inputs)
        return _each(args, inputs) if args.each else _in_turn(args, inputs)


def _in_turn(args: argparse.Namespace, inputs: Path) -> int:
    rng, failures, worst = np.random.default_rng(args.seed), 0, (0.0, 0.0)
    verbs = [verb for verb in COMMANDS if verb.startswith(args.only)]
    for number in range(args.count):
        verb = verbs[number % len(verbs)]
        after_s = float(np.exp(rng.uniform(np.log(EARLIEST_S), np.log(LATEST_S))))
        ended = interrupt_verb((SOLVER, *COMMANDS[verb]), inputs, inputs.parent / "work", after_s, args.limit)
        failures += bool(ended.wrong)
        worst = max(worst[0], ended.found.cpu_s), max(worst[1], ended.found.wall_s)
        sys.stdout.write(f"{number + 1:4}  {verb:<22} after {after_s:6.2f} s  {ended.line()}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{args.count} interrupts, {args.count - failures} ended as they should; ")
    sys.stdout.write(f"at most {worst[0]:.2f} s of CPU, {worst[1]:.2f} s on the clock\n")
    return int(failures > 0)


def _each(args: argparse.Namespace, inputs: Path) -> int:
    from tests.support.addon_verb_inputs import ADDON_COMMANDS, write_addon_inputs

    write_addon_inputs(inputs)
    failures = 0
    sys.stdout.write(
        "| verb | stage | CPU s to the end | wall s | exit code | state | files |\n|---|---|---|---|---|---|---|\n"
    )
    for program, commands in ((SOLVER, COMMANDS), (ADDON, ADDON_COMMANDS)):
        for verb, command in commands.items():
            if args.program in (None, program) and verb.startswith(args.only):
                ended = _at_work((program, *command), inputs, args.after, args.limit)
                failures += bool(ended.wrong)
                found = ended.found
                sys.stdout.write(
                    f"| `{program} {verb}` | {found.stage or '–'} | {found.cpu_s:.2f} | {found.wall_s:.2f} | "
                    f"{found.code} | {ended.state()} | {', '.join(ended.new[:4]) or '–'} |\n"
                )
                sys.stdout.flush()
    return int(failures > 0)


def _at_work(command: Sequence[str], inputs: Path, after_s: float, limit_s: float) -> EndedVerb:
    """Interrupt a verb while it is at work: sooner where it ends before."""
    while True:
        ended = interrupt_verb(command, inputs, inputs.parent / "work", after_s, limit_s)
        after_s /= 2
        if ended.found.before_end or ended.wrong or after_s < SOONEST_S:
            return ended


def interrupt_verb(command: Sequence[str], inputs: Path, folder: Path, after_s: float, limit_s: float) -> EndedVerb:
    """Interrupt a verb once.

    Args:
        command: module, verb and what is typed after it.
        inputs: what ``write_inputs`` wrote; links of its files are used.
        folder: where the verb runs, made anew.
        after_s: CPU seconds before the signal.
        limit_s: CPU seconds that the end may take.
    """
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(inputs, folder, symlinks=True, copy_function=os.link)
    before = set(folder.rglob("*"))
    places = {"PYTHONPATH": f"{ROOT}{os.pathsep}{PLAYED_OAK}"}
    found = interrupt(("-m", *command, "--json"), folder, after_s, places)
    wrong = []
    if found.code not in ENDS and not (found.reported and found.code == -signal.SIGINT):  # while Python itself ended
        wrong.append(f"exit code {found.code}: {found.errors[-400:]}")
    if "Traceback" in found.errors or "KeyboardInterrupt" in found.errors:
        wrong.append(f"unnamed: {found.errors[-400:]}")
    if found.cpu_s > limit_s:
        wrong.append(f"{found.cpu_s:.1f} s of CPU until its end")
    if found.left_running:
        wrong.append("a process of it still runs")
    new = [path for path in sorted(set(folder.rglob("*")) - before) if path.is_file()]
    wrong += [f"left {path.name}" for path in new if is_leftover(path.name)]
    return EndedVerb(found, wrong, [str(path.relative_to(folder)) for path in new])


if __name__ == "__main__":
    sys.exit(main())
