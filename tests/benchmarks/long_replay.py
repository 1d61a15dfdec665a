"""Replay sensors continuously at maximum speed, and print the resident memory of every process over time.

``python -m tests.benchmarks.long_replay FOLDER --frames 216000`` (one hour at 60 frames per second) runs acquisition,
fusion, tracks and the live fit of ``sensors live --poses`` on a recording that repeats. ``sensors copy`` makes one from
a studio's shot, with its frames then in the page cache. The result is the memory growth from the first tenth, in the
course of which caches fill, to the last. This runs only on Linux, because memory is read from /proc.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.live.frames import PointFrame
from solver_backend.live.session import LiveSession, LiveStatistics, person_fit
from solver_backend.sensors.chain import LiveMoment, MarkerChain, SensorTask
from solver_backend.sensors.devices.recorded import open_folder

TOLD = 60  # Total number of printed lines.


def main() -> int:
    """Replay, and print the memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=216_000)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end after so many, whatever is done")
    args = parser.parse_args()
    folder = open_folder(args.folder)
    tasks = [SensorTask(replace(device, repeat=True), folder.cameras, live=False) for device in folder.devices]
    network, fit = person_fit(None)
    session = LiveSession(network, fit, unit="m", up_axis="z")
    seen: list[tuple[int, list[float]]] = []
    begin, poses, statistics = time.perf_counter(), 0, LiveStatistics()
    with MarkerChain(tasks, folder.fps) as chain:
        for number, frame in enumerate(_frames(chain)):
            for line in session.run([frame]):
                statistics.add(line)
                poses += "pose" in line
            over = time.perf_counter() - begin > args.seconds or number + 1 >= args.frames
            if number % max(args.frames // TOLD, 1) == 0 or over:
                seen.append((number + 1, _resident_mb()))
                said = "  ".join(f"{mb:6.1f}" for mb in seen[-1][1])
                sys.stdout.write(f"{number + 1:7d} frames  {time.perf_counter() - begin:7.1f} s  MB: {said}\n")
                sys.stdout.flush()
            if over:
                break
    frames, table = np.array([n for n, _ in seen]), np.array([mb for _, mb in seen])
    early, late = (table[part].max(0) for part in (frames <= 0.1 * frames[-1], frames > 0.9 * frames[-1]))
    growth = "  ".join(f"{mb:+.1f}" for mb in late - early)
    sys.stdout.write(f"{frames[-1]} frames, {poses} poses; from the first tenth to the last MB: {growth}\n")
    return 0


def _frames(chain: MarkerChain) -> Iterator[PointFrame]:
    for moment in chain.moments():
        if isinstance(moment, LiveMoment):
            tracked = moment.tracked
            yield PointFrame(tracked.time, tracked.points[tracked.score > 0], moment.arrived)
        elif moment.kind != "sensor_silent":
            sys.stdout.write(f"  {moment.message}\n")


def _resident_mb() -> list[float]:
    """Return the resident memory of this process and of its sensors' processes in MB."""
    pids = [os.getpid(), *sorted(p.pid for p in multiprocessing.active_children() if p.pid is not None)]
    page = os.sysconf("SC_PAGE_SIZE")
    return [int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * page / 1e6 for pid in pids]


if __name__ == "__main__":
    raise SystemExit(main())
