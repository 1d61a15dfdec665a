"""A take in the hands of its recipe: keys, person, objective, and what was learned so far."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, cast

import numpy as np

from solver_backend.body.state_layout import CODE, RESIDUAL, ROOT, TRANSL, UNCOVERED, StateLayout
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.bundle_objective import OFF_MANIFOLD, BundleObjective, bundle_objective
from solver_backend.fitters.keyframes.initial_keys import (
    Start,
    closer_window,
    dense_layout,
    initial_keys,
    keys_of_frames,
    paces,
)
from solver_backend.fitters.keyframes.initial_keys import resolve_lost_limbs as resolve_limbs
from solver_backend.fitters.keyframes.initial_keys import resolve_outlier_markers as resolve_markers
from solver_backend.fitters.keyframes.optimise import BundleModel, KeySolution, Schedule, Stretches, solve_in_single
from solver_backend.fitters.keyframes.posterior import covariance_of_joints, noise_inflation
from solver_backend.fitters.model.keyframe_curve import key_poses, keys_at
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, control_points
from solver_backend.fitters.model.subject import (
    OFF_THE_MANIFOLD,
    ON_THE_MANIFOLD,
    Keyframes,
    PosedFrames,
    Subject,
    hemisphere_aligned,
    points_of,
    state_layout,
)
from solver_backend.fitters.problem import REFERENCE_FPS, MethodResult, Problem, SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import Contacts, find_contacts
from solver_backend.fitters.subject_calibration.shape import ShapePrior
from solver_backend.fitters.subject_calibration.shape import refit_shape as refit
from solver_backend.geometry.arrays import Array, index, to_numpy
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.terms import DataTerm

if TYPE_CHECKING:
    from solver_backend.fitters.one_view.depth import OneCamera

FIXED_CODES = (ROOT, TRANSL, UNCOVERED, RESIDUAL)
"""Joints leave the manifold from where it was reached. Exact markers of a known person determine a pose through its
joints. A code free beside the residual rotations is determined twice, and Gauss-Newton overshoots."""
Solve = Callable[..., KeySolution]
"""Minimises (model, layout, start, schedule) over the keys; ``alive`` is called before each linearisation."""


@dataclass(frozen=True)
class PosedKeys:
    """Keys of a person with their poses and landmarks, formed on demand."""

    subject: Subject
    prior: PosePrior
    layout: KeyframeLayout
    keys: Keyframes
    residuals: bool
    frames: np.ndarray | None  # Numbers of the evaluated frames; None for all.

    @cached_property
    def poses(self) -> PosedFrames:
        """Poses of the evaluated frames."""
        return key_poses(self.prior, self.keys, self.layout, self.frames, residuals=self.residuals)

    @cached_property
    def points(self) -> Array:
        """(F, L, 3) landmarks in these poses, metres."""
        return points_of(self.subject, self.poses)

    def of_subject(self, subject: Subject) -> PosedKeys:
        """Return the same poses of another person."""
        posed = replace(self, subject=subject)
        vars(posed)["poses"] = self.poses  # the cache that cached_property reads: poses do not depend on the person
        return posed


@dataclass(frozen=True)
class Bundle:
    """Keys of a take and their objective."""

    problem: Problem
    settings: SolveSettings
    posed: PosedKeys
    window: int
    schedule: Schedule  # Of the last pass, or of the next before the first.
    solve: Solve
    restart: Start  # Makes the keys of windows from single frames.
    data: DataTerm  # Data term with the learned variances.
    free: StateLayout  # Unknowns of the last pass.
    objective: BundleObjective  # Of the last pass.
    contacts: Contacts | None = None  # Standing feet, once they were detected.
    solution: KeySolution | None = None  # Of the last pass; None before the first.

    @classmethod
    def start(
        cls,
        problem: Problem,
        subject: Subject,
        settings: SolveSettings,
        layout: KeyframeLayout,
        window: int,
        keys: Keyframes,
        schedule: Schedule,
        solve: Solve,
        restart: Start,
        frames: np.ndarray | None = None,
    ) -> Bundle:
        """Return a bundle before its first pass, with keys on the manifold."""
        free, data = state_layout(problem.prior).only(ON_THE_MANIFOLD), problem.measurements.term
        posed = PosedKeys(subject, problem.prior, layout, keys, bool(free.turned), frames)
        objective = bundle_objective(problem, layout, window, (data,), settings, residuals=False)
        return cls(problem, settings, posed, window, schedule, solve, restart, data, free, objective)

    @property
    def model(self) -> BundleModel:
        """The objective of the keys."""
        return BundleModel(self.posed.subject, self.problem.prior, self.objective, self.free)

    def move(self, keys: Keyframes) -> Bundle:
        """Return the bundle with other keys."""
        return replace(self, posed=replace(self.posed, keys=keys))

    def with_objective(
        self, free: Collection[str], looseness: float = OFF_MANIFOLD, *, contacts: bool = True
    ) -> Bundle:
        """Return the bundle with the objective that follows from what was learned so far.

        Args:
            free: names of the unknown blocks.
            looseness: see ``bundle_objective``.
            contacts: hold standing feet.
        """
        held = self.contacts if contacts else None
        term = () if held is None else (held.term(self.posed.keys.z, self.settings.foot_lock),)
        points = (self.data, *term)
        objective = bundle_objective(
            self.problem,
            self.posed.layout,
            self.window,
            points,
            self.settings,
            residuals=RESIDUAL in free,
            looseness=looseness,
        )
        layout = state_layout(self.problem.prior).only(free)
        return replace(self, objective=objective, free=layout, posed=replace(self.posed, residuals=bool(layout.turned)))


Step = Callable[[Bundle], Bundle]  # Learns something from the current poses.


@dataclass(frozen=True)
class Pass:
    """One minimisation over the keys."""

    schedule: Schedule
    free: tuple[str, ...]  # Unknown blocks of the state.
    before: tuple[Step, ...] = ()  # Steps before the pass, in this order.
    looseness: float = OFF_MANIFOLD  # Factor on the prior's deviations by which joints may leave the manifold.

    def run(self, bundle: Bundle, alive: Callable[[], None]) -> Bundle:
        """Return the bundle with the keys of this pass; ``alive`` is called before each linearisation."""
        for step in self.before:
            bundle = step(bundle)
        bundle = bundle.with_objective(self.free, self.looseness)
        found = bundle.solve(bundle.model, bundle.posed.layout, bundle.posed.keys, self.schedule, alive=alive)
        return replace(bundle.move(found.keys), schedule=self.schedule, solution=found)


def run_passes(
    bundle: Bundle, passes: Sequence[Pass], progress: Progress, stage: str, after: Sequence[Step] = ()
) -> Bundle:
    """Return the bundle after all passes and the steps in ``after``; ``stage`` names them to ``progress``."""
    for number, one in enumerate(passes):
        bundle = one.run(bundle, partial(progress, stage, number, len(passes)))
    for step in after:
        bundle = step(bundle)
    progress(stage, len(passes), len(passes))
    return bundle


def start_take(
    problem: Problem,
    subject: Subject,
    settings: SolveSettings,
    schedule: Schedule,
    each: Stretches,
    progress: Progress,
    *,
    window: int | None = None,
    frames: np.ndarray | None = None,
) -> Bundle:
    """Return the bundle before its first pass, whose schedule is given.

    Args:
        window: frames of a window; None for the settings'.
        frames: numbers of the evaluated frames; None for all.
    """
    window = problem.frames_of(settings.refine_window) if window is None else window
    layout = KeyframeLayout.even(problem.num_frames, window)
    keys = initial_keys(problem, subject, layout, progress)
    solve, restart = partial(solve_in_single, each=each), keys_of_frames(problem, subject, layout, keys)
    return Bundle.start(problem, subject, settings, layout, window, keys, schedule, solve, restart, frames)


def space_keys(bundle: Bundle) -> Bundle:
    """Set keys closer where the take moves fast."""
    posed, problem = bundle.posed, bundle.problem
    dense = dense_layout(bundle.model, posed.layout, posed.keys, bundle.window, problem.fps)
    if dense is posed.layout:
        return bundle
    keys = keys_at(posed.keys, posed.layout, dense.key_times)
    closer = replace(
        bundle,
        posed=replace(posed, keys=keys, layout=dense),
        window=round(problem.num_frames / dense.num_windows),
        restart=keys_of_frames(problem, posed.subject, dense),
    )
    return closer.with_objective([block.name for block in bundle.free.blocks])


def resolve_lost_limbs(bundle: Bundle) -> Bundle:
    """Solve lost limbs again, before noise is learned: lost limbs must not count as noise."""
    posed = bundle.posed
    # A limb in another place has another code, so codes are free here in every pass.
    free = state_layout(bundle.problem.prior).only([CODE, *(block.name for block in bundle.free.blocks)])
    keys = resolve_limbs(
        bundle.problem.measurements,
        replace(bundle.model, free=free),
        posed.layout,
        posed.keys,
        posed.points,
        bundle.restart,
        bundle.schedule,
        posed.frames,
    )
    return bundle if keys is posed.keys else bundle.move(keys)


def resolve_outlier_markers(bundle: Bundle, schedule: Schedule) -> Bundle:
    """Solve keys again around distant markers, from wide robust scales on."""
    posed = bundle.posed
    frames = posed.layout.frames if posed.frames is None else posed.frames
    measured = bundle.problem.measurements
    keys = resolve_markers(measured, bundle.model, posed.layout, posed.keys, schedule, frames)
    return bundle.move(keys)


def refit_shape(bundle: Bundle, *, offsets: bool) -> Bundle:
    """Estimate the shape, and on request the landmarks' offsets, from a sample of the poses."""
    problem, posed = bundle.problem, bundle.posed
    sample = posed.poses.select(index(problem.sample, posed.keys.z))
    known = ShapePrior(free_betas=bundle.settings.betas is None, free_offsets=offsets)
    objective = bundle.objective.frames.select(problem.sample)
    subject = refit(posed.subject, sample, objective, bundle.settings.robust_scale, known)
    return replace(bundle, posed=posed.of_subject(subject))


def learn_noise(bundle: Bundle) -> Bundle:
    """Learn the reliability of the measurements by their source's rule."""
    return replace(bundle, data=bundle.problem.measurements.source.learn_noise(bundle))


def find_standing_feet(bundle: Bundle, sight: np.ndarray | None = None, heights: np.ndarray | None = None) -> Bundle:
    """Find standing feet, to hold them; for ``sight`` and ``heights`` of a single camera see ``find_contacts``."""
    if not bundle.settings.contacts:
        return bundle
    points, names = to_numpy(bundle.posed.points), bundle.posed.subject.landmarks.names
    return replace(bundle, contacts=find_contacts(points, names, bundle.problem.fps, sight=sight, heights=heights))


STAGE = "Global bundle"  # Name of the passes over a whole take.
SPREAD = "Estimating deviations"  # Name of the stage after them.


def solved_take(bundle: Bundle, progress: Progress, stride: int = 1) -> MethodResult:
    """Return the poses of all frames, and how the last pass ended; for ``stride`` see ``joint_covariance``."""
    assert bundle.solution is not None
    problem, settings, posed, model = bundle.problem, bundle.settings, bundle.posed, bundle.model
    layout, keys, names = posed.layout, hemisphere_aligned(posed.keys), posed.subject.landmarks.names
    # Solving on the spline itself, with the parabolas' sparser matrix, makes feet slip: contacts are too stiff for it.
    frames = model.poses(control_points(keys, layout), layout, spline=True)
    points, scale = points_of(posed.subject, frames), settings.robust_scale
    inflation = noise_inflation(points, problem.measurements.term, scale, max(1, bundle.window // 2))
    contacts = bundle.contacts
    if contacts is None and settings.contacts:
        contacts = find_contacts(to_numpy(points), names, problem.fps)
    give_back_freed_memory()
    # Held feet steady the solution, but its uncertainty follows from the measurements.
    measured = bundle.with_objective([block.name for block in bundle.free.blocks], contacts=False).model
    constant_m = problem.measurements.source.constant_m(problem.body.layout.recorded)
    covariance = covariance_of_joints(
        measured, layout, keys, frames, scale, inflation, constant_m, stride=stride, done=partial(progress, SPREAD)
    )
    feet = None if contacts is None else contacts.feet(names)
    return SolvedFrames(posed.subject, frames, layout.key_times, covariance, feet), bundle.solution.convergence


def passes_of(problem: Problem, settings: SolveSettings) -> tuple[Pass, ...]:
    """Return the passes: codes alone from wide scales, then joints off the manifold at two scales."""
    scale, steps = settings.robust_scale, settings.iterations
    near = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(3, 1), 1e-2, hessian_frames=3, promise=1.0)
    between = Schedule((2 * scale,), steps, problem.frames_of(2, 1), 1e-2, promise=1.0)
    last = Schedule((scale,), steps, tolerance=3e-3, promise=1.0)
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    # The bias waits for residual rotations; before, it would absorb what poses cannot follow, and stay.
    shape, shape_and_bias = partial(refit_shape, offsets=False), partial(refit_shape, offsets=True)
    return (
        Pass(near, ON_THE_MANIFOLD),
        Pass(between, free, (space_keys, resolve_lost_limbs, shape, learn_noise)),
        Pass(last, free, (resolve_lost_limbs, shape_and_bias, learn_noise, find_standing_feet)),
    )


def solve_views(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a take at once, with shape, bias, noise and standing feet learned between the passes."""
    passes = passes_of(problem, settings)
    bundle = start_take(problem, subject, settings, passes[0].schedule, each, progress)
    return solved_take(run_passes(bundle, passes, progress, STAGE, after=(resolve_lost_limbs,)), progress)


def one_view_passes(problem: Problem, settings: SolveSettings) -> tuple[Pass, ...]:
    """Return the passes: codes alone, then joints off the manifold with standing feet held.

    Shape, bias and noise are not learned: with one camera they would absorb every wrong depth.
    """
    scale, steps = settings.robust_scale, settings.iterations
    near = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(2, 1), 1e-2, hessian_frames=3, promise=1.0)
    last = Schedule((scale,), steps, tolerance=3e-3, promise=1.0)
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    source = cast("OneCamera", problem.measurements.source)  # no other source names this recipe
    feet: Step = partial(find_standing_feet, sight=source.sight, heights=source.heights)
    return (
        Pass(near, ON_THE_MANIFOLD),
        Pass(replace(last, scales=(2 * scale,)), free, (space_keys, feet)),
        Pass(last, free, (feet,)),
    )


def solve_one_view(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a take that one camera sees."""
    passes = one_view_passes(problem, settings)
    bundle = start_take(problem, subject, settings, passes[0].schedule, each, progress)
    return solved_take(run_passes(bundle, passes, progress, STAGE), progress)


CALM_M_S2, CLOSEST = 4.0, 0.4
"""Mean acceleration of markers up to which the settings' window holds, and the smallest share of it, which runners
reach: markers need narrower windows than keypoints. At 7 m/s knees differ from OpenSim's by 3.2 degrees RMS with 0.4
times the window, by 5.7 with all of it."""
NEAR_M = 0.01
"""Largest error ``a h² / 8`` of a body between two frames of a rough motion, for all but the fastest twentieth of the
markers, from which no first pass is needed."""
LOOSENESS = 2.0
"""Factor on the joints' looseness with fixed codes, as free codes take a part of every turn. Chosen by hand."""


@dataclass(frozen=True)
class KnownPersonPlan:
    """Passes and windows of a take."""

    window: int
    passes: tuple[Pass, ...]  # On the prior's manifold, unless the start is near enough, and off it.
    after: tuple[Step, ...]
    stride: int  # Passes use every n-th frame.
    covariance_stride: int  # Covariances of every n-th frame are formed.

    @classmethod
    def of(cls, problem: Problem, settings: SolveSettings) -> KnownPersonPlan:
        """Return the plan of a problem whose person is known."""
        from solver_backend.fitters.single_frame import RATE_HZ

        scale, steps, usual = settings.robust_scale, settings.iterations, problem.frames_of(settings.refine_window)
        measured, stride = problem.measurements, problem.frames_of(1, 1)
        rate = problem.fps / stride
        apart = max(1, round(0.5 * settings.refine_window * rate / REFERENCE_FPS))
        mean, fastest = paces(measured.points[::stride], rate, apart)
        window = closer_window(usual, mean, CALM_M_S2, CLOSEST)
        # Markers are exact: about five frames between two keys determine as much as all of them, three almost.
        near = Schedule((2 * scale,), min(3, steps), max(1, round(0.3 * window)), 3e-2, hessian_frames=3)
        last = Schedule((scale,), steps, max(1, round(0.2 * window)), 1e-2)
        starts_near = measured.rough is not None and fastest / (8 * RATE_HZ**2) < NEAR_M
        free = FIXED_CODES if settings.residual_rotations else ON_THE_MANIFOLD
        off = Pass(last, free, (resolve_lost_limbs, learn_noise), LOOSENESS)
        passes = (off,) if starts_near else (Pass(near, ON_THE_MANIFOLD), off)
        after: tuple[Step, ...] = (resolve_lost_limbs,)
        if settings.residual_rotations and measured.source.calibrated:
            after += (partial(resolve_outlier_markers, schedule=replace(last, scales=(4 * scale, scale))),)
        return cls(window, passes, after, stride, problem.frames_of(4, 1))


def solve_known_person(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a person whose shape and landmarks are known."""
    plan = KnownPersonPlan.of(problem, settings)
    frames = np.arange(0, problem.num_frames, plan.stride)
    schedule = plan.passes[0].schedule
    bundle = start_take(problem, subject, settings, schedule, each, silent, window=plan.window, frames=frames)
    bundle = run_passes(bundle, plan.passes, progress, STAGE, plan.after)
    return solved_take(bundle, progress, plan.covariance_stride)
