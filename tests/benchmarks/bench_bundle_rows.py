"""Thesis tables 6.1, 6.2, 6.4, 6.8 and 6.9 in short: every method on two takes of 81 frames, four views.

What `bench bundle` measures at length, kept row by row: methods, BundleMoCap++ with keys copied from the one before (as
Algorithm 1 reads) beside the kinder start, SIDER-n with a key every ten frames, and the root by SLERP, SIDER-2 and on a
screw of SE(3). Medians over the takes, each with a seed of its own. Needs the validation motions (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import numpy as np

from tests.benchmarks.bench_bundle import measured
from tests.benchmarks.comparison.captures import TAKES
from tests.benchmarks.comparison.sections import Scope
from tests.benchmarks.metric import Metric, key_of

SCOPE = Scope(TAKES[:2], frames=81)
TABLES = ("methods", "interpolation")
KEPT = {"mpjpe_mm": "mm", "accel_m_s2": "m/s²", "mae_deg": "°", "pck3": "%", "skating_cm_f": "cm/frame"}


def run() -> list[Metric]:
    """Measure the rows."""
    sections, found = measured(list(TABLES), SCOPE)
    return [
        Metric(f"{key_of(label)}_{column}", row[column], unit, "higher" if column == "pck3" else "lower", rel_tol=0.1)
        for name in TABLES
        for label, row in sections[name].medians(found).items()
        for column, unit in KEPT.items()
        if np.isfinite(row.get(column, np.nan))
    ]
