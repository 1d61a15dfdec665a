"""Speed and memory of the studio: four cameras of 640 x 480 around a person who repeats the choreography.

Speed is per second of processor time: truth with sight lines and faults in every frame, infrared with depth and masks
written by a process of ``manifold dataset make``, and Workbench's colour if Blender's module exists. Memory is the
resident memory of such a process (VmRSS, sampled continuously) for STUDIO_FRAMES frames (2000, 10000) with pictures of
160 x 120, which separates picture size and take length. Memory needs Linux.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.synthesis.embedded.demo import author_motion
from solver_backend.synthesis.studio.perturb import clean_capture, perturbed_capture
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import list_shots, set_up
from solver_backend.synthesis.studio.truth import find_truth, true_motion
from tests.benchmarks.metric import BenchmarkSkipped, Metric

FPS, ONCE = 30.0, 180
_LOOK_S = 0.1
_VIEWS, _SIZE, _SMALL = 4, (640, 480), (160, 120)
_FILMED, _TOLD, _COLOURED = 60, 1000, 4
"""Frames filmed for the speed, frames with computed truth, and rendered frames."""


def run() -> list[Metric]:
    """Measure speed, then memory."""
    if not Path("/proc/self/status").exists():
        raise BenchmarkSkipped("memory is read from /proc, which this system has not")
    lengths = [int(text) for text in os.environ.get("STUDIO_FRAMES", "2000,10000").split(",")]
    with TemporaryDirectory() as name:
        folder = Path(name)
        there_and_back(folder / "long.npz", max(*lengths, _TOLD))
        metrics = [
            Metric("truth_frames_per_cpu_s", _truth(folder), "frames/s", "higher", rel_tol=0.2),
            Metric("sensor_views_per_cpu_s", _sensors(folder), "views/s", "higher", rel_tol=0.2),
        ]
        if find_spec("bpy") is not None:
            metrics.append(Metric("colour_views_per_cpu_s", _colour(folder), "views/s", "higher", rel_tol=0.2))
        for frames in lengths:
            held = filmed(folder, described(frames, _SMALL, ["infrared", "depth", "masks"]), f"memory_{frames}")
            sys.stdout.write(f"  {frames:,} frames: {held.said()}\n")
            sys.stdout.flush()
            metrics.append(Metric(f"peak_mb_of_{frames}_frames", held.peak_mb, "MB", rel_tol=0.15))
    return metrics


def there_and_back(path: Path, frames: int) -> Path:
    """Write the choreography, repeated forwards and backwards, as an AMASS file of ``frames`` frames."""
    motion = author_motion(load_body(), np.zeros(10), ONCE, FPS)
    at = np.abs((np.arange(frames) + ONCE - 1) % (2 * ONCE - 2) - (ONCE - 1))
    poses = np.zeros((frames, 156))
    poses[:, :3], poses[:, 3:66] = motion.global_orient[at], motion.body_pose[at].reshape(frames, 63)
    np.savez(
        path, poses=poses, trans=motion.transl[at], betas=np.zeros(16), gender="neutral", mocap_framerate=FPS
    )  # fmt: skip
    return path


def described(frames: int, size: tuple[int, int], film: list[str], **more: Any) -> dict[str, Any]:
    """Return a description of one shot."""
    array = {"layout": "ring", "count": _VIEWS, "size": list(size), "distortion": [-0.09, 0.06, 0.0005, -0.0004, 0.0]}
    return {
        "motions": ["long.npz"], "frames": frames, "fps": FPS, "camera_arrays": [array], "film": film,
        "perturb": "detector",
        **more,
    }  # fmt: skip


@dataclass(frozen=True)
class Held:
    """Memory and time of a process."""

    peak_mb: float  # Maximum memory.
    early_mb: float  # Maximum memory in the first third of its time.
    late_mb: float  # Maximum memory in the last third of its time.
    cpu_s: float

    def said(self) -> str:
        """Return the values in words."""
        return (
            f"{self.peak_mb:,.0f} MB at most, {self.early_mb:,.0f} in the first third, {self.late_mb:,.0f} in the "
            f"last; {self.cpu_s:,.0f} s of processor time"
        )


def filmed(folder: Path, description: dict[str, Any], name: str) -> Held:
    """Film a description in a separate process and return its memory and time."""
    spec = folder / f"{name}.json"
    spec.write_text(json.dumps(description), encoding="utf-8")
    command = [sys.executable, "-m", "solver_backend", "dataset make", str(spec), "--out", str(folder / name)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    held, cpu_s = [], 0.0
    while process.poll() is None:
        try:
            found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text(encoding="ascii"))
            stat = Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
            cpu_s = (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK")
        except OSError:
            break
        held.append(int(found[1]) / 1024 if found else 0.0)
        time.sleep(_LOOK_S)
    if process.wait():
        raise RuntimeError(f"the studio ended with {process.returncode}")
    third = max(1, len(held) // 3)
    return Held(max(held), max(held[:third]), max(held[-third:]), cpu_s)


def _truth(folder: Path) -> float:
    """Return frames per second of processor time for truth and perturbed captures together."""
    spec = spec_of(described(_TOLD, _SIZE, []), folder)
    stage = set_up(spec, list_shots(spec)[0])
    find_truth(stage, spec.fps)  # occlusion tables are computed once per body
    with _stopped() as clock:
        truth = find_truth(stage, spec.fps)
        clean = clean_capture(spec, stage, truth, true_motion(stage.person, stage.joints, truth.contacts, spec.fps))
        perturbed_capture(spec, stage, truth, clean)
    return _TOLD / clock[0]


def _sensors(folder: Path) -> float:
    """Return views per second of processor time, from two runs of different length, without start-up time."""
    film = ["infrared", "depth", "masks"]
    short, long = (filmed(folder, described(frames, _SIZE, film), f"film_{frames}").cpu_s for frames in (1, _FILMED))
    return (_FILMED - 1) * _VIEWS / (long - short)


def _colour(folder: Path) -> float:
    """Return views per second of processor time of Blender's Workbench."""
    from blender_addon.studio.colour_film import film_in_colour

    filmed(folder, described(_COLOURED, _SIZE, ["rgb"], looks=["everyday"]), "colour")
    shot = next(path for path in (folder / "colour" / "shots").iterdir() if not path.name.startswith("."))
    with _stopped() as clock:
        count = film_in_colour(shot)
    return count / clock[0]


@contextmanager
def _stopped() -> Iterator[list[float]]:
    """Yield a list that receives the processor seconds of a block, of all threads."""
    seconds, start = [np.nan], time.process_time()
    yield seconds
    seconds[0] = time.process_time() - start
