"""Dozens or thousands of takes of 100 frames in one process, with one and two Dask workers, and with restarts.

In the restart part, one of two workers is killed every 20 s and the scheduler is restarted once. Another part measures
a scheduler's memory with keyed takes. SCALE_TAKES (8), SCALE_FRAMES (100) and SCALE_SIMULATED (2000) set the numbers.
SCALE_ROUNDS (1) is the number of alternating rate measurements, with medians of their ratios. SCALE_PARTS
(rates,fire,memory) selects parts, and the others count as missing. Rates are between the ends of the first and the last
take, so that the start of a cluster, which takes seconds per batch, is excluded. "more than once" counts takes with a
step that was recorded as done twice.
"""

from __future__ import annotations

import itertools
import os
import shutil
import sys
import threading
import time
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from blender_addon.headless.batch.record import read_record
from blender_addon.headless.batch.request import BatchRequest, Spread
from blender_addon.headless.batch.run_batch import run_batch
from blender_addon.headless.batch.takes import Takes
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.short_solves import cut

KILL_S = 20.0
STEPS = 5


def run() -> list[Metric]:
    """Solve the takes four times, and fill a scheduler."""
    if find_spec("distributed") is None:
        raise BenchmarkSkipped("Dask is not installed")
    takes, frames, simulated = (
        int(os.environ.get(f"SCALE_{name}", default))
        for name, default in (("TAKES", 8), ("FRAMES", 100), ("SIMULATED", 2000))
    )
    parts, rounds = os.environ.get("SCALE_PARTS", "rates,fire,memory").split(","), os.environ.get("SCALE_ROUNDS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with TemporaryDirectory() as name:
        folder = Path(name)
        captures = _captures(folder / "captures", takes, frames) if {"rates", "fire"} & {*parts} else folder
        found = _rates(captures, folder, int(rounds)) if "rates" in parts else []
        found += _fire(captures, folder, takes) if "fire" in parts else []
        found += _memory(simulated, folder) if "memory" in parts else []
    return found


def _rates(captures: Path, folder: Path, rounds: int) -> list[Metric]:
    """Measure plain, one worker and two in turns."""
    found = []
    for number in range(rounds):
        ways = {"plain": Spread(), "one": Spread(workers=1), "two": Spread(workers=2)}
        found.append([_rate(captures, folder / f"{name}{number}", spread) for name, spread in ways.items()])
    plain, one, two = np.array(found).T
    return [
        Metric("plain_takes_a_minute", float(np.median(plain)), "", direction="higher", rel_tol=0.6),
        Metric("overhead_percent", float(np.median(100 * (plain / one - 1))), "%", rel_tol=1.0, abs_tol=10.0),
        Metric("two_workers_against_one", float(np.median(two / one)), "", direction="higher", rel_tol=0.4),
    ]


def _fire(captures: Path, folder: Path, takes: int) -> list[Metric]:
    done, twice, kills = _under_fire(captures, folder / "fire", folder)
    return [
        Metric("kills", kills, "", rel_tol=100.0, abs_tol=100.0),
        Metric("not_done_under_fire", takes - done, "", rel_tol=0.0, abs_tol=0.0),
        Metric("more_than_once_under_fire", twice, "", rel_tol=0.0, abs_tol=0.0),
    ]


def _memory(simulated: int, folder: Path) -> list[Metric]:
    per_thousand, bend = _scheduler_memory(simulated, folder)
    return [
        Metric("scheduler_mb_a_thousand_takes", per_thousand, "MB", rel_tol=0.5, abs_tol=2.0),
        Metric("scheduler_bend", bend, "", rel_tol=0.5, abs_tol=0.5),
    ]


def _captures(folder: Path, takes: int, frames: int) -> Path:
    folder.mkdir()
    first = folder / "take0000.npz"
    write_capture(first, cut(demo_capture(frames), 0, frames))
    for number in range(1, takes):
        shutil.copyfile(first, folder / f"take{number:04}.npz")
    return folder


def _rate(captures: Path, out: Path, spread: Spread) -> float:
    """Return takes per minute between the ends of the first and the last take."""
    ends: list[tuple[float, int]] = []

    def told(stage: str, done: int, total: int) -> None:
        if stage == "takes" and done and (not ends or ends[-1][1] != done):
            ends.append((time.monotonic(), done))

    result = run_batch(BatchRequest(captures, out), told, spread)
    wrong = [take["take"] for take in result["takes"] if take["status"] != "done"]
    if wrong:
        raise RuntimeError(f"{len(wrong)} takes are not done:\n{result['table']}")
    (first_s, first), (last_s, last) = ends[0], ends[-1]
    return 60 * (last - first) / (last_s - first_s)


def _under_fire(captures: Path, out: Path, folder: Path) -> tuple[int, int, int]:
    """Return the numbers of finished takes, of takes done more than once, and of kills."""
    from tests.support.tended_cluster import Tended

    (folder / "dask").mkdir()
    cluster, over, kills = Tended(2, folder / "dask"), threading.Event(), []

    def fire() -> None:
        while not over.wait(KILL_S):
            kills.append(0 if len(kills) == 2 else 1 + len(kills) % 2)
            cluster.kill(kills[-1])

    firing = threading.Thread(target=fire)
    firing.start()
    try:
        result = run_batch(BatchRequest(captures, out), _ignored, Spread(cluster.address, patience_s=120))
    finally:
        over.set()
        firing.join()
        cluster.close()
    records = [read_record(out / take["take"]) or {} for take in result["takes"]]
    ends = [sum(attempt["how"] == "done" for attempt in record.get("attempts", ())) for record in records]
    return sum(record.get("status") == "done" for record in records), sum(end > 1 for end in ends), len(kills)


def _ignored(stage: str, done: int, total: int) -> None:
    pass


def _simulated(given: dict[str, Any], step: str, before: object) -> dict[str, Any]:
    """Simulate a step with the same amounts of input and output."""
    return {"worker": "", "record": {"take": given["capture"], "status": "done", "outputs": [given["capture"]] * 4}}


def _scheduler_memory(takes: int, folder: Path) -> tuple[float, float]:
    """Return MB per thousand one-step takes submitted at once, and the ratio of the last to the first growth."""
    from distributed import Client

    from tests.support.tended_cluster import Tended

    (folder / "memory").mkdir()
    cluster, given = Tended(1, folder / "memory"), Takes(BatchRequest(Path("captures"), Path("out")), {}).plain()
    try:
        cluster.wait_for_workers(1)
        with Client(cluster.address, set_as_default=False) as client:
            futures: list[Any] = []
            used = [_resident_mb(cluster)]
            for part in range(STEPS):
                for number in range(part * takes // STEPS, (part + 1) * takes // STEPS):
                    about = {"work": given, "capture": f"/shared/captures/take{number:06}.npz"}
                    key = f"solve-{number:064x}"
                    futures.append(client.submit(_simulated, about, "solve", None, key=key, pure=False))
                client.gather(futures[-(takes // STEPS) :])
                used.append(_resident_mb(cluster))
                sys.stdout.write(f"  {len(futures):,} keyed takes: the scheduler has {used[-1]:.0f} MB\n")
                sys.stdout.flush()
    finally:
        cluster.close()
    growth = [late - early for early, late in itertools.pairwise(used[1:])]
    return 1000 * sum(growth) / (takes * (STEPS - 1) / STEPS), growth[-1] / max(growth[0], 0.1)


def _resident_mb(cluster: Any) -> float:
    pages = Path(f"/proc/{cluster.processes[0].pid}/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 2**20
