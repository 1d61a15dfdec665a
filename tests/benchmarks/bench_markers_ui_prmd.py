"""Every take of UI-PRMD (eight people, ten movements, Plug-in Gait 39) solved without a person's help.

Each person is calibrated once, from a few takes; every take is then solved by the bundle. One table: residual by
person, takes that failed, frames that deserve a look, what was found wrong. Needs the recordings (MOCAP_SHARED_DATA);
it runs for tens of minutes, and MOCAP_UI_PRMD_TAKES=N solves the first N takes of each person alone.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import read_diagnostics
from solver_backend.exchange.errors import MocapError
from solver_backend.fitters import solve
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.types import FLAG_UNSURE, Capture, MarkerSubject
from tests.benchmarks.marker_takes.takes import folder, ui_prmd
from tests.benchmarks.metric import Metric

CALIBRATED_FROM = 6
"""Takes of a person, spread over the movements."""


def run() -> list[Metric]:
    """Solve every take and print the table."""
    people: dict[str, list[Path]] = {}
    for path in sorted((folder() / "ui_prmd").glob("m*_s*_e*.npz")):
        people.setdefault(path.stem.split("_")[1], []).append(path)
    most = int(os.environ.get("MOCAP_UI_PRMD_TAKES", "0")) or None
    residuals, failed, total = [], 0, 0
    sys.stdout.write(
        f"  {'person':<8}{'takes':>6}{'failed':>8}{'median mm':>11}{'95 % mm':>9}{'unsure %':>10}  found\n"
    )
    for person, paths in people.items():
        record = _person(paths)
        rows = [_solved(path, record) for path in paths[:most]]
        good = [row for row in rows if row is not None]
        total, failed = total + len(rows), failed + len(rows) - len(good)
        residual = np.concatenate([row[0] for row in good])
        unsure = 100 * np.mean([row[1] for row in good])
        kinds = sum((row[2] for row in good), Counter[str]())
        found = ", ".join(f"{kind} {count}" for kind, count in kinds.items())
        median, far = float(np.median(residual)), float(np.quantile(residual, 0.95))
        sys.stdout.write(
            f"  {person:<8}{len(rows):>6}{len(rows) - len(good):>8}{median:>11.2f}{far:>9.2f}{unsure:>10.1f}  {found}\n"
        )
        sys.stdout.flush()
        residuals.append(residual)
    every = np.concatenate(residuals)
    return [
        Metric("failed_takes", float(failed), ""),
        Metric("takes", float(total), "", "higher"),
        Metric("residual_median_mm", float(np.median(every)), "mm"),
        Metric("residual_p95_mm", float(np.quantile(every, 0.95)), "mm"),
    ]


def _person(paths: list[Path]) -> MarkerSubject:
    """Return the person of these takes."""
    chosen = [paths[i] for i in np.unique(np.linspace(0, len(paths) - 1, CALIBRATED_FROM).astype(int))]
    return calibrate_person([Capture(path.stem, markers=ui_prmd(path)) for path in chosen])


def _solved(path: Path, person: MarkerSubject) -> tuple[np.ndarray, float, Counter[str]] | None:
    """Return residuals in millimetres, the share of unsure frames and what was found; None where the solve failed."""
    try:
        motion = solve(Capture(path.stem, markers=ui_prmd(path)), person=person).motion
    except MocapError as error:
        sys.stdout.write(f"  {path.stem}: {error}\n")
        return None
    assert motion.marker_residual_mm is not None and motion.flags is not None
    found = Counter(item.code for item in read_diagnostics(motion.provenance.get("diagnostics")))
    residual = motion.marker_residual_mm[np.isfinite(motion.marker_residual_mm)]
    return residual, float(((motion.flags & FLAG_UNSURE) > 0).mean()), found
