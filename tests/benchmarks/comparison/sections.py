"""Tables of the comparison: the runs that each needs, and its columns (analogues of thesis 6.1-6.9)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from research.simulation.benchmark import BenchmarkSettings
from tests.benchmarks.comparison.captures import BAD, LONG_TAKE, TAKES
from tests.benchmarks.comparison.judgement import COLUMNS, Row
from tests.benchmarks.comparison.methods import OURS, PUBLISHED, Method, ablations, compared, curves
from tests.benchmarks.comparison.runs import Outcome, Run

TIMES = ("seconds", "cpu_s", "peak_mb")
ACCURACY = ("mpjpe_mm", "rmse_mm", "mae_deg", "pck3", "pck7", "accel_m_s2")
VIEWS, LENGTHS, WINDOWS = (2, 3, 4, 8), (500, 1000, 2000), (10, 20, 30, 40)
Found = dict[Run, Outcome]


@dataclass(frozen=True)
class Scope:
    """Takes and settings on which the tables are measured."""

    takes: tuple[str, ...] = TAKES[:3]  # As in ``captures.TAKES``. The seed of a take is its number.
    frames: int | None = None  # Number of frames of every take, None for all.

    def runs(
        self, methods: list[Method], num_views: int = 4, takes: int | None = None, bad: str | None = None
    ) -> list[Run]:
        """Return a run of every method on every take, or on the first ``takes``."""
        return [
            Run(method, self.cut(take), BenchmarkSettings(num_views=num_views, seed=number), bad)
            for number, take in enumerate(self.takes[:takes])
            for method in methods
        ]

    def cut(self, take: str) -> str:
        """Return the take's name with the frames it is cut to."""
        return take if self.frames is None else f"{take.partition('+')[0]}+{self.frames}"


@dataclass(frozen=True)
class Section:
    """One table."""

    title: str
    rows: dict[str, list[Run]]
    """Runs of each row, which shows their medians."""
    columns: tuple[str, ...]

    @property
    def runs(self) -> list[Run]:
        """Return all runs."""
        return [run for runs in self.rows.values() for run in runs]

    def only(self, *labels: str) -> Section:
        """Return the table with only these rows."""
        return replace(self, rows={label: self.rows[label] for label in labels})

    def medians(self, found: Found) -> dict[str, Row]:
        """Return the figures of every row."""
        return {label: medians([found[run].row for run in runs]) for label, runs in self.rows.items()}


def medians(rows: list[Row]) -> Row:
    """Return the median of every figure over rows, NaN if no row has it."""
    names = dict.fromkeys(name for row in rows for name in row)
    values = {name: [row[name] for row in rows if np.isfinite(row.get(name, np.nan))] for name in names}
    return {name: float(np.median(found)) if found else float("nan") for name, found in values.items()}


def _by_method(runs: list[Run]) -> dict[str, list[Run]]:
    rows: dict[str, list[Run]] = {}
    for run in runs:
        rows.setdefault(run.method.name, []).append(run)
    return rows


def methods(scope: Scope) -> Section:
    """Tables 6.1, 6.2 and 6.4: all methods."""
    return Section(
        "All methods, 4 views (thesis tables 6.1, 6.2, 6.4)", _by_method(scope.runs(compared())), COLUMNS + TIMES
    )


def views(scope: Scope) -> Section:
    """Number of cameras."""
    chosen = [Method("MuVS"), Method(PUBLISHED), Method.of(OURS, "ours, global")]
    rows = {
        f"{method.name}, {count} views": scope.runs([method], count, takes=2) for method in chosen for count in VIEWS
    }
    return Section("Number of views", rows, (*ACCURACY, "kp_mpjpe_mm", "skating_cm_f", *TIMES))


def windows(scope: Scope) -> Section:
    """Table 6.8: length of a window."""
    chosen = [Method.of("BundleMoCap", f"SLERP, {n} frames", window=n) for n in WINDOWS[:2]]
    chosen += [Method.of(PUBLISHED, f"SIDER-2, {n} frames", window=n) for n in WINDOWS]
    chosen += [Method.of(OURS, f"ours, {n} frames", refine_window=n, window=max(n, 20)) for n in (5, *WINDOWS)]
    runs = scope.runs([method for method in chosen if method.known], takes=1)
    return Section("Length of a window (thesis table 6.8)", _by_method(runs), (*ACCURACY, *TIMES))


def root(scope: Scope) -> Section:
    """Table 6.9: rotation of the root between keys."""
    chosen = [Method.of(PUBLISHED, f"root by {kind}", root=kind) for kind in ("slerp", "sider")]
    return Section(
        "SLERP or SIDER-2 for the root (thesis table 6.9)", _by_method(scope.runs(chosen, takes=2)), ACCURACY
    )


def interpolation(scope: Scope) -> Section:
    """SIDER-n with a key every ten frames, and curves of the root, by L-BFGS (thesis 6.4's outlook)."""
    title = "SIDER-n and SE(3) between keys (thesis tables 6.8, 6.9 and 6.4)"
    return Section(title, _by_method(scope.runs(curves(), takes=2)), (*ACCURACY, *TIMES))


def optimiser(scope: Scope) -> Section:
    """Variants of the published method that favour it."""
    chosen = [
        Method(PUBLISHED), Method.of(PUBLISHED, "keys start at the key before", start="previous"),
        Method.of(PUBLISHED, "L-BFGS", optimiser="lbfgs"),
        Method.of(PUBLISHED, "L-BFGS from the key before", optimiser="lbfgs", start="previous"),
    ]  # fmt: skip
    title = "BundleMoCap++ with another optimiser and start"
    return Section(title, _by_method(scope.runs(chosen, takes=2)), (*ACCURACY, *TIMES))


def ablation(scope: Scope) -> Section:
    """Effect of each part of our method."""
    return Section("Parts of ours", _by_method(scope.runs(ablations(), takes=2)), (*ACCURACY, "skating_cm_f", *TIMES))


def bad(scope: Scope) -> Section:
    """Faults during a recording."""
    ours = Method.of(OURS, "ours, global")
    rows = {"as it should be": scope.runs([ours], takes=1)}
    rows |= {name.replace("_", " "): scope.runs([ours], takes=1, bad=name) for name in BAD}
    return Section("Bad input, ours", rows, ("seen_mm", "unseen_mm", *ACCURACY, "reproj_px", "seconds"))


def noise(scope: Scope) -> Section:
    """Remaining error without each part of the noise."""
    detector = BenchmarkSettings().detector
    steady = replace(detector, drift_mm=0.0)
    exact = {"anatomy_mm": 0.0, "calibration_mm": 0.0, "detector": replace(detector, view_bias_mm=0.0)}
    fewer: dict[str, dict[str, Any]] = {
        "as it is": {},
        "true cameras": {"calibration_mm": 0.0},
        "joints as the body means them": {"anatomy_mm": 0.0},
        "no bias by direction": {"detector": exact["detector"]},
        "no drift": {"detector": steady},
        "nothing constant": exact,
        "nothing constant, no drift": exact | {"detector": replace(exact["detector"], drift_mm=0.0)},
    }
    rows = {}
    for method in (Method("MuVS"), Method.of(OURS, "ours, global")):
        for label, changes in fewer.items():
            runs = scope.runs([method], takes=2)
            rows[f"{method.name}, {label}"] = [replace(run, settings=replace(run.settings, **changes)) for run in runs]
    return Section("Parts of the noise", rows, ("mpjpe_mm", "accel_m_s2", "kp_mpjpe_mm", "held50", "held95"))


def length(scope: Scope) -> Section:
    """Time and memory by length and arithmetic."""
    rows, ours = {}, Method.of(OURS, "ours, global")
    lengths = LENGTHS if scope.frames is None else tuple(n for n in LENGTHS if n <= scope.frames)
    for frames in lengths:
        take = f"{LONG_TAKE.partition('+')[0]}+{frames}"
        rows[f"ours, {frames} frames"] = [Run(ours, take)]
    if lengths:
        take = f"{LONG_TAKE.partition('+')[0]}+{lengths[-1]}"
        torch = Method.of(OURS, "ours, torch", backend="torch")
        rows[f"ours, torch, {lengths[-1]} frames"] = [Run(torch, take)]
        rows[f"{PUBLISHED}, {lengths[-1]} frames"] = [Run(Method(PUBLISHED), take)]
    if scope.frames is None:
        rows["ours, 20000 frames"] = [Run(ours, f"{LONG_TAKE}*10")]
    return Section("Time and memory by length", rows, (*TIMES, "mpjpe_mm"))


SECTIONS: dict[str, Callable[[Scope], Section]] = {
    "methods": methods, "views": views, "windows": windows, "root": root, "interpolation": interpolation,
    "optimiser": optimiser, "ablation": ablation, "bad": bad, "noise": noise, "length": length,
}  # fmt: skip
"""Tables by name, in the order they are made."""


def quick(scope: Scope) -> Scope:
    """Return the scope of a quick run: one take of 200 frames."""
    return replace(scope, takes=scope.takes[:1], frames=200)
