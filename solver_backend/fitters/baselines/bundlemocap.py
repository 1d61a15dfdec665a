"""BundleMoCap (Albanis et al. 2023) and BundleMoCap++ (Albanis 2026, thesis 6.2) as they were published.

One window after the other: its first key is fixed, the others start there and are moved by Algorithm 1 (projected
gradient, retraction, strong Wolfe) on the data term alone, at most 30 iterations; no rotation off the manifold, no
detector bias, no second pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver_backend.fitters.baselines.base import Baseline, BaselineResult
from solver_backend.fitters.baselines.person import prepare
from solver_backend.fitters.baselines.windows import KEYS, KeyState, Window
from solver_backend.fitters.frame import fit_frames
from solver_backend.fitters.initial import fit_to_points
from solver_backend.fitters.keyframes import KeyframeLayout
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.result import build_motion
from solver_backend.fitters.subject import PosedFrames, Subject
from solver_backend.solver.riemannian import MinimiseSettings, gradient_descent, lbfgs
from solver_backend.types import Capture

SCALE_PX = 100.0
"""Geman-McClure scale in pixels; the thesis gives none, this is SMPLify-X's (Pavlakos et al. 2019)."""
MAX_ITERATIONS = 30
"""Of a window (thesis 6.3.1)."""
_START = "start and shape from triangulated points in place of HMR"


@dataclass(frozen=True)
class BundleMoCapPlusPlus(Baseline):
    """SPoser, SIDER-2, windows of 20 frames, two free keys in each."""

    window: int = 20
    """Frames a window."""
    optimiser: Literal["gradient", "lbfgs"] = "gradient"
    """Algorithm 1, or limited-memory BFGS on the same manifold: a kinder reading of the thesis."""
    name: str = "BundleMoCap++"
    simplified: str = f"{_START}; translations on the parabola through the keys (eq. 6.10's cubic has one degree more)."

    def solve(self, capture: Capture) -> BaselineResult:
        """Slide SIDER-2 windows over the take."""
        return _slide(capture, self.window, self.optimiser, self.name, keys=2)


@dataclass(frozen=True)
class BundleMoCap(Baseline):
    """SLERP between two keys, windows of 10 frames, one free key in each."""

    window: int = 10
    """Frames a window."""
    optimiser: Literal["gradient", "lbfgs"] = "gradient"
    """As in BundleMoCapPlusPlus."""
    name: str = "BundleMoCap"
    simplified: str = f"SPoser in place of VPoser; {_START}."

    def solve(self, capture: Capture) -> BaselineResult:
        """Slide SLERP windows over the take."""
        return _slide(capture, self.window, self.optimiser, self.name, keys=1)


def _slide(capture: Capture, length: int, optimiser: str, name: str, *, keys: int) -> BaselineResult:
    problem, subject = prepare(capture, sigma_px=1.0)
    layout = KeyframeLayout.even(problem.num_frames, length)
    minimise = {"gradient": gradient_descent, "lbfgs": lbfgs}[optimiser]
    key, parts, iterations, evaluations = _first_key(problem, subject), [], 0, 0
    positions, time = layout.positions(layout.frames)
    for w in range(layout.num_windows):
        index = np.flatnonzero(positions == w)
        window = Window(subject, problem.prior, problem.term.select(index), SCALE_PX, time[index], key)
        start: KeyState = (key[0].repeat(keys, axis=0), key[1].repeat(keys, axis=0), key[2].repeat(keys, axis=0))
        objective, interpolate = (window.by_sider2, window.sider2) if keys == 2 else (window.by_slerp, window.slerp)
        found = minimise(KEYS, objective, start, MinimiseSettings(max_iterations=MAX_ITERATIONS))
        iterations, evaluations = iterations + found.iterations, evaluations + found.evaluations
        parts.append(interpolate(found.state)[0])
        key = (found.state[0][-1:], found.state[1][-1:], found.state[2][-1:])
    frames = PosedFrames(*(np.concatenate([getattr(p, field) for p in parts]) for field in ("root", "local", "transl")))
    motion = build_motion(
        capture, subject, frames, problem.observations, key_times=layout.key_times, sigma=None, scale=3.0,
        provenance={"baseline": name},
    )  # fmt: skip
    assert motion.keypoints3d is not None
    counts = {"windows": layout.num_windows, "iterations": iterations, "evaluations": evaluations}
    return BaselineResult(motion.keypoints3d, motion, counts)


def _first_key(problem: Problem, subject: Subject) -> KeyState:
    """Return the single-frame fit of the first seen frame."""
    seen = np.flatnonzero(problem.observations.seen)[:1]
    states = fit_to_points(subject, problem.prior, problem.observations, seen)
    states, _ = fit_frames(subject, problem.prior, problem.term.select(seen), states, (SCALE_PX,), MAX_ITERATIONS)
    return states.z, states.root, states.transl
