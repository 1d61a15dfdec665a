"""The recipe for a person who is known and wears markers: a pass that comes near, and one off the manifold.

Shape and places stay, all is done in single precision, and what stands between the passes looks at the take at
``REFERENCE_FPS``: markers are exact, and more frames add nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.chunked import Stretches, solve_in_single
from solver_backend.fitters.keyframes.initial_keys import initial_keys, keys_of_frames
from solver_backend.fitters.keyframes.key_density import closer_window, paces
from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.marker_calibration.rough_motion import RATE_HZ
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import REFERENCE_FPS, Problem
from solver_backend.fitters.recipes.bundle import FIXED_CODES, ON_THE_MANIFOLD, Bundle
from solver_backend.fitters.recipes.passes import Pass, Step, run_passes
from solver_backend.fitters.recipes.result import STAGE, solved_take
from solver_backend.fitters.recipes.steps import learn_window_noise, resolve_lost_limbs, resolve_outlier_markers
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult

CALM_M_S2, CLOSEST = 4.0, 0.4
"""Mean acceleration of markers up to which the settings' window holds, and the least share of it, which runners reach:
markers are off by less than what keypoints need wider windows for. At 7 m/s knees bend by 3.2 degrees RMS from
OpenSim's with 0.4 times the window, 5.7 with all of it."""
NEAR_M = 0.01
"""A body between two frames of a rough motion is off by ``a h² / 8``; where that is less for all but the fastest
twentieth of the markers, no pass has to come near."""
LOOSENESS = 2.0
"""So many times as far as beside free codes joints may turn: codes that follow take a part of every turn. Chosen by
hand."""


@dataclass(frozen=True)
class KnownPersonPlan:
    """Which passes are made, and on what."""

    window: int
    """Frames of a window."""
    passes: tuple[Pass, ...]
    """On the prior's manifold, where the take does not start near enough, and off it."""
    after: tuple[Step, ...]
    """What follows the last pass."""
    stride: int
    """Every so many frames are looked at between the passes."""
    covariance_stride: int
    """Covariances of every so many frames are formed."""

    @classmethod
    def of(cls, problem: Problem, settings: SolveSettings) -> KnownPersonPlan:
        """Return the plan of a problem whose person is known."""
        scale, steps, usual = settings.robust_scale, settings.iterations, problem.frames_of(settings.refine_window)
        measured, stride = problem.measurements, problem.frames_of(1, 1)
        rate = problem.fps / stride
        apart = max(1, round(0.5 * settings.refine_window * rate / REFERENCE_FPS))
        mean, fastest = paces(measured.points[::stride], rate, apart)
        window = closer_window(usual, mean, CALM_M_S2, CLOSEST)
        # Markers are exact: five frames or so between two keys determine as much as all of them, and three nearly so.
        near = Schedule((2 * scale,), min(3, steps), max(1, round(0.3 * window)), 3e-2, hessian_frames=3)
        last = Schedule((scale,), steps, max(1, round(0.2 * window)), 1e-2)
        starts_near = measured.rough is not None and fastest / (8 * RATE_HZ**2) < NEAR_M
        free = FIXED_CODES if settings.residual_rotations else ON_THE_MANIFOLD
        off = Pass(last, free, (resolve_lost_limbs, learn_window_noise), LOOSENESS)
        passes = (off,) if starts_near else (Pass(near, ON_THE_MANIFOLD), off)
        after: tuple[Step, ...] = (resolve_lost_limbs,)
        if settings.residual_rotations and measured.marker_sigma is not None:
            after += (partial(resolve_outlier_markers, schedule=replace(last, scales=(4 * scale, scale))),)
        return cls(window, passes, after, stride, problem.frames_of(4, 1))


def solve_known_person(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a person whose shape and landmarks are known."""
    plan = KnownPersonPlan.of(problem, settings)
    layout = KeyframeLayout.even(problem.num_frames, plan.window)
    keys = initial_keys(problem, subject, layout)
    bundle = Bundle.start(
        problem, subject, settings, layout, plan.window, keys, plan.passes[0].schedule,
        partial(solve_in_single, each=each), keys_of_frames(problem, subject, layout, keys),
        np.arange(0, problem.num_frames, plan.stride),
    )  # fmt: skip
    bundle = run_passes(bundle, plan.passes, progress, STAGE, plan.after)
    return solved_take(bundle, progress, plan.covariance_stride)
