"""Solve a capture: the entry point for the command line, job files and the add-on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.files.choices import load_chosen_body, resolve_body
from solver_backend.body.label_places import places_given
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import BackendMissing, JobInvalid, NoDetections, TakeTooShort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import SCREW, SolveSettings
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.build_motion import build_motion
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.keyframes.initial_keys import initial_keys
from solver_backend.fitters.keyframes.normal_equations import BundleModel, BundleObjective
from solver_backend.fitters.keyframes.optimise import Schedule, Stretches, in_turn, solve_sliding
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import ON_THE_MANIFOLD, Subject, state_layout
from solver_backend.fitters.other_skin import OtherSkin
from solver_backend.fitters.person_shape import LIMBS_SIGMA, STATURE_SIGMAS, learn_subject
from solver_backend.fitters.problem import (
    Convergence,
    Layer,
    Measurements,
    MethodResult,
    Problem,
    Solution,
    SolvedFrames,
    SolvedLayer,
    noted,
)
from solver_backend.fitters.recipes.bundle import solve_take
from solver_backend.fitters.single_frame import bridged_states, fit_frames, fit_to_points, posed
from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.obstacles import read_obstacles
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.choose import load_gaussian, load_prior
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.terms import graduated_scales
from solver_backend.solver.levenberg_marquardt import LMSettings
from solver_backend.types import Capture, MarkerCloud, MarkerSubject, Motion
from solver_backend.types.network_result import StartingResult

STATURE_ERROR_M = 0.001  # A smaller difference from a given stature counts as none.


def solve_single_frames(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Fit every observed frame independently, and interpolate the unobserved frames."""
    seen = np.flatnonzero(problem.measurements.seen)
    states = fit_to_points(problem, subject, seen)
    scales = graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3)
    objective, steps = problem.objective.select(seen), LMSettings(settings.iterations)
    found = fit_frames(subject, problem.prior, objective, states, scales, steps, progress)
    frames = posed(problem.prior, bridged_states(found.state, seen, problem.num_frames))
    return SolvedFrames(subject, frames), Convergence.of(found)


def solve_sliding_windows(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve one window after another by Gauss-Newton steps, with the mixture prior for poses."""
    layout = KeyframeLayout.even(problem.num_frames, settings.window, free=settings.interpolation)
    keys = initial_keys(problem, subject, layout)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    free = state_layout(problem.prior).only(ON_THE_MANIFOLD)
    model = BundleModel(subject, problem.prior, BundleObjective(problem.objective), free, settings.root_curve == SCREW)
    found = solve_sliding(model, layout, keys, Schedule(scales, settings.iterations), progress)
    frames = model.poses(found.keys, layout)
    return SolvedFrames(subject, frames, layout.key_times), found.convergence


Recipe = Callable[[Problem, Subject, SolveSettings, Progress, Stretches], MethodResult]
"""Function of a method that solves the poses in a take. Its last argument solves the frame ranges of a long take."""


@dataclass(frozen=True)
class Method:
    """Solver method that the settings select by name, with its properties."""

    name: str
    recipe: Recipe
    finds_shape: bool = False  # The recipe estimates the shape. Otherwise, the shape is learned first.
    per_frame: bool = False  # Every frame is solved independently, so that a single frame is enough.
    solves_one_view: bool = False
    starts_at: bool = False  # Can follow a start motion in frames without measurements.
    has_curves: bool = False  # The curves between keyframes can be chosen. Other methods smooth across windows.
    fits_network: bool = False  # Fits the labelling network's landmarks in a marker recording without labels.
    has_gaussian_codes: bool = False  # Decodes Gaussian codes. Other methods decode codes on a sphere.

    def prior_of(self, problem: Problem, settings: SolveSettings) -> AutoencodingPrior:
        """Return the prior that decodes the method's poses."""
        return load_gaussian(settings.prior) if self.has_gaussian_codes else problem.prior


def _solve_noise_aware(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    from solver_backend.fitters.recipes.noise_aware import solve_noise_aware

    return solve_noise_aware(problem, subject, settings, progress, each)


def _solve_bundlemocap(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    from solver_backend.fitters.recipes.bundlemocap import solve_bundlemocap

    return solve_bundlemocap(problem, subject, settings, progress, each)


METHODS = {
    method.name: method
    for method in (
        Method("global", solve_take, solves_one_view=True, starts_at=True),
        Method("bundlemocap++", _solve_bundlemocap, finds_shape=True),
        Method("sliding", solve_sliding_windows, has_curves=True),
        Method("frame", solve_single_frames, per_frame=True),
        Method(
            "noise-aware",
            _solve_noise_aware,
            finds_shape=True,
            per_frame=True,
            fits_network=True,
            has_gaussian_codes=True,
        ),
    )
}  # By name.


def require(settings: SolveSettings, trait: str, where: str, lacks: str, otherwise: str) -> None:
    """Raise ``JobInvalid`` unless the chosen method has a property. ``where`` names the take.

    Args:
        trait: name of a field in ``Method``.
        lacks: text after the method's name in the message, such as "needs two cameras".
        otherwise: alternative to choosing another method, such as "add a camera".
    """
    if not getattr(METHODS[settings.method], trait):
        hint = f"Choose the method {_able(trait)}, or {otherwise}."
        raise JobInvalid(f"The method '{settings.method}' {lacks}.", where=where, hint=hint)


def require_network(settings: SolveSettings, where: str) -> None:
    """Raise ``JobInvalid`` unless the chosen method fits the labelling network's landmarks."""
    if not METHODS[settings.method].fits_network or settings.layout:
        able = _able("fits_network")
        message = f"The landmarks '{settings.landmarks}' need the method {able} without a marker layout."
        hint = f"Use --method {able.split()[0][1:-1]}, or omit --landmarks."
        raise JobInvalid(message, where=where, hint=hint)


def require_start(settings: SolveSettings, capture: Capture) -> None:
    """Raise ``JobInvalid`` unless the chosen method and the capture allow a start motion."""
    if capture.several_views is None:
        hint = "Omit --start-from, or use a capture with a second camera."
        raise JobInvalid("--start-from needs a multi-camera take.", where=capture.name, hint=hint)
    require(settings, "starts_at", capture.name, "cannot start from a motion", "omit --start-from")


def diagnose_settings(settings: SolveSettings, measured: Measurements) -> Iterator[Diagnostic]:
    """Yield warnings about settings that have no effect with this method or with a single camera."""
    read = {name for layer in measured.layers for name in layer.SETTINGS}
    idle = [name for name in settings.without_effect if name not in read]
    if idle:
        yield diagnostic("setting_without_effect", user="method", method=settings.method, settings=", ".join(idle))
    if settings.objects and "objects" not in idle and measured.source.recipe == "one camera":
        yield diagnostic("setting_without_effect", user="take", method=settings.method, settings="objects")


def _able(trait: str) -> str:
    return " or ".join(f"'{method.name}'" for method in METHODS.values() if getattr(method, trait))


def prepare(
    capture: Capture,
    settings: SolveSettings,
    progress: Progress,
    prior: AutoencodingPrior | None = None,
    person: MarkerSubject | None = None,
    start: Motion | None = None,
    results: Sequence[StartingResult] = (),
) -> Problem:
    """Prepare the problem of solving a capture from its keypoints, or from its markers if it has no keypoints."""
    markers = capture.markers if capture.keypoints is None else None
    if markers is None:
        capture.require_views()
    elif results:
        hint = "Omit --start-from."
        raise JobInvalid("A network result needs a take with keypoint detections.", where=capture.name, hint=hint)
    if settings.other_curves:
        names = " and ".join(settings.other_curves)
        require(settings, "has_curves", capture.name, f"has no setting {names}", f"leave {names} out")
    if not METHODS[settings.method].per_frame and capture.num_frames < 4:
        message, hint = (
            f"The method '{settings.method}' needs 4 frames, but the take has {capture.num_frames}.",
            "Use --method frame for single images.",
        )
        raise TakeTooShort(message, where=capture.name, hint=hint)
    if start is not None:
        require_start(settings, capture)
    body, like = load_chosen_body(settings.body), make_origin(settings.backend)
    has_gaussian_codes = METHODS[settings.method].has_gaussian_codes
    if has_gaussian_codes:
        load_gaussian(settings.prior)  # An unsuitable prior is an error before anything is measured.
    if prior is None:
        prior = load_sposer() if has_gaussian_codes else load_prior(settings.prior)
    if settings.objects:
        read_obstacles(settings.objects)  # An unsuitable file is an error before anything is measured.
    if settings.noise:
        from solver_backend.fitters.measurements.views import with_meant_confidence

        capture = with_meant_confidence(capture, settings.noise)
    if settings.is_direct:
        from solver_backend.fitters.measurements.markers import measure_directly

        require_network(settings, capture.name)
        return Problem.of(body, prior, measure_directly(capture, body, like, settings, person, progress))
    if markers is not None:
        return _prepare_markers(markers, capture.others, body, prior, like, settings, progress, person)
    seen, fitting = capture.without_views(settings.leave_out), prior_on_body(prior, body.layout)
    if seen.several_views is None:
        from solver_backend.fitters.one_view.measure import measure_one_view

        require(settings, "solves_one_view", capture.name, "needs two cameras", "add a camera")
        measured = measure_one_view(seen, body, fitting, like, settings.betas, progress)
    else:
        from solver_backend.fitters.measurements.views import begin_at, measure_views

        measured = measure_views(seen, body, like, progress, estimate_sync=settings.estimate_sync, sync=settings.sync)
        if start is not None:
            from solver_backend.fitters.hands.solve_hands import without_fingers

            measured = begin_at(measured, without_fingers(start), body, fitting, like)
    if results:
        from solver_backend.fitters.network_poses import with_network_results

        measured = with_network_results(measured, seen, body, fitting, results, like)
    return replace(Problem.of(body, prior, measured), stature_m=capture.stature_m)


def _prepare_markers(
    cloud: MarkerCloud,
    others: MarkerCloud | None,
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
    settings: SolveSettings,
    progress: Progress,
    person: MarkerSubject | None,
) -> Problem:
    from solver_backend.fitters.hands.shown_hands import split_hands
    from solver_backend.fitters.hands.solve_hands import Hands
    from solver_backend.fitters.marker_calibration.marker_problem import marker_problem
    from solver_backend.fitters.measurements.markers import known_markers_of, measure_markers
    from solver_backend.fitters.measurements.views import LocatedPoints
    from solver_backend.fitters.props import Props

    markers, hands = split_hands(cloud, places_given(settings.layout))
    if METHODS[settings.method].fits_network and person is None:
        problem = Problem.of(body, prior, measure_markers(known_markers_of(markers), body, like))
    else:
        problem = marker_problem(markers, body, prior, like, settings, progress, person)
    source = problem.measurements.source
    assert isinstance(source, LocatedPoints)
    free = [column for column, label in enumerate(markers.names) if label not in source.labels]
    source = replace(source, others=markers.positions[:, free])
    layers: list[Layer] = [] if hands is None else [Hands(hands)]
    layers.append(Props.of(markers, source.labels, settings.layout, others))
    return replace(problem, measurements=replace(problem.measurements, source=source, layers=tuple(layers)))


def first_subject(problem: Problem, settings: SolveSettings) -> Subject:
    """Return the known person or the average person, with the shape in the settings if given."""
    if known := problem.measurements.known_person:
        return known
    subject = Subject.average(problem.body, problem.measurements.landmarks, make_origin(settings.backend))
    return subject if settings.betas is None else replace(subject, betas=constant(settings.betas, subject.betas))


def make_origin(backend: str) -> Array:
    """Return a one-element template array of a backend. Raise ``BackendMissing`` if torch or CUDA is missing."""
    if backend == "numpy":
        return np.zeros(1)
    try:
        import torch
    except ImportError as error:
        message = f"The backend {backend!r} needs torch, which is not installed."
        raise BackendMissing(message, hint="Install torch in this Python, or use the backend 'numpy'.") from error
    if backend == "cuda" and not torch.cuda.is_available():
        hint = "Use the backend 'torch' or 'numpy', or install a driver and a torch build for CUDA."
        raise BackendMissing("The backend 'cuda' needs a CUDA device, but torch does not find one.", hint=hint)
    return torch.zeros(1, dtype=torch.float64, device="cuda" if backend == "cuda" else None)


def solve(
    capture: Capture,
    settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
    *,
    prior: AutoencodingPrior | None = None,
    person: MarkerSubject | None = None,
    start: Motion | None = None,
    results: Sequence[StartingResult] = (),
    others: Sequence[Motion] = (),
    each: Stretches = in_turn,
) -> Solution:
    """Solve the motion of the person in a capture from its keypoints or markers.

    Args:
        prior: decodes poses from codes, zero-mean unit vectors of any dimension. None loads ``settings.prior``.
        person: person from an earlier marker calibration. None calibrates on the take.
        start: motion to start from, for several cameras.
        results: network results for some cameras, which are combined with the detections.
        others: motions of other people in the same take. Where bodies overlap, the person moves by half of the overlap.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
        FileMissing, FileDamaged, JobInvalid: the noise map cannot be read, or is not for this capture.
        FileMissing, WeightsInvalid, JobInvalid: the prior cannot be read, or its codes do not suit the method.
        MarkersUnknown: too few markers have labels in a known layout.
        MarkersMirrored: left and right labels are swapped, or an axis is reversed.
        SubjectInvalid: the person was calibrated on another body, or wears other markers.
        TakeTooShort: the bundle needs at least 4 frames.
        PriorInvalid: the prior is inconsistent or does not fit the body.
        BackendMissing: torch is requested but not installed, or does not find a CUDA device.
        BodyUnknown, BodyInvalid, UnsafePickle: the body does not exist, or its file is invalid.
        MotionInvalid: the start motion has another number of frames, or is for another body.
    """
    problem = prepare(capture, settings, progress, prior, person, start, results)
    if others:
        problem = replace(problem, others=OtherSkin.of(problem.body, others))
    give_back_freed_memory()
    found = solve_problem(problem, settings, progress, _sources(capture, settings), each)
    if capture.keypoints is None or capture.without_views(settings.leave_out).several_views is None:
        return found
    stature, has_shape = problem.body.stature_of(found.motion.betas), settings.betas is not None
    return _with_stature(found, stature, capture.stature_m, has_shape=has_shape)


def _with_stature(found: Solution, stature: float, known: float, *, has_shape: bool) -> Solution:
    """Record the stature, and its difference from the user's value ``known`` (0 if unknown).

    Args:
        has_shape: the user specifies the body's shape, which determines the stature.
    """
    off = abs(known - stature)
    is_given = off < STATURE_ERROR_M if known else has_shape
    reason = "given" if is_given else "contradicted" if known else "measured"
    severity = Severity.WARNING if known and off > STATURE_SIGMAS * LIMBS_SIGMA * known else Severity.NOTE
    figures: dict[str, Any] = {"reason": reason, "size": stature, "stature": known, "percent": 100 * LIMBS_SIGMA}
    recorded = diagnostic("stature_solved", severity=severity, **figures)
    provenance = found.motion.provenance
    listed = [*provenance.get("diagnostics", ()), recorded.as_dict()]
    return replace(found, motion=replace(found.motion, provenance={**provenance, "diagnostics": listed}))


def solve_problem(
    problem: Problem,
    settings: SolveSettings,
    progress: Progress = silent,
    provenance: Mapping[str, Any] | None = None,
    each: Stretches = in_turn,
) -> Solution:
    """Solve a person's motion. ``provenance`` is added to the motion's provenance."""
    method = METHODS[settings.method]
    problem, full, solved, convergence = _solve_body(problem, settings, progress, each)
    solved, _ = full.measurements.source.after(full, solved, settings, progress)
    finished: list[SolvedLayer] = []
    for layer in full.measurements.layers:
        solved, done = layer.after(full, solved, settings, progress)
        finished.append(done)
    prior, found = method.prior_of(problem, settings), [*diagnose_settings(settings, problem.measurements)]
    record = {
        "solver": VERSION,
        "settings": asdict(settings),
        "body": problem.body.id,
        "prior": {"name": prior.name, "weights": prior.metadata.get("sha256")},
        **(provenance or {}),
        **problem.measurements.provenance,
        "status": convergence.status,
    }
    record = noted(record, found) if found else record
    motion = build_motion(problem.measurements, solved, finished, scale=settings.robust_scale, provenance=record)
    give_back_freed_memory()
    return Solution(motion, convergence.status)


def _solve_body(
    problem: Problem, settings: SolveSettings, progress: Progress, each: Stretches
) -> tuple[Problem, Problem, SolvedFrames, Convergence]:
    """Solve a person's body, and solve it again if a layer changes the problem.

    Return the problem with its final point source, the same problem with all landmarks, the poses and convergence.
    """
    method = METHODS[settings.method]

    def solve_once(problem: Problem) -> MethodResult:
        subject = first_subject(problem, settings)
        if not method.finds_shape:
            subject = learn_subject(problem, subject, settings, progress)
        give_back_freed_memory()
        found = method.recipe(problem, subject, settings, progress, each)
        give_back_freed_memory()
        return found

    first, (solved, convergence) = problem.measurements, solve_once(problem)
    full = problem = first.source.blocks(problem, solved, settings)
    for layer in problem.measurements.layers:
        full = layer.blocks(full, solved, settings)
    if full.measurements.landmarks is not first.landmarks or full.measurements.source is not first.source:
        solved, convergence = solve_once(full)
    return problem, full, solved, convergence


def calibrate_person(
    captures: Sequence[Capture], settings: SolveSettings = SolveSettings(), progress: Progress = silent
) -> MarkerSubject:
    """Calibrate a person who wears the same markers in one or more captures.

    Raises:
        NoDetections: a capture has no markers.
        MarkersUnknown: too few markers have labels in a known layout.
        BackendMissing, BodyUnknown, BodyInvalid: as in ``solve``.
    """
    for capture in captures:
        if capture.markers is None:
            raise NoDetections(
                "The capture has no markers to calibrate.",
                where=capture.name,
                hint="Choose a marker recording.",
            )
    from solver_backend.fitters.hands.shown_hands import split_hands
    from solver_backend.fitters.marker_calibration.label_faults import named_alike
    from solver_backend.fitters.marker_calibration.marker_problem import calibrated

    own = places_given(settings.layout)
    body, like = load_chosen_body(settings.body), make_origin(settings.backend)
    sources = [source for capture in captures for source in capture.sources]
    alike, found = named_alike([split_hands(c.markers, own)[0] for c in captures if c.markers is not None], own)
    return calibrated(alike, body, load_sposer(), like, settings, progress, {"sources": sources, **found})


def resolve_range(
    capture: Capture,
    motion: Motion,
    frame_range: FrameRange,
    settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
) -> Solution:
    """Solve some frames of an earlier motion again, through pinned poses (``solve_range``).

    Raises:
        JobInvalid, MotionInvalid: the frame range is outside the take, or the motion belongs to another take or body.
        TooFewViews, NoDetections, BackendMissing: as in ``solve``.
    """
    from solver_backend.fitters.hands.solve_hands import without_fingers
    from solver_backend.fitters.marker_calibration.calibrate import person_of
    from solver_backend.fitters.recipes.frame_range import solve_again

    frame_range.check(capture.num_frames or frame_range.last + 1)  # before anything is measured
    problem = prepare(capture, settings, progress, person=person_of(without_fingers(motion)))
    return solve_again(problem, first_subject(problem, settings), motion, frame_range, settings, progress)


def resolve_motion(
    measured: Motion,
    motion: Motion,
    frame_range: FrameRange,
    settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
) -> Solution:
    """Solve some frames of a motion again through pinned poses, without a recording.

    The motion's body points are the measurements. Near a pin they are not used, and the prior determines the pose.

    Raises:
        JobInvalid: the frame range does not match the motion.
        MotionInvalid: the motion is for another body, or the two motions have different lengths.
        NoDetections: there are too few frames between the pins.
    """
    from solver_backend.fitters.hands.solve_hands import without_fingers
    from solver_backend.fitters.measurements.markers import measure_motion
    from solver_backend.fitters.recipes.frame_range import solve_again

    body, like = load_chosen_body(settings.body), make_origin(settings.backend)
    frame_range.check(measured.num_frames)
    points = measure_motion(body, without_fingers(measured), [pin.frame for pin in frame_range.pins], like)
    problem = Problem.of(body, load_sposer(), points)
    return solve_again(problem, first_subject(problem, settings), motion, frame_range, settings, progress)


def _sources(capture: Capture, settings: SolveSettings) -> dict[str, Any]:
    path = resolve_body(settings.body)
    fingerprint = {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    named = {"person": capture.person} if capture.person else {}
    return {"body_file": fingerprint, "capture": capture.name, **named, "sources": list(capture.sources)}
