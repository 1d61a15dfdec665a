"""Recorded marker takes by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.io.markers.read import read_markers
from solver_backend.synthesis.embedded.demo import record_markers
from solver_backend.types import MarkerCloud
from tests.benchmarks.metric import BenchmarkSkipped
from tests.support.recordings import ABSENT, recordings_folder

MARKERS = Path("markers")


def folder() -> Path:
    """Return the folder of the marker recordings.

    Raises:
        BenchmarkSkipped: it is missing.
    """
    path = recordings_folder() / MARKERS
    if not (path / "cmu_pairs").is_dir():
        raise BenchmarkSkipped("The recordings are not here.", hint=ABSENT)
    return path


def cmu(name: str, frames: slice = slice(None)) -> MarkerCloud:
    """Return a CMU take."""
    return part(read_markers(folder() / "cmu_pairs" / f"{name}.c3d").cloud, frames)


def ui_prmd(path: Path) -> MarkerCloud:
    """Return a UI-PRMD take. Missing markers, which the files put at the origin, are NaN."""
    with np.load(path, allow_pickle=False) as data:
        points = 1e-4 * data["positions_01mm"].astype(np.float64)
        labels, fps = tuple(str(label) for label in data["labels"]), float(data["fps"])
    return MarkerCloud(np.where((points == 0).all(-1, keepdims=True), np.nan, points), fps, labels)


def part(cloud: MarkerCloud, frames: slice) -> MarkerCloud:
    """Return some frames of a take."""
    return replace(cloud, positions=cloud.positions[frames], residual=None)


def held_out_takes() -> dict[str, list[MarkerCloud]]:
    """Return takes by layout: CMU's 41, Plug-in Gait's 39, and a layout of about 50 markers."""
    clips = ("m01_s01_e02", "m03_s05_e02", "m06_s04_e05", "m08_s02_e05")
    return {
        "CMU 41": [cmu("02_01"), cmu("135_02", slice(600, 1100))],
        "Plug-in Gait 39": [ui_prmd(folder() / "ui_prmd" / f"{clip}.npz") for clip in clips],
        "running 53": [part(read_markers(folder() / "nimble" / "Sprinter" / "run0350cms.trc").cloud, slice(0, 400))],
        "synthetic 42": [record_markers(240, seed=5).cloud],
    }


def takes_of_other_labs() -> list[MarkerCloud]:
    """Return takes of four laboratories that chose no constant of the filling."""
    nimble, frames = folder() / "nimble", slice(0, 800)
    paths = [nimble / "Subject4" / "MarkerData" / f"{name}.trc" for name in ("squats1", "STS1")]
    paths += [nimble / "c3d" / "squat.c3d", folder() / "opensim" / "walking2.c3d"]
    paths += [
        folder() / "automarkerlabel" / "transfer_learning_data" / f"{n}01.c3d" for n in ("KneeltoProne", "PronetoRun")
    ]
    paths += [folder() / "kineticstoolkit" / "tennis_serve.c3d"]
    return [part(read_markers(path).cloud, frames) for path in paths]
