"""Solve whole takes at once, in passes that also learn body shape, noise and contacts."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, cast

import numpy as np

from solver_backend.body.state_layout import CODE, RESIDUAL, ROOT, TRANSL, UNCOVERED, StateLayout
from solver_backend.exchange.contact_parts import CONTACT_PARTS, FEET
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.initial_keys import (
    Start,
    closer_window,
    dense_layout,
    initial_keys,
    keys_of_frames,
    paces,
    resolve_lost_limbs,
    resolve_outlier_markers,
)
from solver_backend.fitters.keyframes.normal_equations import (
    OFF_MANIFOLD,
    BundleModel,
    BundleObjective,
    KeyTerm,
    MotionPrior,
    ResidualRotationTerm,
)
from solver_backend.fitters.keyframes.optimise import (
    KeySolution,
    Schedule,
    Stretches,
    covariance_of_joints,
    noise_inflation,
    solve_in_single,
)
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
from solver_backend.fitters.other_skin import OtherSkin
from solver_backend.fitters.person_shape import Contacts, ShapePrior, find_contacts, refit_shape
from solver_backend.fitters.problem import REFERENCE_FPS, MethodResult, Problem, SolvedFrames
from solver_backend.fitters.single_frame import RATE_HZ
from solver_backend.fitters.skin_contacts import SkinContacts, contradicts, find_skin_contacts, find_touching_people
from solver_backend.geometry.arrays import Array, index, to_numpy
from solver_backend.geometry.obstacles import Obstacles, read_obstacles
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.terms import DataTerm, PointTerm

if TYPE_CHECKING:
    from solver_backend.fitters.one_view.depth import OneCamera

FIXED_CODES = (ROOT, TRANSL, UNCOVERED, RESIDUAL)
"""Free blocks of a pass with fixed codes. Joints start on the manifold and may leave it. Precise markers on a known
person determine joints. If codes were free as well as residual rotations, Gauss-Newton would overshoot."""
Solve = Callable[..., KeySolution]  # Minimises (model, layout, start, schedule) over the keys, and calls ``alive``.


@dataclass(frozen=True)
class PosedKeys:
    """Keyframes of a person, with their poses and landmarks, which are computed on first use."""

    subject: Subject
    prior: PosePrior
    layout: KeyframeLayout
    keys: Keyframes
    residuals: bool
    frames: np.ndarray | None  # Frame numbers, or None for all frames of the layout.

    @cached_property
    def poses(self) -> PosedFrames:
        """Poses in the evaluated frames."""
        return key_poses(self.prior, self.keys, self.layout, self.frames, residuals=self.residuals)

    @cached_property
    def points(self) -> Array:
        """(F, L, 3) landmarks in these poses, in metres."""
        return points_of(self.subject, self.poses)

    def of_subject(self, subject: Subject) -> PosedKeys:
        """Return the same poses for another person. Only the landmarks change."""
        posed = replace(self, subject=subject)
        vars(posed)["poses"] = self.poses  # the cache that cached_property reads: poses do not depend on the person
        return posed


@dataclass(frozen=True)
class Bundle:
    """State of a whole-take solve between passes: the keyframes and everything learned so far."""

    problem: Problem
    settings: SolveSettings
    posed: PosedKeys
    window: int  # Frames per window.
    solve: Solve
    restart: Start  # Initialises the keys of windows from single frames.
    schedule: Schedule  # Schedule of the last pass, or of the first pass before it.
    data: DataTerm  # Data term with the learned variances.
    free: StateLayout  # Unknowns of the last pass.
    looseness: float = OFF_MANIFOLD  # Factor applied to the prior's error on rotations off the manifold.
    contacts: Contacts | None = None  # Planted feet that are held.
    skin: SkinContacts | None = None  # Skin to keep outside surfaces, if parts other than feet touch them.
    solution: KeySolution | None = None  # Solution of the last pass.
    notes: tuple[Diagnostic, ...] = ()  # Diagnostics about contacts.

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
        """Create the state before the first pass, with keyframes on the prior's manifold."""
        free = state_layout(problem.prior).only(ON_THE_MANIFOLD)
        posed = PosedKeys(subject, problem.prior, layout, keys, bool(free.turned), frames)
        return cls(problem, settings, posed, window, solve, restart, schedule, problem.measurements.term, free)

    @cached_property
    def objective(self) -> BundleObjective:
        """Objective with the learned noise, contacts and skin."""
        problem, spacing = self.problem, 0.5 * self.window
        points: tuple[PointTerm, ...] = (self.data,)
        if self.contacts is not None:
            points = (self.data, self.contacts.term(self.posed.keys.z, self.settings.foot_lock))
        frames = problem.objective_of(points)
        if self.skin is not None:
            frames = replace(frames, skin=self.skin.terms(self.posed.keys.z, self.settings.foot_lock))
        unseen = self.posed.layout.gaps(problem.measurements.seen)
        terms: list[KeyTerm] = [MotionPrior.bounded(spacing / problem.fps, self.settings.smoothing, unseen)]
        if RESIDUAL in self.free:
            sigma, uncovered = self.looseness * problem.prior.residual_sigma, problem.prior.uncovered
            terms.append(ResidualRotationTerm(sigma, 0.5 * spacing, uncovered=uncovered))
        return BundleObjective(frames, tuple(terms))

    @property
    def model(self) -> BundleModel:
        """Objective as a function of the keyframes."""
        return BundleModel(self.posed.subject, self.problem.prior, self.objective, self.free)

    @property
    def sample(self) -> PosedFrames:
        """Poses in the problem's sample frames."""
        return self.posed.poses.select(index(self.problem.sample, self.posed.keys.z))

    @property
    def everywhere(self) -> PosedKeys:
        """Keyframes with the poses in all frames, not only the evaluated ones."""
        return self.posed if self.posed.frames is None else replace(self.posed, frames=None)

    @property
    def data_cost(self) -> np.ndarray:
        """(F,) half the sum of the robust squared measurement errors in each frame."""
        return to_numpy(self.data(self.everywhere.points, self.settings.robust_scale).cost)

    def move(self, keys: Keyframes) -> Bundle:
        """Return the bundle with other keyframes."""
        return self if keys is self.posed.keys else replace(self, posed=replace(self.posed, keys=keys))

    def freed(self, free: Collection[str], looseness: float = OFF_MANIFOLD) -> Bundle:
        """Return the bundle with only the given state blocks as unknowns, such as codes or residual rotations."""
        layout = state_layout(self.problem.prior).only(free)
        posed = replace(self.posed, residuals=bool(layout.turned))
        return replace(self, free=layout, looseness=looseness, posed=posed)


Step = Callable[[Bundle], Bundle]  # Learns some quantity from the current poses.


@dataclass(frozen=True)
class Pass:
    """Steps that learn quantities such as noise, followed by one minimisation over the keyframes."""

    schedule: Schedule
    free: tuple[str, ...]  # Unknown blocks of the state.
    before: tuple[Step, ...] = ()  # Steps before the pass, in this order.
    looseness: float = OFF_MANIFOLD  # Factor applied to the prior's error on rotations off the manifold.

    def run(self, bundle: Bundle, alive: Callable[[], None]) -> Bundle:
        """Run the steps, then the minimisation. ``alive`` is called before each linearisation."""
        for step in self.before:
            bundle = step(bundle)
        bundle = bundle.freed(self.free, self.looseness)
        found = bundle.solve(bundle.model, bundle.posed.layout, bundle.posed.keys, self.schedule, alive=alive)
        return replace(bundle.move(found.keys), schedule=self.schedule, solution=found)


def space_keys(bundle: Bundle) -> Bundle:
    """Place keyframes closer together if the take moves fast."""
    posed, problem = bundle.posed, bundle.problem
    dense = dense_layout(bundle.model, posed.layout, posed.keys, bundle.window, problem.fps)
    if dense is posed.layout:
        return bundle
    closer = replace(posed, keys=keys_at(posed.keys, posed.layout, dense.key_times), layout=dense)
    window, restart = round(problem.num_frames / dense.num_windows), keys_of_frames(problem, posed.subject, dense)
    return replace(bundle, posed=closer, window=window, restart=restart)


def restart_lost_limbs(bundle: Bundle) -> Bundle:
    """Solve lost limbs again before noise is learned. Their errors must not count as noise."""
    posed, measured = bundle.posed, bundle.problem.measurements
    taken = measured, _with_codes(bundle), posed.layout, posed.keys, posed.points
    return bundle.move(resolve_lost_limbs(*taken, bundle.restart, bundle.schedule, posed.frames))


def _with_codes(bundle: Bundle) -> BundleModel:
    """Return the model with codes as unknowns. A limb can only reach another position with another code."""
    free = state_layout(bundle.problem.prior).only([CODE, *(block.name for block in bundle.free.blocks)])
    return replace(bundle.model, free=free)


def restart_outlier_markers(bundle: Bundle, schedule: Schedule) -> Bundle:
    """Solve keyframes near outlier markers again, starting with wide robust scales."""
    taken = bundle.problem.measurements, _with_codes(bundle), bundle.posed.layout, bundle.posed.keys
    return bundle.move(resolve_outlier_markers(*taken, schedule))


def learn_shape(bundle: Bundle, *, offsets: bool) -> Bundle:
    """Estimate the body shape, and optionally the landmark offsets, from a sample of the poses."""
    posed, scale = bundle.posed, bundle.settings.robust_scale
    known = ShapePrior(
        free_betas=bundle.settings.betas is None, free_offsets=offsets, stature_m=bundle.problem.stature_m
    )
    objective = bundle.objective.frames.select(bundle.problem.sample)
    return replace(bundle, posed=posed.of_subject(refit_shape(posed.subject, bundle.sample, objective, scale, known)))


def learn_noise(bundle: Bundle) -> Bundle:
    """Learn the measurement noise with the method of the point source."""
    return replace(bundle, data=bundle.problem.measurements.source.learn_noise(bundle))


def find_standing_feet(bundle: Bundle, sight: np.ndarray | None = None, heights: np.ndarray | None = None) -> Bundle:
    """Find planted feet, and keep them in place from now on (see ``find_contacts``)."""
    if not bundle.settings.contacts:
        return bundle
    points, names = to_numpy(bundle.posed.points), bundle.posed.subject.landmarks.names
    return replace(bundle, contacts=find_contacts(points, names, bundle.problem.fps, sight=sight, heights=heights))


def touching_parts(
    contacts: Contacts | None, skin: SkinContacts | None, names: tuple[str, ...]
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return masks of planted feet (F, 2) and of touching parts (F, 11).

    Without skin contacts, the second mask is None. If there are no foot contacts either, both masks are None.
    """
    feet = None if contacts is None else contacts.feet(names)
    if skin is None:
        return feet, None
    touches = skin.touches
    if feet is not None:
        touches[:, :FEET] |= feet
    return touches[:, :FEET], touches


PEOPLE = "other people"  # Name of these surfaces in diagnostics.
_PEOPLE_CONTRADICTED = diagnostic("surface_contradicted", surface=PEOPLE, severity=Severity.NOTE)
"""Diagnostic about contradicted contacts with other people. It is a note, because people who do not touch often
contradict contacts, and the user can change nothing."""
ROUNDS = 2  # Passes with skin contacts. Parts that had sunk touch the floor only after the first one.


def world_of(settings: SolveSettings) -> Obstacles:
    """Read the objects in the settings, and add the floor. Raise ``FileDamaged`` or ``FileMissing`` if this fails."""
    return read_obstacles(settings.objects) if settings.objects else Obstacles.floor()


def holds_skin(problem: Problem, settings: SolveSettings) -> bool:
    """Return whether skin contacts can be used: they are enabled, and a floor or objects are known.

    With one camera, depth is too uncertain for skin contacts.
    """
    source = problem.measurements.source
    return settings.contacts and source.recipe != "one camera" and (source.knows_floor or bool(settings.objects))


def hold_skin(bundle: Bundle) -> Bundle:
    """Solve again so that the skin does not penetrate the floor, objects or other people.

    Skin is fixed where it touches the floor or objects. If the measurements contradict the result, fewer surfaces are
    used: first no other people, then no objects, and finally no floor.
    """
    if not holds_skin(bundle.problem, bundle.settings):
        return bundle
    world, floor, others = world_of(bundle.settings), Obstacles.floor(), bundle.problem.others
    worlds = [(world, "objects"), (floor, "floor and objects")] if world.has_objects else [(floor, "floor")]
    tries = [(*tried, people) for tried in worlds for people in ((None,) if others is None else (others, None))]
    refused = tuple[Diagnostic, ...]()
    for surfaces, name, people in tries if others is None else (*tries, (floor.without_floor, PEOPLE, others)):
        held, works = _hold_outside(bundle, surfaces, people)
        if held.skin is None or not contradicts(works, 2.0 * (held.data_cost - bundle.data_cost)):
            if people is not others:
                refused = (*refused, _PEOPLE_CONTRADICTED)
            return replace(held, notes=(*refused, *held.notes))
        if people is None:
            refused = (diagnostic("surface_contradicted", surface=name),)
    if others is not None:
        refused = (*refused, _PEOPLE_CONTRADICTED)
    return replace(bundle, notes=refused)


def _hold_outside(bundle: Bundle, world: Obstacles, others: OtherSkin | None) -> tuple[Bundle, np.ndarray]:
    """Solve so that the skin does not penetrate surfaces. Return the bundle and an (F, 11) mask of affected parts."""
    standing, names = bundle.contacts, bundle.posed.subject.landmarks.names
    works = np.zeros((bundle.problem.num_frames, len(CONTACT_PARTS)), bool)
    last = Pass(bundle.schedule, tuple(block.name for block in bundle.free.blocks), looseness=bundle.looseness)
    before, fps, seen = bundle.everywhere, bundle.problem.fps, bundle.problem.measurements.seen
    met = None if others is None else find_touching_people(before.subject, before.poses, fps, others, seen)
    for _ in range(ROUNDS):
        posed = bundle.everywhere
        skin = find_skin_contacts(posed.subject, posed.poses, to_numpy(posed.points), bundle.problem.fps, world)
        if met is not None:
            skin = met if skin is None else skin.beside(met)
        if skin is None or not skin.binds:
            return bundle if skin is None or bundle.skin else replace(bundle, notes=tuple(skin.notes())), works
        works |= skin.works
        feet = standing and standing.without_feet(names, skin.touches[:, :FEET])
        noted = replace(bundle, skin=skin, contacts=feet, notes=tuple(skin.notes()))
        bundle = last.run(noted, lambda: None)
    return bundle, works


STAGE = "Global bundle"  # Name of the passes over a whole take.
SPREAD = "Estimating deviations"  # Name of the stage after them.


@dataclass(frozen=True)
class PassPlan:
    """Passes, window length and evaluated frames for solving a take."""

    window: int
    passes: tuple[Pass, ...]
    after: tuple[Step, ...] = ()  # Steps after the last pass.
    frames: np.ndarray | None = None  # Numbers of the frames that passes evaluate, None for all.
    covariance_stride: int = 1  # Covariances are formed in every n-th frame.


def plan_views(problem: Problem, settings: SolveSettings) -> PassPlan:
    """Plan the passes for several views: one on the prior's manifold, then two that also learn the shape."""
    scale, steps = settings.robust_scale, settings.iterations
    near = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(3, 1), 1e-2, hessian_frames=3, promise=1.0)
    between = Schedule((2 * scale,), steps, problem.frames_of(2, 1), 1e-2, promise=1.0)
    last = Schedule((scale,), steps, tolerance=3e-3, promise=1.0)
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    # Learn the bias only with residual rotations. Earlier, it would absorb pose errors permanently.
    shape, shape_and_bias = partial(learn_shape, offsets=False), partial(learn_shape, offsets=True)
    passes = (
        Pass(near, ON_THE_MANIFOLD),
        Pass(between, free, (space_keys, restart_lost_limbs, shape, learn_noise)),
        Pass(last, free, (restart_lost_limbs, shape_and_bias, learn_noise, find_standing_feet)),
    )
    return PassPlan(problem.frames_of(settings.refine_window), passes, (restart_lost_limbs, hold_skin))


def plan_one_view(problem: Problem, settings: SolveSettings) -> PassPlan:
    """Plan the passes for one camera: one on the prior's manifold, then two off it with fixed planted feet.

    Shape, bias and noise are not learned, because with one camera they would absorb every depth error.
    """
    scale, steps = settings.robust_scale, settings.iterations
    near = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(2, 1), 1e-2, hessian_frames=3, promise=1.0)
    last = Schedule((scale,), steps, tolerance=3e-3, promise=1.0)
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    source = cast("OneCamera", problem.measurements.source)  # no other source names this plan
    feet: Step = partial(find_standing_feet, sight=source.sight, heights=source.heights)
    between = Pass(replace(last, scales=(2 * scale,)), free, (space_keys, feet))
    passes = Pass(near, ON_THE_MANIFOLD), between, Pass(last, free, (feet,))
    return PassPlan(problem.frames_of(settings.refine_window), passes)


CALM_M_S2, CLOSEST = 4.0, 0.4
"""Largest mean acceleration of markers at which the settings' window is kept, and smallest relative window, which
runners get. Markers need shorter windows than keypoints. At 7 m/s, knees differ from OpenSim's by 3.2 degrees RMS with
0.4 times the window, and by 5.7 degrees with the full window."""
NEAR_M = 0.01  # If 95 % of marker errors ``a h² / 8`` between rough frames are below this, a first pass is unnecessary.
LOOSENESS = 2.0  # Additional looseness with fixed codes, because free codes take a part of every rotation. By hand.


def plan_known_person(problem: Problem, settings: SolveSettings) -> PassPlan:
    """Plan the passes for markers on a known person: one on the prior's manifold if needed, and one off it."""
    scale, steps, usual = settings.robust_scale, settings.iterations, problem.frames_of(settings.refine_window)
    measured, stride = problem.measurements, problem.frames_of(1, 1)
    rate = problem.fps / stride
    apart = max(1, round(0.5 * settings.refine_window * rate / REFERENCE_FPS))
    mean, fastest = paces(measured.points[::stride], rate, apart)
    window = closer_window(usual, mean, CALM_M_S2, CLOSEST)
    # Markers are precise. Five frames between two keys are as informative as all of them, and three almost as much.
    near = Schedule((2 * scale,), min(3, steps), max(1, round(0.3 * window)), 3e-2, hessian_frames=3)
    last = Schedule((scale,), steps, max(1, round(0.2 * window)), 1e-2)
    starts_near = measured.rough is not None and fastest / (8 * RATE_HZ**2) < NEAR_M
    free = FIXED_CODES if settings.residual_rotations else ON_THE_MANIFOLD
    off = Pass(last, free, (restart_lost_limbs, learn_noise), LOOSENESS)
    passes = (off,) if starts_near else (Pass(near, ON_THE_MANIFOLD), off)
    after: tuple[Step, ...] = (restart_lost_limbs,)
    if settings.residual_rotations and measured.source.calibrated:
        after += (partial(restart_outlier_markers, schedule=replace(last, scales=(16 * scale, 4 * scale, scale))),)
    return PassPlan(
        window, passes, (*after, hold_skin), np.arange(0, problem.num_frames, stride), problem.frames_of(4, 1)
    )


PLANS = {"views": plan_views, "one camera": plan_one_view, "known person": plan_known_person}  # By the source's recipe.


def solve_take(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keyframes of a take with the plan for its point source."""
    plan = PLANS[problem.measurements.source.recipe](problem, settings)
    layout, count = KeyframeLayout.even(problem.num_frames, plan.window), len(plan.passes)
    keys = initial_keys(problem, subject, layout, progress)
    solve, restart = partial(solve_in_single, each=each), keys_of_frames(problem, subject, layout, keys)
    schedule = plan.passes[0].schedule
    bundle = Bundle.start(problem, subject, settings, layout, plan.window, keys, schedule, solve, restart, plan.frames)
    for number, one in enumerate(plan.passes):
        bundle = one.run(bundle, partial(progress, STAGE, number, count))
    for step in plan.after:
        bundle = step(bundle)
    progress(STAGE, count, count)
    return solved_take(bundle, progress, plan.covariance_stride)


def solved_take(bundle: Bundle, progress: Progress, stride: int = 1) -> MethodResult:
    """Return the poses in all frames, with covariances and contacts, and the convergence of the last pass."""
    assert bundle.solution is not None
    problem, settings, posed, model = bundle.problem, bundle.settings, bundle.posed, bundle.model
    layout, keys, names = posed.layout, hemisphere_aligned(posed.keys), posed.subject.landmarks.names
    # A solve on the spline with the parabolas' sparser matrix would make feet slide, because contacts are too stiff.
    frames = model.poses(control_points(keys, layout), layout, spline=True)
    points, scale = points_of(posed.subject, frames), settings.robust_scale
    inflation = noise_inflation(points, problem.measurements.term, scale, max(1, bundle.window // 2))
    contacts = bundle.contacts
    if contacts is None and settings.contacts:
        contacts = find_contacts(to_numpy(points), names, problem.fps)
    give_back_freed_memory()
    # Held feet stabilise the solution, but its uncertainty depends on the measurements.
    measured = replace(bundle, contacts=None, skin=None, looseness=OFF_MANIFOLD).model
    constant_m = problem.measurements.source.constant_m(problem.body.layout.recorded)
    covariance = covariance_of_joints(
        measured, layout, keys, frames, scale, inflation, constant_m, stride=stride, done=partial(progress, SPREAD)
    )
    feet, touches = touching_parts(contacts, bundle.skin, names)
    joints = len(problem.body.recorded_joints)
    spread = {"covariance": covariance[:, :joints], "turns": covariance[:, joints:]}
    solved = SolvedFrames(posed.subject, frames, layout.key_times, contacts=feet, touches=touches, **spread)
    return solved.noting(bundle.notes), bundle.solution.convergence
