"""BundleMoCap (Albanis et al. 2023) and BundleMoCap++ (Albanis 2026, thesis 6.2), as published.

The solver's method ``bundlemocap++`` uses the same windows. Here, start, curve and minimiser can be varied for
comparison, and both methods get their shape from the common start (``person.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from research.baselines.base import BaselineResult
from research.baselines.person import ROBUST_SCALE, BodyBaseline, Prepared
from research.baselines.sequence import Sequence, States, pose_prior
from research.baselines.windows import GAUSSIAN, OtherWindow, Root
from research.descent.lbfgs import lbfgs
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import silent
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.recipes.bundlemocap import KEYS, KeyState, Window, keys_near, select_keys, slide
from solver_backend.fitters.single_frame import fit_to_points
from solver_backend.priors.base import PosePrior
from solver_backend.solver.descent import MinimiseResult, MinimiseSettings, gradient_descent
from solver_backend.solver.manifolds import Product

MAX_ITERATIONS = 30  # Iterations per window (thesis 6.3.1).
MOST_KEYS = 6  # Free keys per window. A polynomial through more keys would oscillate.
_START = "start and shape from triangulated points in place of HMR"
Optimiser = Literal["gradient", "lbfgs"]
Start = Literal["previous", "points"]


@dataclass(frozen=True)
class BundleMoCapPlusPlus(BodyBaseline):
    """BundleMoCap++: SPoser and SIDER-2 in windows of 20 frames, with only the data term."""

    window: int = 20  # Frames per window.
    optimiser: Optimiser = "gradient"
    """Algorithm 1, or limited-memory BFGS on the same manifold, which gives the method better results."""
    start: Start = "points"
    """Start of each key: a fit to the triangulated points of its frame, or a copy of the previous key, as the thesis
    seems to mean. Fits give better results. On training motions, copies double the error."""
    scale: float = 4.0 * ROBUST_SCALE  # Scale of the Geman-McClure penalty, chosen by ``tune_baselines``.
    root: Root = "sider"  # Motion of the root between keys.
    interpolation: int = 2
    """The n of SIDER-n, which is the number of free keys per window. 1 means SLERP (table 6.8)."""
    name: str = "BundleMoCap++"
    simplified: str = f"{_START}, translations on the parabola through the keys (eq. 6.10's cubic has one degree more)."

    def fit(self, prepared: Prepared) -> BaselineResult:
        """Slide SIDER-n windows over the take.

        Raises:
            JobInvalid: n is not supported, or SLERP from key to key is combined with an n other than 2.
        """
        if not 1 <= self.interpolation <= MOST_KEYS or (self.root == "slerp" and self.interpolation != 2):
            raise JobInvalid(
                f"There is no SIDER-{self.interpolation} with the root by {self.root}.",
                where=self.name,
                hint=f"SIDER-n is for n = 1 to {MOST_KEYS}. The root by SLERP is for n = 2.",
            )
        slider = _Slider(
            prepared, prepared.problem.prior, KEYS, self.scale, 0.0, self.interpolation, self.optimiser, self.root
        )
        return slider.slide(self.name, self.window, self.start)


@dataclass(frozen=True)
class BundleMoCap(BodyBaseline):
    """BundleMoCap: VPoser and SLERP in windows of 10 frames between two keys."""

    window: int = 10  # Frames per window.
    optimiser: Optimiser = "lbfgs"  # Algorithm 1 was introduced by the successor.
    start: Start = "points"  # as in BundleMoCapPlusPlus
    latent_weight: float = 3.0  # Weight of ``|z|²/2`` in every frame, chosen by ``tune_baselines``.
    scale: float = 2.0 * ROBUST_SCALE  # Scale of the Geman-McClure penalty, chosen by ``tune_baselines``.
    name: str = "BundleMoCap"
    simplified: str = f"{_START}."

    def fit(self, prepared: Prepared) -> BaselineResult:
        """Slide SLERP windows over the take."""
        slider = _Slider(prepared, pose_prior(), GAUSSIAN, self.scale, self.latent_weight, 1, self.optimiser, "sider")
        return slider.slide(self.name, self.window, self.start)


@dataclass(frozen=True)
class _Slider:
    prepared: Prepared
    prior: PosePrior
    keys: Product
    scale: float
    latent_weight: float
    free: int  # Free keys per window.
    optimiser: Optimiser
    root: Root

    def slide(self, name: str, length: int, start: Start) -> BaselineResult:
        problem = self.prepared.problem
        layout = KeyframeLayout.even(problem.num_frames, length, free=self.free)
        guesses = self._keys_at(layout.key_times if start == "points" else layout.key_times[:1])

        def window(index: np.ndarray, time: np.ndarray, key: KeyState) -> OtherWindow:
            return OtherWindow(
                self.prepared.subject, self.prior, problem.measurements.term.select(index), self.scale, time, key,
                self.keys is GAUSSIAN, self.latent_weight, self.root,
            )  # fmt: skip

        def begin(w: int, key: KeyState) -> KeyState:
            own = slice(w * self.free + 1, (w + 1) * self.free + 1)
            return select_keys(guesses, own) if start == "points" else select_keys(key, np.zeros(self.free, dtype=int))

        def minimise(window: Window, state: KeyState) -> MinimiseResult:
            method = {"gradient": gradient_descent, "lbfgs": lbfgs}[self.optimiser]
            return method(self.keys, window.objective, state, MinimiseSettings(max_iterations=MAX_ITERATIONS))

        slid = slide(layout, select_keys(guesses, slice(0, 1)), window, begin, minimise, silent)
        counts = {
            "windows": layout.num_windows,
            "iterations": sum(found.iterations for found in slid.found),
            "evaluations": sum(found.evaluations for found in slid.found),
        }
        return self.prepared.result(name, slid.frames, layout.key_times, counts)

    def _keys_at(self, times: np.ndarray) -> KeyState:
        """Fit keys to the points in visible frames near these times. Gaussian codes are also fitted to the views."""
        problem, subject, seen = self.prepared.problem, self.prepared.subject, self.prepared.seen
        if self.keys is KEYS:
            return keys_near(problem, subject, times, seen)
        frames = seen[np.abs(times[:, None] - seen).argmin(axis=1)]
        fitted = fit_to_points(problem, subject, frames)
        start = States(self.prior.encode(problem.prior.decode(fitted.z)), fitted.root, fitted.transl)
        sequence = Sequence(subject, self.prior, problem.objective.select(frames), self.latent_weight)
        solved = sequence.solve(start, self.scale, MAX_ITERATIONS)
        return solved.z, solved.root, solved.transl
