"""A cluster on the loopback address for batches that do not know how it came about."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

from blender_addon.headless.batch.engines.local_cluster import LocalCluster


class Tended(LocalCluster):
    """A cluster that somebody else's batch uses, started again by a thread of its own."""

    def __init__(self, workers: int, folder: Path) -> None:
        super().__init__(workers, 2000, folder)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._go_on, daemon=True)
        self._thread.start()

    def _go_on(self) -> None:
        while not self._over.wait(0.3):
            self.tend()

    def kill(self, number: int) -> None:
        """Kill the scheduler, 0, or a worker; it is started again."""
        process = self.processes[number]
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGKILL)

    def wait_for_workers(self, count: int, timeout_s: float = 60.0) -> None:
        """Wait until so many are there."""
        from distributed import Client

        with Client(self.address, set_as_default=False, timeout=timeout_s) as client:
            client.wait_for_workers(count, timeout=timeout_s)

    def close(self) -> None:
        """End all of it."""
        self._over.set()
        self._thread.join()
        super().close()
