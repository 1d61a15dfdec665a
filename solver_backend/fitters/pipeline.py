"""From a capture to a motion: the one entry that the command line, the job file and the add-on use."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from solver_backend.agreement.repeated_frames import without_views
from solver_backend.body.body import Body
from solver_backend.body.files.choices import load_chosen_body, resolve_body
from solver_backend.body.label_places import places_given
from solver_backend.exchange.errors import BackendMissing, NoDetections, TakeTooShort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.build_motion import build_motion
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.keyframes.optimise import Stretches, in_turn
from solver_backend.fitters.methods import (
    METHODS,
    diagnose_settings,
    require_curves,
    require_network,
    require_one_view,
    require_start,
)
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import (
    Convergence,
    Layer,
    Measurements,
    MethodResult,
    Problem,
    Solution,
    SolvedFrames,
    SolvedLayer,
)
from solver_backend.fitters.subject_calibration.shape import learn_subject
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture, MarkerCloud, MarkerSubject, Motion


def prepare(
    capture: Capture,
    settings: SolveSettings,
    progress: Progress,
    prior: AutoencodingPrior | None = None,
    person: MarkerSubject | None = None,
    start: Motion | None = None,
) -> Problem:
    """Prepare a capture for a solver: its views, or its markers if it has no keypoints; errors are as in ``solve``."""
    markers = capture.markers if capture.keypoints is None else None
    if markers is None:
        capture.require_views()
    require_curves(settings, capture.name)
    if not METHODS[settings.method].per_frame and capture.num_frames < 4:
        raise TakeTooShort(
            f"The bundle needs 4 frames, the take has {capture.num_frames}.",
            where=capture.name,
            hint="Use the method 'frame' for single images.",
        )
    if start is not None:
        require_start(settings, capture)
    body, like = load_chosen_body(settings.body), make_origin(settings.backend)
    prior = load_sposer() if prior is None else prior
    if settings.noise:
        from solver_backend.fitters.measurements.views import with_meant_confidence

        capture = with_meant_confidence(capture, settings.noise)
    if settings.is_direct:
        from solver_backend.fitters.measurements.markers import measure_directly

        require_network(settings, capture.name)
        return Problem.of(body, prior, measure_directly(capture, body, like, settings, person, progress))
    if markers is not None:
        return _prepare_markers(markers, capture.others, body, prior, like, settings, progress, person)
    return Problem.of(body, prior, _measure_views(capture, body, prior, like, settings, progress, start))


def _measure_views(
    capture: Capture,
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
    settings: SolveSettings,
    progress: Progress,
    start: Motion | None,
) -> Measurements:
    from solver_backend.fitters.measurements.views import begin_at, measure_views

    seen = without_views(capture, settings.leave_out)
    fitting = prior_on_body(prior, body.layout)
    if seen.is_one_view:
        from solver_backend.fitters.one_view.measure import measure_one_view

        require_one_view(settings, capture.name)
        return measure_one_view(seen, body, fitting, like, settings.betas, progress)
    views = measure_views(seen, body, like, progress, estimate_sync=settings.estimate_sync, sync=settings.sync)
    if start is None:
        return views
    from solver_backend.fitters.hands.wide_motion import without_fingers

    return begin_at(views, without_fingers(start), body, fitting, like)


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
    from solver_backend.fitters.props.solve_props import Props

    markers, hands = split_hands(cloud, places_given(settings.layout))
    if METHODS[settings.method].finds_shape and person is None:
        problem = Problem.of(body, prior, measure_markers(known_markers_of(markers), body, like))
    else:
        problem = marker_problem(markers, body, prior, like, settings, progress, person)
    source = problem.measurements.source
    assert isinstance(source, LocatedPoints)
    layers: list[Layer] = [] if hands is None else [Hands(hands)]
    layers.append(Props.of(markers, source.labels, settings.layout, others))
    return replace(problem, measurements=replace(problem.measurements, layers=tuple(layers)))


def first_subject(problem: Problem, settings: SolveSettings) -> Subject:
    """Return the known person, else the average one without bias, with the settings' shape if given."""
    if known := problem.measurements.known_person:
        return known
    subject = Subject.average(problem.body, problem.measurements.landmarks, make_origin(settings.backend))
    return subject if settings.betas is None else replace(subject, betas=constant(settings.betas, subject.betas))


def make_origin(backend: str) -> Array:
    """Return an array of the backend's kind, for new arrays to follow."""
    if backend == "numpy":
        return np.zeros(1)
    try:
        import torch
    except ImportError as error:
        raise BackendMissing(
            f"The backend {backend!r} was asked for, and torch is not installed.",
            hint="Install torch in this Python, or use the backend 'numpy'.",
        ) from error
    if backend == "cuda" and not torch.cuda.is_available():
        raise BackendMissing(
            "The backend 'cuda' was asked for, and torch finds no CUDA device.",
            hint="Use the backend 'torch' or 'numpy', or install a driver and a torch build for CUDA.",
        )
    return torch.zeros(1, dtype=torch.float64, device="cuda" if backend == "cuda" else None)


def solve(
    capture: Capture,
    settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
    *,
    prior: AutoencodingPrior | None = None,
    person: MarkerSubject | None = None,
    start: Motion | None = None,
    each: Stretches = in_turn,
) -> Solution:
    """Solve the motion of the person in a capture: from its views, or from its markers where it has no keypoints.

    Args:
        prior: decoder of poses from unit codes of zero mean, of any length; SPoser as it ships if None.
        person: whose markers they are, from an earlier calibration; None calibrates on the take itself.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
        FileMissing, FileDamaged, JobInvalid: the noise map is none, or is not for this capture.
        MarkersUnknown: too few markers have labels that a layout knows.
        MarkersMirrored: left and right are exchanged, or an axis points the other way.
        SubjectInvalid: the person is of another body, or wears other markers.
        TakeTooShort: the bundle was asked for on fewer than 4 frames.
        PriorInvalid: the prior does not fit itself or the body.
        BackendMissing: torch was asked for and is not installed, or finds no CUDA device.
        BodyUnknown, BodyInvalid, UnsafePickle: there is no such body, or its file is none.
        MotionInvalid: the motion to start at is of other frames or another body.
    """
    problem = prepare(capture, settings, progress, prior, person, start)
    give_back_freed_memory()
    return solve_problem(problem, settings, progress, _sources(capture, settings), each)


def solve_problem(
    problem: Problem,
    settings: SolveSettings,
    progress: Progress = silent,
    provenance: Mapping[str, Any] | None = None,
    each: Stretches = in_turn,
) -> Solution:
    """Solve the motion of the person from measurements of any kind.

    Args:
        provenance: what the motion records besides.
    """
    method = METHODS[settings.method]
    full, solved, convergence = _solve_body(problem, settings, progress, each)
    solved, _ = full.measurements.source.after(full, solved, settings, progress)
    finished: list[SolvedLayer] = []
    for layer in full.measurements.layers:
        solved, done = layer.after(full, solved, settings, progress)
        finished.append(done)
    prior, found = method.prior_of(problem), diagnose_settings(settings, problem.measurements.layers)
    record = {
        "solver": VERSION,
        "settings": asdict(settings),
        "body": problem.body.id,
        "prior": {"name": prior.name, "weights": prior.metadata.get("sha256")},
        **(provenance or {}),
        **problem.measurements.provenance,
        "status": convergence.status,
    }
    if found:
        record["diagnostics"] = [*record.get("diagnostics", ()), *(item.as_dict() for item in found)]
    motion = build_motion(problem.measurements, solved, finished, scale=settings.robust_scale, provenance=record)
    give_back_freed_memory()
    return Solution(motion, convergence.status)


def _solve_body(
    problem: Problem, settings: SolveSettings, progress: Progress, each: Stretches
) -> tuple[Problem, SolvedFrames, Convergence]:
    method = METHODS[settings.method]

    def solve_once(problem: Problem) -> MethodResult:
        subject = first_subject(problem, settings)
        if not method.finds_shape:
            subject = learn_subject(problem, subject, settings, progress)
        give_back_freed_memory()
        found = method.recipe(problem, subject, settings, progress, each)
        give_back_freed_memory()
        return found

    full, (solved, convergence) = problem, solve_once(problem)
    for layer in problem.measurements.layers:
        full = layer.blocks(full, solved, settings)
    if full.measurements.landmarks is not problem.measurements.landmarks:
        solved, convergence = solve_once(full)
    return full, solved, convergence


def calibrate_person(
    captures: Sequence[Capture], settings: SolveSettings = SolveSettings(), progress: Progress = silent
) -> MarkerSubject:
    """Return the person who wears the same markers in one or several captures.

    Raises:
        NoDetections: a capture has no markers.
        MarkersUnknown: too few markers have labels that a layout knows.
        BackendMissing, BodyUnknown, BodyInvalid: as in ``solve``.
    """
    for capture in captures:
        if capture.markers is None:
            raise NoDetections("The capture has no markers to calibrate.", where=capture.name, hint="Choose a C3D.")
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
    """Solve some frames of an earlier motion again, through poses that a person pinned; see ``solve_range``.

    Raises:
        JobInvalid, MotionInvalid: the take does not have the frame range; the motion is of another take or body.
        TooFewViews, NoDetections, BackendMissing: as in ``solve``.
    """
    from solver_backend.fitters.hands.wide_motion import without_fingers
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
    """Solve some frames of a motion again without its recording, through poses that a person pinned.

    Where nothing is pinned near by, the motion's own points are what is measured; about a pin the prior fills in.

    Args:
        settings: as of ``solve``.

    Raises:
        JobInvalid: the frame range is none of this motion.
        MotionInvalid: the motion belongs to another body, or the two are of different lengths.
        NoDetections: too few frames are left beside the pins.
    """
    from solver_backend.fitters.hands.wide_motion import without_fingers
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
