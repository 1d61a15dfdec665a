"""How often a frame rate that is stated twice or half as high as it is is noticed by the balance of who moves.

Recorded clips of CMU (walks, dances, exercises, fights), as 12 joints, by ``report.time_plausibility``. Needs the
motions kept beside the repository (or MOCAP_SHARED_DATA).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.io.recognition.balance import body_points
from solver_backend.report.time_plausibility import CHANGE, likely_rate
from solver_backend.types import JointSet
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.foreign_clips import cmu_limbs
from tests.support.recordings import ABSENT, recordings_folder


def run() -> list[Metric]:
    """Look at every clip at its own rate, twice and half of it."""
    clips = sorted((recordings_folder() / "motion_cmu" / "asfamc").glob("*.npz"))
    if not clips:
        raise BenchmarkSkipped(ABSENT)
    found = {factor: np.array([rate_of(clip, factor) for clip in clips]) for factor in (1.0, CHANGE, 1 / CHANGE)}
    return [
        Metric("false_alarms", float((found[1.0] != 1).sum()), "clips", rel_tol=0.0),
        Metric("doubled_noticed", float((found[CHANGE] == 1 / CHANGE).mean()), "of 1", "higher"),
        Metric("halved_noticed", float((found[1 / CHANGE] == CHANGE).mean()), "of 1", "higher"),
    ]


def rate_of(clip: Path, factor: float) -> float:
    """Return the factor on a clip's rate that is found where it is stated so many times as high as it is."""
    points, fps = cmu_limbs(clip)
    return likely_rate(body_points(points, JointSet.COCO_17), factor * fps)
