"""Solve every take of UI-PRMD (eight people, ten movements, Plug-in Gait 39) without manual help.

Each person is calibrated once, from a few takes. Then the bundle solves every take. The table has residuals by person,
failed takes, frames to review, and diagnostics. Needs the recordings (MOCAP_SHARED_DATA). Solved takes are kept, and
MOCAP_UI_PRMD_TAKES=N only solves the first N takes of each person.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import read_diagnostics
from solver_backend.exchange.errors import MocapError
from solver_backend.fitters import solve
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.types import FLAG_UNSURE, Capture, MarkerSubject
from tests.benchmarks.kept_parts import kept
from tests.benchmarks.marker_takes.takes import folder, ui_prmd
from tests.benchmarks.metric import Metric

CALIBRATED_FROM = 6  # Number of a person's takes for calibration, from different movements.
STEP_MM = 0.01  # Resolution of stored residuals, as in the table.
_Row = dict[str, Any]  # Stored figures of a take, see ``_solved``.


def run() -> list[Metric]:
    """Solve every take and print the table."""
    people: dict[str, list[Path]] = {}
    for path in sorted((folder() / "ui_prmd").glob("m*_s*_e*.npz")):
        people.setdefault(path.stem.split("_")[1], []).append(path)
    most = int(os.environ.get("MOCAP_UI_PRMD_TAKES", "0")) or None
    sys.stdout.write(
        f"  {'person':<8}{'takes':>6}{'failed':>8}{'median mm':>11}{'95 % mm':>9}{'unsure %':>10}  found\n"
    )
    rows: list[_Row] = []
    for person, paths in people.items():
        record = cache(partial(_person, paths))
        own = [_kept_row(path, record) for path in paths[:most]]
        _print_row(person, own)
        rows += own
    histogram = _histogram(rows)
    return [
        Metric("failed_takes", float(sum(row["failed"] for row in rows)), ""),
        Metric("takes", float(len(rows)), "", "higher"),
        Metric("residual_median_mm", _quantile(histogram, 0.5), "mm"),
        Metric("residual_p95_mm", _quantile(histogram, 0.95), "mm"),
    ]


def _kept_row(path: Path, person: Callable[[], MarkerSubject]) -> _Row:
    return kept("tests.benchmarks.bench_markers_ui_prmd", path.stem, lambda: _solved(path, person()), quiet=True)


def _print_row(person: str, rows: list[_Row]) -> None:
    histogram, good = _histogram(rows), [row for row in rows if not row["failed"]]
    kinds = sum((Counter(row["found"]) for row in good), Counter[str]())
    found = ", ".join(f"{kind} {count}" for kind, count in kinds.items())
    median, far = _quantile(histogram, 0.5), _quantile(histogram, 0.95)
    unsure = 100 * np.mean([row["unsure"] for row in good])
    sys.stdout.write(
        f"  {person:<8}{len(rows):>6}{len(rows) - len(good):>8}{median:>11.2f}{far:>9.2f}{unsure:>10.1f}  {found}\n"
    )
    sys.stdout.flush()


def _histogram(rows: list[_Row]) -> np.ndarray:
    """Return the number of residuals of all takes in each step of ``STEP_MM``."""
    longest = max(len(row["residuals"]) for row in rows)
    return sum((np.pad(row["residuals"], (0, longest - len(row["residuals"]))) for row in rows), np.zeros(longest, int))


def _quantile(histogram: np.ndarray, share: float) -> float:
    """Return a quantile of the residuals in millimetres, with a resolution of ``STEP_MM``."""
    return STEP_MM * float(np.searchsorted(np.cumsum(histogram), share * histogram.sum()))


def _person(paths: list[Path]) -> MarkerSubject:
    """Return the person of these takes."""
    chosen = [paths[i] for i in np.unique(np.linspace(0, len(paths) - 1, CALIBRATED_FROM).astype(int))]
    return calibrate_person([Capture(path.stem, markers=ui_prmd(path)) for path in chosen])


def _solved(path: Path, person: MarkerSubject) -> _Row:
    """Return whether the solve failed, residual counts by ``STEP_MM``, the share of unsure frames, and diagnostics."""
    try:
        motion = solve(Capture(path.stem, markers=ui_prmd(path)), person=person).motion
    except MocapError as error:
        sys.stdout.write(f"  {path.stem}: {error}\n")
        return {"failed": True, "residuals": [], "unsure": 0.0, "found": {}}
    assert motion.marker_residual_mm is not None and motion.flags is not None
    found = Counter(item.code for item in read_diagnostics(motion.provenance.get("diagnostics")))
    residual = motion.marker_residual_mm[np.isfinite(motion.marker_residual_mm)]
    counts = np.bincount(np.round(residual / STEP_MM).astype(int))
    unsure = float(((motion.flags & FLAG_UNSURE) > 0).mean())
    return {"failed": False, "residuals": counts.tolist(), "unsure": unsure, "found": dict(found)}
