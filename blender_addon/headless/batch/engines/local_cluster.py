"""Run a Dask scheduler and its workers on this machine."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from ....backend_environment import backend_folder

_ROOT = Path(__file__).resolve().parents[4]
_AGAIN_S = 2.0
"""Shortest time between two starts of a process, in seconds."""
_END_S = 2.0  # Seconds that a worker gets to end. Chosen by hand.


class LocalCluster:
    """A Dask scheduler and several workers that only this machine can reach.

    Args:
        workers: number of workers, with one thread each.
        memory_mb: megabytes that all workers together declare to Dask as their memory, or None.
        folder: working folder of Dask.
    """

    def __init__(self, workers: int, memory_mb: float | None, folder: Path) -> None:
        port = _some_port()
        self.address = f"tcp://127.0.0.1:{port}"
        self._folder = folder
        # Even without a dashboard, Dask serves metrics over HTTP, by default on all network addresses.
        own = ["--dashboard-address", "127.0.0.1:0", *([] if find_spec("bokeh") else ["--no-dashboard"])]
        own += ["--preload", f"{__package__}.ends_with_parent"]
        scheduler = ["-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), *own]
        alone = "--nthreads 1 --no-nanny --host 127.0.0.1 --memory-limit 0 --no-dashboard --death-timeout 30"
        worker = ["-m", "distributed.cli.dask_worker", self.address, *alone.split(), "--local-directory", str(folder)]
        worker += ["--dashboard-address", "127.0.0.1:0", "--preload", f"{__package__}.ends_with_parent"]
        worker += ["--resources", f"memory_mb={memory_mb / workers:.0f}"] if memory_mb else []
        self._commands = [scheduler, *([worker] * workers)]
        self.processes: list[subprocess.Popen[bytes] | None] = [None] * len(self._commands)
        """Processes of the scheduler and of the workers, in this order."""
        self._started = [-_AGAIN_S] * len(self._commands)
        self.tend()

    def tend(self) -> None:
        """Restart the scheduler or a worker if its process has ended."""
        for k, process in enumerate(self.processes):
            late = time.monotonic() - self._started[k] > _AGAIN_S
            if (process is None or process.poll() is not None) and late:
                self._started[k] = time.monotonic()
                _let_go(process)
                self.processes[k] = self._start(self._commands[k])

    def close(self) -> None:
        """End all processes. A later batch resumes from the takes' records."""
        for process in self.processes:
            _let_go(process)
        for process in filter(None, self.processes):
            with suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)
            process.kill()
            process.wait()

    def _start(self, command: list[str]) -> subprocess.Popen[bytes]:
        known = os.environ.get("PYTHONPATH", "")
        paths = os.pathsep.join(filter(None, (str(_ROOT), str(backend_folder()), known)))
        environment = {**os.environ, "PYTHONPATH": paths, "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error"}
        with (self._folder / "cluster.log").open("ab") as log:
            piped, words = subprocess.PIPE, [sys.executable, *command]
            return subprocess.Popen(words, env=environment, stdin=piped, stdout=log, stderr=log, start_new_session=True)


def _let_go(process: subprocess.Popen[bytes] | None) -> None:
    if process is not None and process.stdin is not None:
        process.stdin.close()


def _some_port() -> int:
    """Return a port outside the range that systems assign automatically."""
    return 10_000 + secrets.randbelow(20_000)


def machine_memory_mb() -> float | None:
    """Return this machine's memory in megabytes, or None if the system does not report it."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**20
    except (AttributeError, ValueError, OSError):
        return None
