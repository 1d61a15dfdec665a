"""Start the solver's process, read its output without blocking, and end it."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any

from ..errors import SolverMissing

_GRACE_S = 5.0  # Seconds that a cancelled solver gets to end before it is killed. Chosen by hand.
Line = str | dict[str, Any]  # A line of the log, or an event.
_NO_WINDOW = getattr(subprocess, "CREATE_NO_WINDOW", 0)


def of_base_python(command: Sequence[str], environment: Mapping[str, str]) -> tuple[Sequence[str], Mapping[str, str]]:
    """Return a command and an environment that run this Python without a launcher in between.

    On Windows, the Python of a virtual environment is a launcher that starts the base Python as a child process. Ending
    or measuring the started process would then affect only the launcher. The base Python reads the environment from a
    variable, as in ``multiprocessing.popen_spawn_win32``.
    """
    base = getattr(sys, "_base_executable", sys.executable)
    if sys.platform != "win32" or command[0] != sys.executable or base == sys.executable:
        return command, environment
    return [base, *command[1:]], {**environment, "__PYVENV_LAUNCHER__": sys.executable}


class SolverProcess:
    """A run of the solver, which writes JSON lines and ends when its standard input is closed.

    Two threads read the output of the process, so no method has to wait for it. If this program ends or crashes, the
    system closes the pipe, and the solver ends too. After ``cancel``, it is killed when its grace period ends.
    """

    def __init__(
        self, command: Sequence[str], environment: Mapping[str, str], folder: Path, grace_s: float | None = None
    ) -> None:
        self._grace_s = grace_s
        self._lines: SimpleQueue[Line] = SimpleQueue()
        self._cancelled_at: float | None = None
        pipe, (command, environment) = subprocess.PIPE, of_base_python(command, environment)
        try:
            streams = {"stdin": pipe, "stdout": pipe, "stderr": pipe, "encoding": "utf-8", "errors": "replace"}
            where = {"env": dict(environment), "cwd": folder, "creationflags": _NO_WINDOW}
            self._process = subprocess.Popen(list(command), **streams, **where)
        except OSError as error:
            message = f"The solver cannot be started: {error.strerror or error}."
            hint = "Choose another Python in the add-on's preferences, or clear the field to use Blender's own."
            raise SolverMissing(message, where=str(command[0]), hint=hint) from error
        ends = (self._process.stdout, self._process.stderr)
        self._readers = [threading.Thread(target=self._read, args=(end,), daemon=True) for end in ends]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        """Process ID of the solver."""
        return self._process.pid

    @property
    def cancelling(self) -> bool:
        """True once the user has cancelled the run."""
        return self._cancelled_at is not None

    @property
    def exit_code(self) -> int | None:
        """Exit code once the process has ended and all its output has been received, or None before that."""
        if self._process.poll() is None or any(reader.is_alive() for reader in self._readers):
            return None
        self._close_input()
        return self._process.returncode

    def received(self, most: int = 200) -> list[Line]:
        """Return up to ``most`` new events and lines. Kill the process if it hangs."""
        grace_s = _GRACE_S if self._grace_s is None else self._grace_s
        if self._cancelled_at is not None and time.monotonic() - self._cancelled_at > grace_s:
            self.kill()
        items: list[Line] = []
        while len(items) < most:
            try:
                items.append(self._lines.get_nowait())
            except Empty:
                break
        return items

    def cancel(self) -> None:
        """Ask the solver to remove unfinished files and to end."""
        if self._cancelled_at is None:
            self._cancelled_at = time.monotonic()
            self._close_input()

    def kill(self) -> None:
        """Kill the solver immediately."""
        self._close_input()
        if self._process.poll() is None:
            self._process.kill()

    def wait(self) -> int:
        """Wait, without an event loop, until the process has ended, and return its exit code."""
        code = self._process.wait()
        for reader in self._readers:
            reader.join()
        self._close_input()
        return code

    def _close_input(self) -> None:
        try:
            if self._process.stdin is not None:
                self._process.stdin.close()
        except OSError:
            return  # the process has just ended by itself

    def _read(self, stream: IO[str]) -> None:
        with stream:
            for line in stream:
                self._lines.put(event_in(line))


def event_in(line: str) -> Line:
    """Return the event that a line contains, or the line itself if it belongs to the log."""
    text = line.rstrip("\r\n")
    if not text.startswith("{"):
        return text
    try:
        event = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return event if isinstance(event, dict) and "event" in event else text
