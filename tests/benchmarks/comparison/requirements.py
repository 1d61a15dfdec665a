"""Requirements for our method relative to the baselines, and the measured values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.comparison.judgement import Row
from tests.benchmarks.comparison.methods import BASELINES, EXACT_PRIOR, FILTER, PUBLISHED

OURS = "ours, global"
Tables = dict[str, dict[str, Row]]


@dataclass(frozen=True)
class Requirement:
    """Bounds for a figure."""

    text: str
    value: float
    low: float
    high: float

    @property
    def met(self) -> bool:
        """True if the figure is within the bounds."""
        return self.low <= self.value <= self.high

    def line(self) -> str:
        """Return the requirement as a row of text."""
        bound = f"≤ {self.high:g}" if self.low == -np.inf else f"≥ {self.low:g}"
        bound = bound if np.inf in (-self.low, self.high) else f"{self.low:g}..{self.high:g}"
        return f"  {'✓' if self.met else '✗'} {self.text:<66} {self.value:10.3g}   {bound}"


def requirements(tables: Tables) -> list[Requirement]:
    """Return all requirements that the measured tables cover."""
    return [*_accuracy(tables.get("methods", {})), *_views(tables.get("views", {})), *_length(tables.get("length", {}))]


def _at_most(text: str, value: float, bound: float) -> Requirement:
    return Requirement(text, value, -np.inf, bound)


def _accuracy(rows: dict[str, Row]) -> Iterator[Requirement]:
    if OURS not in rows:
        return
    ours = rows[OURS]
    if FILTER in rows:
        ratio = ours["kp_mpjpe_mm"] / rows[FILTER]["kp_mpjpe_mm"]
        yield _at_most("keypoint error against triangulation + Butterworth", ratio, 0.45)
    if "MuVS" in rows:
        yield _at_most("MPJPE against MuVS", ours["mpjpe_mm"] / rows["MuVS"]["mpjpe_mm"], 0.5)
        yield _at_most("acceleration error against MuVS", ours["accel_m_s2"] / rows["MuVS"]["accel_m_s2"], 0.3)
    if PUBLISHED in rows:
        paper = rows[PUBLISHED]
        yield _at_most("MPJPE against BundleMoCap++ as published", ours["mpjpe_mm"] / paper["mpjpe_mm"], 0.75)
        yield _at_most("acceleration error against BundleMoCap++", ours["accel_m_s2"] / paper["accel_m_s2"], 1.0)
    if EXACT_PRIOR in rows:
        ratio = ours["mpjpe_mm"] / rows[EXACT_PRIOR]["mpjpe_mm"]
        yield _at_most("MPJPE against the same with a prior without error", ratio, 1.5)
    best = {c: _best(rows, c) for c in ("mpjpe_mm", "pa_mpjpe_mm", "rmse_mm", "mae_deg", "accel_m_s2", "skating_cm_f")}
    yield _at_most("foot skating against the best baseline", ours["skating_cm_f"] / best.pop("skating_cm_f"), 0.5)
    for column, value in best.items():
        yield _at_most(f"{column} against the best baseline", ours[column] / value, 1.0)
    for column in ("pck3", "pck7"):
        most = max(row[column] for name, row in rows.items() if name in BASELINES and np.isfinite(row[column]))
        yield Requirement(f"{column} less the best baseline's", ours[column] - most, 0.0, np.inf)
    yield Requirement("exchanges of 3 frames or more without a trace, %", ours["undone"], 95.0, np.inf)
    for column, (low, high) in {"held50": (45, 55), "held80": (75, 85), "held95": (92, 98)}.items():
        yield Requirement(f"true joints inside the {column[4:]} % ball, %", ours[column], low, high)


def _best(rows: dict[str, Row], column: str) -> float:
    return min(row[column] for name, row in rows.items() if name in BASELINES and np.isfinite(row[column]))


def _views(rows: dict[str, Row]) -> Iterator[Requirement]:
    by_count = {n: rows[f"{OURS}, {n} views"] for n in (2, 4, 8) if f"{OURS}, {n} views" in rows}
    if {2, 4} <= set(by_count):
        yield _at_most("MPJPE of 2 views against 4", by_count[2]["mpjpe_mm"] / by_count[4]["mpjpe_mm"], 1.5)
    if {4, 8} <= set(by_count):
        yield _at_most("time of 8 views against 4", by_count[8]["cpu_s"] / by_count[4]["cpu_s"], 1.2)


def _length(rows: dict[str, Row]) -> Iterator[Requirement]:
    sized = {
        int(name.split()[1]): row for name, row in rows.items() if name.startswith("ours, ") and "torch" not in name
    }
    if len(sized) > 1:
        frames, seconds = np.log(list(sized)), np.log([row["cpu_s"] for row in sized.values()])
        yield _at_most("exponent of time by length", float(np.polyfit(frames, seconds, 1)[0]), 1.1)
    if 2000 in sized:
        yield _at_most("2,000 frames of 4 views, NumPy, seconds", sized[2000]["seconds"], 16.0)
    if 20000 in sized:
        yield _at_most("memory for 20,000 frames of 4 views, MB", sized[20000]["peak_mb"], 1500.0)
    if "ours, torch, 2000 frames" in rows:
        yield _at_most("2,000 frames of 4 views, torch, seconds", rows["ours, torch, 2000 frames"]["seconds"], 8.0)
    published = rows.get(f"{PUBLISHED}, 2000 frames")
    if published is not None and 2000 in sized:
        fastest = min(row["cpu_s"] for name, row in rows.items() if name.startswith("ours") and "2000" in name)
        yield Requirement("times faster than BundleMoCap++", published["cpu_s"] / fastest, 100.0, np.inf)
