"""The add-on's presets on two benchmark captures of 600 frames and four views: exercises and fast dance, NumPy.

Figures are mean errors of the 24 joints, the acceleration error, and processor seconds of the solve in a warm process.
For wrists and ankles they also include the share of the true peak speed that the solve keeps, and the frequency above
which it keeps less than half of the true amplitude.
"""

from __future__ import annotations

import time

import numpy as np

from solver_backend.exchange.solve_settings import PRESETS, SolveSettings
from solver_backend.fitters import solve
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm
from tests.benchmarks.comparison.captures import filmed
from tests.benchmarks.metric import Metric

FAST_M_S = 1.0  # Peak speed of a limb within one second that counts as fast.
LIMBS = [7, 8, 20, 21]  # Ankles and wrists among SMPL's joints.
TAKES = {"exercises": "13_29:600+600", "dance": "salsa_07:20+600"}


def run() -> list[Metric]:
    """Solve each capture with each preset."""
    metrics = []
    for name, take in TAKES.items():
        capture = filmed(take)
        for preset, settings in PRESETS.items():
            start = time.process_time()
            joints = solve(capture, SolveSettings(**settings)).motion.joints
            seconds = time.process_time() - start
            key, truth = f"{name}_{preset.lower()}", capture.truth["joints"]
            metrics += [
                Metric(f"{key}_mpjpe_mm", mpjpe_mm(joints, truth), "mm"),
                Metric(f"{key}_accel_m_s2", accel_error_m_s2(joints, truth, capture.fps), "m/s²"),
                Metric(f"{key}_cpu_s", seconds, "s", rel_tol=0.8),
                Metric(f"{key}_peak_share", peak_share(joints, truth, capture.fps), "", "higher"),
                Metric(f"{key}_half_hz", half_amplitude_hz(joints, truth, capture.fps), "Hz", "higher", 0.15),
            ]
    return metrics


def peak_share(joints: np.ndarray, truth: np.ndarray, fps: float) -> float:
    """Return the median ratio of solved and true peak speeds of fast limbs in each second. Shapes are (F, 24, 3)."""
    seconds = len(truth) // int(fps)
    peaks = [
        (np.linalg.norm(np.gradient(x[:, LIMBS], axis=0), axis=-1) * fps)[: seconds * int(fps)]
        .reshape(seconds, int(fps), len(LIMBS))
        .max(1)
        for x in (joints, truth)
    ]
    fast = peaks[1] > FAST_M_S
    return float(np.median(peaks[0][fast] / peaks[1][fast]))


def half_amplitude_hz(joints: np.ndarray, truth: np.ndarray, fps: float) -> float:
    """Return the first whole frequency in Hz from which on less than half of the limbs' true movement is kept.

    The gain of a band is the regression of the solved on the true Fourier coefficients: sum Re(T* J) / sum |T|^2.
    """
    window = np.hanning(len(truth))[:, None, None]
    solved, true = (np.fft.rfft((x - x.mean(0))[:, LIMBS] * window, axis=0) for x in (joints, truth))
    hz = np.fft.rfftfreq(len(truth), 1.0 / fps)
    for low in range(int(fps / 2)):
        band = (hz >= low) & (hz < low + 1)
        if (true[band].conj() * solved[band]).real.sum() < 0.5 * (np.abs(true[band]) ** 2).sum():
            return float(low)
    return fps / 2
