"""Swung objects at 100 Hz with 1 mm of noise and a fifth of all samples missing: pose errors.

Missing samples are single ones, or each marker for a quarter of a second. A row is the worst of five seeds: root mean
square distance of the markers and angle of the pose (for a stick only its direction, because its roll is not
observable) in frames with at least three markers, which fix a pose. Other figures are the distance in all frames, and
the share of marker centres inside the stated 95 % ellipsoid in all frames.
"""

from __future__ import annotations

import sys
from itertools import product

import numpy as np

from solver_backend.fitters.marker_calibration.unknown_markers import rigid_groups
from solver_backend.fitters.props import solve_prop
from solver_backend.geometry.rotations import exp_so3
from tests.benchmarks.metric import Metric
from tests.support.moving_prop import RACKET, STICK, MovingProp, moving_prop, pose_errors

SHAPES = {
    "racket": RACKET,
    "stick": STICK,
    "box": np.array(list(product((-0.2, 0.2), (-0.15, 0.15), (-0.1, 0.1)))),
    "plate": np.array([(0.0, 0.0, 0.0), (0.18, 0.0, 0.0), (0.05, 0.12, 0.0)]),
}
FRAMES, FPS, SEEDS = 400, 100.0, 5
NOISE_M, MISSING, AWAY_S = 1e-3, 0.2, 0.25
FIXED_BY = 3
"""Number of markers that fix a pose."""
CHI_95 = 7.815  # Squared radius of a Gaussian's 95 % ellipsoid in space.


def run() -> list[Metric]:
    """Solve and print the table."""
    metrics = []
    for name, kind in product(SHAPES, ("single", "bursts")):
        rows = np.array([_errors(name, kind, seed) for seed in range(SEEDS)])
        (mm, degrees, all_mm), inside = rows[:, :3].max(axis=0), rows[:, 3].mean()
        text = f"{mm:5.2f} mm {degrees:5.2f}°, all frames {all_mm:5.2f} mm, inside {inside:5.1f} %"
        sys.stdout.write(f"  {name:<8} {kind:<8} {text}\n")
        metrics += [
            Metric(f"{name}_{kind}_mm", float(mm), "mm", rel_tol=0.1),
            Metric(f"{name}_{kind}_deg", float(degrees), "°", rel_tol=0.1),
            Metric(f"{name}_{kind}_all_mm", float(all_mm), "mm", rel_tol=0.1),
            Metric(f"{name}_{kind}_inside", float(inside), "%", "higher", rel_tol=0.0, abs_tol=3.0),
        ]
    return metrics


def _errors(name: str, kind: str, seed: int) -> tuple[float, float, float, float]:
    """Return errors in millimetres and degrees for fixed poses, millimetres in all frames, and percent inside."""
    shape = SHAPES[name]
    truth = moving_prop(shape, frames=FRAMES, fps=FPS, seed=seed)
    points = truth.recorded(NOISE_M, MISSING if kind == "single" else 0.0, seed)
    if kind == "bursts":
        _hide(points, np.random.default_rng(seed))
    if rigid_groups(points) != [list(range(len(shape)))]:
        return np.inf, np.inf, np.inf, 0.0
    prop = solve_prop(name, [f"m{m}" for m in range(len(shape))], points, FPS)
    assert prop is not None
    fixed = np.isfinite(points[..., 0]).sum(axis=1) >= FIXED_BY
    away, turned = pose_errors(prop, truth, fixed)
    degrees = np.degrees(_directions(prop.markers, truth) if shape is STICK else turned)
    centre = prop.markers.mean(axis=1) - truth.markers.mean(axis=1)
    inside = (centre**2).sum(-1) < CHI_95 * prop.sigma[:, 0] ** 2
    return 1e3 * _rms(away[fixed]), _rms(degrees[fixed]), 1e3 * _rms(away), 100.0 * float(inside.mean())


def _hide(points: np.ndarray, rng: np.random.Generator) -> None:
    """Remove markers for ``AWAY_S`` at a time, until a share ``MISSING`` is removed."""
    length = round(AWAY_S * FPS)
    while np.isnan(points[..., 0]).mean() < MISSING:
        start = rng.integers(len(points) - length)
        points[start : start + length, rng.integers(points.shape[1])] = np.nan


def _directions(markers: np.ndarray, truth: MovingProp) -> np.ndarray:
    """Return the (F,) angles in radians between the lines from the first to the last marker."""
    found = markers[:, -1] - markers[:, 0]
    line = (exp_so3(truth.rotvec) @ (truth.shape[-1] - truth.shape[0])[:, None])[..., 0]
    lengths = np.linalg.norm(found, axis=-1) * np.linalg.norm(line, axis=-1)
    return np.arccos(np.clip((found * line).sum(-1) / lengths, -1.0, 1.0))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))
