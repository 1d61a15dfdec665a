"""How often a frame rate that is stated twice or half as high as it is is noticed by how people move.

Recorded people as 12 joints, by ``report.time_plausibility``: clips of CMU on which its limits were chosen (``asfamc``:
walks, runs, dances, exercises, fights), clips of other people (``mb2`` and ``daz``, every second frame), and the slow
exercises of UI-PRMD by their markers. Salsas are apart: CMU recorded them with 60 frames a second, not with 120, so the
rate of these files is twice the true one. Needs the motions kept beside the repository (or MOCAP_SHARED_DATA).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from solver_backend.report.time_plausibility import CHANGE, shown_rate
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.foreign_clips import cmu_limbs, ui_prmd_limbs
from tests.support.recordings import ABSENT, recordings_folder

OTHERS = ("06", "07", "08", "10", "12", "13", "26", "27", "32", "35", "HappyStartWalk", "AngryTalk", "Run", "martial")
"""Beginnings of the clips of people and takes that no limit was chosen on; 35_01 is in ``asfamc``."""


def run() -> list[Metric]:
    """Look at every clip at its own rate, twice and half of it."""
    folder = recordings_folder()
    chosen = sorted((folder / "motion_cmu" / "asfamc").glob("*.npz"))
    if not chosen:
        raise BenchmarkSkipped(ABSENT)
    found = [path for name in ("mb2", "daz") for path in sorted((folder / "motion_cmu" / name).glob("*.npz"))]
    others = [path for path in found if path.stem.split("_")[0] in OTHERS and path.stem != "35_01"]
    salsas = [path for path in found if path.stem.startswith("salsa")]
    slow = sorted((folder / "markers" / "ui_prmd").glob("*.npz"))
    return [
        *_metrics("", rates_of(chosen, cmu_limbs)),
        *_metrics("others_", rates_of(others, _thinned)),
        *_metrics("slow_", rates_of(slow, ui_prmd_limbs)),
        Metric("salsas_noticed", float((rates_of(salsas, _thinned)[0] == 1 / CHANGE).mean()), "of 1", "higher"),
    ]


def _metrics(kind: str, found: np.ndarray) -> list[Metric]:
    return [
        Metric(f"{kind}false_alarms", float((found[0] != 1).sum()), f"of {found.shape[1]} clips", rel_tol=0.0),
        Metric(f"{kind}doubled_noticed", float((found[1] == 1 / CHANGE).mean()), "of 1", "higher"),
        Metric(f"{kind}halved_noticed", float((found[2] == CHANGE).mean()), "of 1", "higher"),
    ]


def rates_of(clips: Iterable[Path], read: Callable[[Path], tuple[np.ndarray, float]]) -> np.ndarray:
    """Return (3, N) the factors that are found for clips as they are, and stated twice and half as high."""
    takes = (read(clip) for clip in clips)
    rows = [[shown_rate(points, fps * factor)[0] for factor in (1.0, CHANGE, 1 / CHANGE)] for points, fps in takes]
    return np.array(rows).T


def _thinned(path: Path) -> tuple[np.ndarray, float]:
    points, fps = cmu_limbs(path)
    return points[::2], fps / 2
