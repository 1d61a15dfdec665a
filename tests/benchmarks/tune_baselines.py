"""Choose the baselines' weights on training motions: ``python -m tests.benchmarks.tune_baselines [METHOD ...]``.

Each method has six settings, and each setting solves the same captures. The command prints the means of MPJPE and
acceleration error, and their sum in units of each one's best value. The setting with the smallest sum is chosen. The
takes of the comparison are not used.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from research.baselines import DCT, DMMR, ETC, Baseline, BundleMoCap, BundleMoCapPlusPlus, MuVS
from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm
from solver_backend.types import Capture
from tests.benchmarks.comparison.validation_takes import training_take

TAKES = (("49_02", 80, 600), ("06_02", 80, 60), ("02_01", 80, 60), ("14_14", 80, 290))
"""Name, frames, first frame: dance, basketball, walking, and exercises on the floor. None is in the comparison."""
_STIFF = (0.3, 1.0, 3.0)
_ROBUST = (1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
TRIED: dict[str, list[Baseline]] = {
    "MuVS": [MuVS(latent_weight=w) for w in (0.1, *_STIFF, 10.0, 30.0)],
    "DCT": [DCT(latent_weight=w, sigma_m=s) for w in _STIFF for s in (0.003, 0.01)],
    "ETC": [ETC(latent_weight=w, speed_m_s=v) for w in _STIFF for v in (1.0, 2.0)],
    "DMMR": [DMMR(latent_weight=w, codes_per_s=u) for w in _STIFF for u in (5.0, 12.0)],
    "BundleMoCap": [BundleMoCap(latent_weight=w, scale=s) for w in _STIFF for s in (6.0, 12.0)],
    "BundleMoCap++": [BundleMoCapPlusPlus(scale=s) for s in _ROBUST],
}
"""Six settings for every method. The best of DCT, ETC, DMMR and BundleMoCap are at the edge of theirs, so others may be
better. MuVS and BundleMoCap++ have theirs inside."""


def main(argv: list[str]) -> int:
    """Try the settings of the named methods, or of all."""
    captures = [
        benchmark_capture(training_take(name, frames, start), BenchmarkSettings(seed=100 + number))
        for number, (name, frames, start) in enumerate(TAKES)
    ]
    for method in argv or TRIED:
        found = np.array([[figures(baseline, capture) for capture in captures] for baseline in TRIED[method]]).mean(1)
        score = (found / found.min(axis=0)).sum(axis=1)
        for baseline, (mpjpe, accel), points in zip(TRIED[method], found, score, strict=True):
            mark = "*" if points == score.min() else " "
            sys.stdout.write(f"{mark} {points:5.2f} {mpjpe:8.2f} mm {accel:8.2f} m/s²  {differences(baseline)}\n")
            sys.stdout.flush()
    return 0


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
