"""Choose the baselines' weights on training motions: ``python -m tests.benchmarks.tune_baselines [METHOD ...]``.

Every method may try the same number of settings on the same captures. A search by coordinates begins at the settings
in use and ends where both neighbours of every field are worse. The measure is the sum of MPJPE and acceleration error,
each in units of its best value. The takes of the comparison are not used.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from research.baselines import DCT, DMMR, ETC, Baseline, BundleMoCap, BundleMoCapPlusPlus, MuVS
from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm
from solver_backend.types import Capture
from tests.benchmarks.comparison.validation_takes import training_take

TAKES = (("49_02", 80, 600), ("06_02", 80, 60), ("02_01", 80, 60), ("14_14", 80, 290))
"""Name, frames, first frame: dance, basketball, walking, and exercises on the floor. None is in the comparison."""
BUDGET = 16
"""Settings that every method may try."""
FACTOR = 2.0
"""Step of a setting's search."""
STARTS: dict[str, tuple[Baseline, tuple[str, ...]]] = {
    "MuVS": (MuVS(), ("latent_weight",)),
    "DCT": (DCT(), ("latent_weight", "sigma_m")),
    "ETC": (ETC(), ("latent_weight", "speed_m_s")),
    "DMMR": (DMMR(), ("latent_weight", "codes_per_s")),
    "BundleMoCap": (BundleMoCap(), ("latent_weight", "scale")),
    "BundleMoCap++": (BundleMoCapPlusPlus(), ("scale",)),
}
"""Where each search begins, and the fields that it changes."""

Steps = tuple[int, ...]  # How often each field is multiplied by ``FACTOR``.


def main(argv: list[str]) -> int:
    """Search the settings of the named methods, or of all."""
    captures = [
        benchmark_capture(training_take(name, frames, start), BenchmarkSettings(seed=100 + number))
        for number, (name, frames, start) in enumerate(TAKES)
    ]
    for method in argv or STARTS:
        start, fields = STARTS[method]

        def errors(steps: Steps, start: Baseline = start, fields: tuple[str, ...] = fields) -> tuple[float, float]:
            changed = {name: getattr(start, name) * FACTOR**step for name, step in zip(fields, steps, strict=True)}
            setting = replace(start, **changed)
            mpjpe, accel = np.mean([figures(setting, capture) for capture in captures], axis=0)
            sys.stdout.write(f"{mpjpe:8.2f} mm {accel:8.2f} m/s²  {differences(setting)}\n")
            sys.stdout.flush()
            return mpjpe, accel

        best, inside = search(errors, len(fields))
        values = ", ".join(
            f"{name}={getattr(start, name) * FACTOR**step:.4g}" for name, step in zip(fields, best, strict=True)
        )
        ending = "both neighbours of every field are worse" if inside else f"{BUDGET} settings were not enough"
        sys.stdout.write(f"{method}: {values} ({ending})\n")
    return 0


def search(errors: Callable[[Steps], tuple[float, float]], fields: int) -> tuple[Steps, bool]:
    """Return the best steps, and whether every neighbour of theirs was tried.

    Neighbours of the best setting so far are tried until all of them are worse, or ``BUDGET`` is used up. Settings are
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


def figures(baseline: Baseline, capture: Capture) -> tuple[float, float]:
    """Return MPJPE and acceleration error of a solve."""
    motion = baseline.solve(capture).motion
    assert motion is not None
    truth = capture.truth["joints"]
    return mpjpe_mm(motion.joints, truth), accel_error_m_s2(motion.joints, truth, capture.fps)


def differences(baseline: Baseline) -> str:
    """Return the fields of a baseline as text."""
    return repr(replace(baseline, simplified="")).replace(", simplified=''", "")


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
