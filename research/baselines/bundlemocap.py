"""BundleMoCap (Albanis et al. 2023) and BundleMoCap++ (Albanis 2026, thesis 6.2) as they were published.

One window after the other: its first key is fixed, the others are moved by Algorithm 1 (projected gradient, retraction,
strong Wolfe), at most 30 iterations; no rotation off the manifold, no detector bias, no second pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from research.baselines.base import Baseline, BaselineResult
from research.baselines.person import ROBUST_SCALE, Prepared, prepare
from research.baselines.sequence import Sequence, States, pose_prior
from research.baselines.windows import GAUSSIAN, SPHERICAL, KeyState, Root, Window
from research.descent.manifolds import Product
from research.descent.riemannian import MinimiseSettings, gradient_descent, lbfgs
from solver_backend.exchange.errors import JobInvalid
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.fitters.single_frame import fit_frames, fit_to_points
from solver_backend.priors.base import PosePrior
from solver_backend.solver.levenberg_marquardt import LMSettings
from solver_backend.types import Capture

MAX_ITERATIONS = 30  # Of a window (thesis 6.3.1).
MOST_KEYS = 6  # Free keys a window: a polynomial of more swings between them.
_START = "start and shape from triangulated points in place of HMR"
Optimiser = Literal["gradient", "lbfgs"]
Start = Literal["previous", "points"]


@dataclass(frozen=True)
class BundleMoCapPlusPlus(Baseline):
    """SPoser, SIDER-2, windows of 20 frames, two free keys in each, the data term alone."""

    window: int = 20  # Frames a window.
    optimiser: Optimiser = "gradient"
    """Algorithm 1, or limited-memory BFGS on the same manifold: a kinder reading of the thesis."""
    start: Start = "points"
    """Keys start from fits to their frames' triangulated points, which is kinder, or as copies of the key before, as
    the thesis seems to mean; on training motions the latter doubles the error."""
    scale: float = 2.0 * ROBUST_SCALE  # Of Geman-McClure's penalty; tuned on training motions.
    root: Root = "sider"  # How the root moves between keys.
    interpolation: int = 2
    """n of SIDER-n, and of the free keys a window; 1 is SLERP (table 6.8), more the thesis' outlook."""
    name: str = "BundleMoCap++"
    simplified: str = f"{_START}; translations on the parabola through the keys (eq. 6.10's cubic has one degree more)."

    def solve(self, capture: Capture) -> BaselineResult:
        """Slide SIDER-n windows over the take.

        Raises:
            JobInvalid: there is no such n, or SLERP from key to key is asked for, which is for n = 2 alone.
        """
        if not 1 <= self.interpolation <= MOST_KEYS or (self.root == "slerp" and self.interpolation != 2):
            raise JobInvalid(
                f"There is no SIDER-{self.interpolation} with the root by {self.root}.",
                where=self.name,
                hint=f"SIDER-n is for n = 1 to {MOST_KEYS}; the root by SLERP is for n = 2.",
            )
        prepared = prepare(capture)
        slider = _Slider(
            prepared, prepared.problem.prior, SPHERICAL, self.scale, 0.0, self.interpolation, self.optimiser, self.root
        )
        return slider.slide(self.name, self.window, self.start)


@dataclass(frozen=True)
class BundleMoCap(Baseline):
    """VPoser, SLERP between two keys, windows of 10 frames, one free key in each."""

    window: int = 10  # Frames a window.
    optimiser: Optimiser = "lbfgs"  # As in BundleMoCapPlusPlus; the sphere's Algorithm 1 came with the successor.
    start: Start = "points"  # As in BundleMoCapPlusPlus.
    latent_weight: float = 1.0  # Of ``|z|²/2`` in every frame; tuned on training motions.
    scale: float = 2.0 * ROBUST_SCALE  # Of Geman-McClure's penalty; tuned on training motions.
    name: str = "BundleMoCap"
    simplified: str = f"{_START}."

    def solve(self, capture: Capture) -> BaselineResult:
        """Slide SLERP windows over the take."""
        slider = _Slider(
            prepare(capture), pose_prior(), GAUSSIAN, self.scale, self.latent_weight, 1, self.optimiser, "sider"
        )
        return slider.slide(self.name, self.window, self.start)


@dataclass(frozen=True)
class _Slider:
    prepared: Prepared
    prior: PosePrior
    keys: Product
    scale: float
    latent_weight: float
    free: int  # Free keys a window.
    optimiser: Optimiser
    root: Root

    def slide(self, name: str, length: int, start: Start) -> BaselineResult:
        """Solve window after window."""
        problem = self.prepared.problem
        layout = KeyframeLayout.even(problem.num_frames, length)
        number, time = layout.positions(layout.frames)
        minimise = {"gradient": gradient_descent, "lbfgs": lbfgs}[self.optimiser]
        times = _key_times(layout, self.free)
        guesses = self._keys_at(times if start == "points" else times[:1])
        key, parts, iterations, evaluations = _select(guesses, slice(0, 1)), [], 0, 0
        for w in range(layout.num_windows):
            index = np.flatnonzero(number == w)
            window = Window(
                self.prepared.subject, self.prior, self.keys, problem.measurements.term.select(index), self.scale,
                time[index], key, self.latent_weight, self.root,
            )  # fmt: skip
            own = slice(w * self.free + 1, (w + 1) * self.free + 1)
            state = _select(guesses, own) if start == "points" else _select(key, slice(0, 1), self.free)
            found = minimise(self.keys, window.objective, state, MinimiseSettings(max_iterations=MAX_ITERATIONS))
            iterations, evaluations = iterations + found.iterations, evaluations + found.evaluations
            parts.append(window.frames(found.state))
            key = _select(found.state, slice(-1, None))
        counts = {"windows": layout.num_windows, "iterations": iterations, "evaluations": evaluations}
        return self.prepared.result(name, PosedFrames.concatenate(parts), times, counts)

    def _keys_at(self, times: np.ndarray) -> KeyState:
        """Return single-frame fits of the seen frames nearest to these times."""
        problem, subject, seen = self.prepared.problem, self.prepared.subject, self.prepared.seen
        nearest = seen[np.abs(times[:, None] - seen).argmin(axis=1)]
        unique, inverse = np.unique(nearest, return_inverse=True)
        objective = problem.objective.select(unique)
        fitted = fit_to_points(problem, subject, unique)
        if self.keys is SPHERICAL:
            fitted = fit_frames(
                subject, problem.prior, objective, fitted, (self.scale,), LMSettings(MAX_ITERATIONS)
            ).state
            return _select((fitted.z, fitted.root, fitted.transl), np.asarray(inverse).reshape(-1))
        start = States(self.prior.encode(problem.prior.decode(fitted.z)), fitted.root, fitted.transl)
        solved = Sequence(subject, self.prior, objective, self.latent_weight).solve(start, self.scale, MAX_ITERATIONS)
        return _select((solved.z, solved.root, solved.transl), np.asarray(inverse).reshape(-1))


def _key_times(layout: KeyframeLayout, free: int) -> np.ndarray:
    """Return (W n + 1,) frame numbers of the keys, n of them a window, evenly."""
    first, last = layout.bounds[:-1, None], layout.bounds[1:, None]
    inside = first + (last - first) * np.arange(free) / free
    return np.append(inside.reshape(-1), layout.bounds[-1])


def _select(keys: KeyState, index: slice | np.ndarray, times: int = 1) -> KeyState:
    """Return some of the keys, each so many times."""
    z, R, t = (part[index].repeat(times, axis=0) for part in keys)
    return z, R, t
