"""Whether the told ellipsoids hold the true joints of synthetic takes as often as they promise."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters import solve
from solver_backend.synthetic.marker_demo import record_markers
from solver_backend.types import Capture
from tests.benchmarks.comparison.judgement import coverage

SEEDS = (21, 22, 23)
BOUNDS_PERCENT = {"held_50": (45, 55), "held_80": (75, 85), "held_95": (92, 98)}


def held() -> dict[str, float]:
    """Return the percentage of true joints inside the 50, 80 and 95 % ellipsoids, the mean over takes."""
    rows = []
    for seed in SEEDS:
        take = record_markers(180, seed=seed)
        motion = solve(Capture("take", markers=take.cloud)).motion
        rows.append(coverage(motion.joints, take.joints, motion.joint_covariance))
    return {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
