"""Choose the baselines' weights on training motions: ``python -m tests.benchmarks.tune_baselines [METHOD ...]``.

Every method has the same number of trials on the same captures. A search by coordinates starts from the current
settings and ends when both neighbours of every field are worse. The measure is the sum of MPJPE and acceleration error,
each in units of its best value. The best setting replaces the current one if its gain is larger than the standard error
of the gain over the takes. The takes of the comparison are not used.

Every setting is written to ``tuned_baselines.json`` when it is measured, so that a search can resume. A test compares
the chosen settings with the current ones. Without names, the methods without a chosen setting in the file are searched.
Delete the file after a change of a method.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from research.baselines import DCT, DMMR, ETC, BundleMoCap, BundleMoCapPlusPlus, MuVS
from research.baselines.person import BodyBaseline, Prepared, prepare
from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm
from solver_backend.types import Capture
from tests.benchmarks.comparison.validation_takes import training_take

RESULTS = Path(__file__).with_name("tuned_baselines.json")
TAKES = (("49_02", 40, 600), ("06_02", 40, 60), ("02_01", 40, 60), ("14_14", 40, 290))
"""Name, frames, first frame: dance, basketball, walking, and exercises on the floor. None is in the comparison."""
BUDGET = 10
"""Number of settings that every method may try."""
FACTOR = 2.0
"""Factor between adjacent values of a setting."""
STARTS: dict[str, tuple[BodyBaseline, tuple[str, ...]]] = {
    "MuVS": (MuVS(), ("latent_weight",)),
    "DCT": (DCT(), ("latent_weight", "sigma_m")),
    "ETC": (ETC(), ("latent_weight", "speed_m_s")),
    "DMMR": (DMMR(), ("latent_weight", "codes_per_s")),
    "BundleMoCap": (BundleMoCap(), ("latent_weight", "scale")),
    "BundleMoCap++": (BundleMoCapPlusPlus(), ("scale",)),
}
"""Start of each search, and the fields that it changes."""

Table = list[list[float]]  # MPJPE and acceleration error of each take.
Steps = tuple[int, ...]  # How often each field is multiplied by ``FACTOR``.


def main(argv: list[str]) -> int:
    """Search the settings of the named methods, or of those that the file lacks."""
    captures = [
        benchmark_capture(training_take(name, frames, start), BenchmarkSettings(seed=100 + number))
        for number, (name, frames, start) in enumerate(TAKES)
    ]
    prepared = [prepare(capture) for capture in captures]
    stored = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    for method in argv or [name for name in STARTS if "chosen" not in stored.get(name, {})]:
        start, fields = STARTS[method]
        record = stored.setdefault(method, {"tried": {}})

        def errors(
            steps: Steps,
            start: BodyBaseline = start,
            fields: tuple[str, ...] = fields,
            record: dict[str, Any] = record,
        ) -> tuple[float, float]:
            setting, key = replace(start, **values_of(start, fields, steps)), _key(start, fields, steps)
            if key not in record["tried"]:
                pairs = zip(prepared, captures, strict=True)
                record["tried"][key] = [[float(f"{value:.4g}") for value in figures(setting, *pair)] for pair in pairs]
                _write(stored)
            mpjpe, accel = np.mean(record["tried"][key], axis=0)
            sys.stdout.write(f"{start.name}, {key}: {mpjpe:.2f} mm, {accel:.2f} m/s²\n")
            sys.stdout.flush()
            return mpjpe, accel

        best, inside = search(errors, len(fields))
        in_use, tables = (0,) * len(fields), record["tried"]
        gains = is_better(*(tables[_key(start, fields, steps)] for steps in (best, in_use)), list(tables.values()))
        record |= {
            "best": values_of(start, fields, best), "neighbours_are_worse": inside,
            "chosen": values_of(start, fields, best if gains else in_use),
            "recorded": date.today().isoformat(),
        }  # fmt: skip
        _write(stored)
        sys.stdout.write(f"{method}: best {record['best']}, chosen {record['chosen']}\n")
    return 0


def is_better(found: Table, in_use: Table, tables: list[Table]) -> bool:
    """Return whether a setting's mean gain over the takes is larger than the standard error of this mean."""
    least = np.mean(tables, axis=1).min(axis=0)
    gain = (np.subtract(in_use, found) / least).sum(axis=1)
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)))


def _key(start: BodyBaseline, fields: tuple[str, ...], steps: Steps) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in values_of(start, fields, steps).items())


def _write(stored: dict[str, Any]) -> None:
    RESULTS.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


def values_of(start: BodyBaseline, fields: tuple[str, ...], steps: Steps) -> dict[str, float]:
    """Return the fields of a setting after these numbers of steps."""
    pairs = zip(fields, steps, strict=True)
    return {name: float(f"{getattr(start, name) * FACTOR**step:.6g}") for name, step in pairs}


def search(errors: Callable[[Steps], tuple[float, float]], fields: int) -> tuple[Steps, bool]:
    """Return the best steps, and whether all their neighbours were tried.

    Neighbours of the best setting so far are tried until all of them are worse, or ``BUDGET`` is reached. Settings are
    compared by the sum of both errors in units of the smallest one found, so the best may change with every trial.
    """
    found = {(0,) * fields: errors((0,) * fields)}
    while True:
        table = np.array(list(found.values()))
        best = list(found)[int((table / table.min(axis=0)).sum(axis=1).argmin())]
        around = [tuple(np.add(best, step * row)) for row in np.eye(fields, dtype=int) for step in (-1, 1)]
        untried = [steps for steps in around if steps not in found]
        if not untried or len(found) == BUDGET:
            return best, not untried
        found[untried[0]] = errors(untried[0])


def figures(baseline: BodyBaseline, prepared: Prepared, capture: Capture) -> tuple[float, float]:
    """Return MPJPE in mm and acceleration error in m/s² of a fit."""
    motion = baseline.fit(prepared).motion
    assert motion is not None
    truth = capture.truth["joints"]
    return mpjpe_mm(motion.joints, truth), accel_error_m_s2(motion.joints, truth, capture.fps)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
