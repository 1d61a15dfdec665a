"""A program that is interrupted as Ctrl-C interrupts it, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

from tests.support.cpu_time import cpu_of, states_of

WAIT_S = 60.0  # On the wall: a program that takes no CPU time and does not end is stuck.
GONE_S = 5.0  # In which children that were also interrupted are gone after the program itself.
_LOOK_S = 0.01


@dataclass(frozen=True)
class Interrupted:
    """How a program ended after its signal."""

    code: int  # Exit code.
    cpu_s: float  # CPU time from the signal to the end, that of the program's children with it.
    wall_s: float  # The same on the clock, which also counts what other programs took.
    errors: str  # What it wrote to standard error.
    left_running: bool  # Whether a process of it is still there.
    before_end: bool  # Whether the signal came before it had ended.
    stage: str  # What its last line of progress was about; empty where it had written none as JSON.
    reported: bool  # Whether it had written its result as JSON.


def interrupt(
    command: Sequence[str], folder: Path, after_s: float, more: Mapping[str, str] | None = None
) -> Interrupted:
    """Start a program, let it have so much CPU time, send it SIGINT, and wait for its end.

    Args:
        command: after the interpreter.
        folder: in which it runs.
        after_s: seconds of CPU time of the program and its children before the signal.
        more: environment variables beside this process's own.
    """
    with TemporaryFile() as written:
        return _interrupt(command, folder, after_s, more or {}, written)


def _interrupt(
    command: Sequence[str], folder: Path, after_s: float, more: Mapping[str, str], written: IO[bytes]
) -> Interrupted:
    process = subprocess.Popen(
        [sys.executable, *command], cwd=folder, stdin=subprocess.DEVNULL, stdout=written,
        stderr=subprocess.PIPE, start_new_session=True, env=os.environ | more,
    )  # fmt: skip
    try:
        begin = time.monotonic()
        while cpu_of(process.pid) < after_s and not _has_ended(process.pid) and time.monotonic() < begin + WAIT_S:
            time.sleep(_LOOK_S)
        before_end = not _has_ended(process.pid)
        used, begin = cpu_of(process.pid), time.monotonic()
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process of the command
        while not _has_ended(process.pid) and time.monotonic() < begin + WAIT_S:
            time.sleep(_LOOK_S)
        wall, cpu = time.monotonic() - begin, cpu_of(process.pid) - used
        gone = time.monotonic() + GONE_S
        while (left := _is_running(process.pid)) and time.monotonic() < gone:
            time.sleep(_LOOK_S)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        errors = process.communicate()[1].decode("utf-8", "replace")
    stage, reported = _events_of(written)
    return Interrupted(process.returncode, max(cpu, 0.0), wall, errors, left, before_end, stage, reported)


def _events_of(written: IO[bytes]) -> tuple[str, bool]:
    """Return the stage of the last event of progress that a program wrote, and whether its result is among them."""
    written.seek(0)
    stage, reported = "", False
    for line in written.read().splitlines():
        with suppress(ValueError, TypeError, KeyError):
            event = json.loads(line)
            stage = event["stage"] if event["event"] == "progress" else stage
            reported |= event["event"] == "result"
    return stage, reported


def _has_ended(pid: int) -> bool:
    """Return whether the process has ended; it is not waited for, so that its CPU time can still be read."""
    return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _is_running(group: int) -> bool:
    return any(state != "Z" for state in states_of(group))
