"""Many inputs in child processes with limits, so that one that crashes or hangs is counted like any other finding."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.fuzz.run import BATCH, CHANGES, fuzz, scratch_folder
from tests.fuzz.target import Target
from tests.fuzz.tried import Tried

MEMORY_BYTES = 2 * 2**30
HANG_S, WAIT_S = 60, 600
"""A child that stays at one input for so long of processor time, or on the wall, is ended: its own limits did not
reach it."""
_POLL_S = 0.2


def run_child(
    targets: Sequence[Target], count: int, seed: int, first: int, folder: Path, mutator: str = CHANGES
) -> None:
    """Be the child: try the inputs within the limit of memory, and leave the counts in the folder."""
    # What it takes, not what it maps: Blender's module alone maps more than half of this without touching it.
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    fuzz(targets, count, seed, first, folder / "current", mutator).save(folder / "tried", seed, first + count)


def campaign(
    whole: Tried, count: int, seed: int, first: int, only: str, after: Callable[[Tried, int], None], batch: int = BATCH,
    mutator: str = CHANGES, until: Callable[[], bool] = lambda: False,
) -> Tried:  # fmt: skip
    """Try inputs in children and return their counts, those of ``whole`` with them.

    Args:
        whole: counts of earlier inputs.
        count: of inputs.
        seed: of the mutations.
        first: number of the first input.
        only: readers whose name begins so.
        after: called with the counts and the next input after every child.
        batch: inputs a child.
        mutator: what makes the inputs.
        until: whether to stop before the next child.
    """
    at = first
    while at < first + count and not until():
        done, part = _one_child(min(batch, first + count - at), seed, at, only, mutator)
        whole.add(part)
        at += done
        after(whole, at)
    return whole


def _one_child(count: int, seed: int, first: int, only: str, mutator: str) -> tuple[int, Tried]:
    """Return how many inputs were tried and their counts; the last of them may be one that ended its child."""
    with scratch_folder() as folder:
        options = {"--child": folder, "--count": count, "--seed": seed, "--first": first, "--only": only}
        options |= {"--mutator": mutator}
        words = [str(word) for option in options.items() for word in option]
        child = subprocess.Popen([sys.executable, "-m", "tests.fuzz", *words])
        hung = _watch(child, folder / "current")
        if child.returncode == 0:
            return count, Tried.load(folder / "tried")[0]
        if not (folder / "current").exists():
            raise RuntimeError(f"The child ended with {child.returncode} before its first input.")
        number, _, reader = (folder / "current").read_text().rstrip().partition(" ")
    before = int(number) - first
    part = _one_child(before, seed, first, only, mutator)[1] if before else Tried()
    part.count(reader, mutator, "hang" if hung else "crash")
    part.bad[f"{reader}: the process ended with {child.returncode}"] = f"input {number} of seed {seed} by {mutator}"
    return before + 1, part


def _processor_s(pid: int) -> float:
    """Return the seconds of processor time of a process; where the system has no /proc, those on the wall."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError):
        return time.monotonic()


def _watch(child: subprocess.Popen[bytes], current: Path) -> bool:
    """Wait for the child, end it where it stays at one input for too long, and return whether that was so."""
    seen, since, used = "", time.monotonic(), 0.0
    while child.poll() is None:
        now = current.read_text() if current.exists() else ""
        if now != seen or not now:  # a child that still loads its program is at no input
            seen, since, used = now, time.monotonic(), _processor_s(child.pid)
        elif _processor_s(child.pid) - used > HANG_S or time.monotonic() - since > WAIT_S:
            child.kill()
            child.wait()
            return True
        time.sleep(_POLL_S)
    return False
