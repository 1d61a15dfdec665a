"""From a capture to a motion: the one entry that the command line, the job file and the add-on use."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from solver_backend.agreement.left_out import without_views
from solver_backend.body.body import Body
from solver_backend.body.files.choices import load_chosen_body, resolve_body
from solver_backend.body.label_places import places_given
from solver_backend.exchange.errors import BackendMissing, NoDetections, TakeTooShort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.hands.wide_motion import with_hands, without_fingers
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.keyframes.optimise import Stretches, in_turn
from solver_backend.fitters.marker_calibration.label_faults import named_alike
from solver_backend.fitters.marker_calibration.marker_problem import calibrated, marker_problem
from solver_backend.fitters.marker_calibration.subject_record import person_of
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.measurements.hand_clouds import split_hands
from solver_backend.fitters.measurements.markers import (
    known_markers_of,
    loose_markers,
    measure_directly,
    measure_markers,
    measure_motion,
)
from solver_backend.fitters.measurements.views import with_meant_confidence
from solver_backend.fitters.methods import (
    METHODS,
    diagnose_settings,
    require_curves,
    require_network,
    require_one_view,
    require_start,
)
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.output.build_motion import build_motion
from solver_backend.fitters.own_points import solve_with_points, without_points
from solver_backend.fitters.partial_body.rest_parts import rest_parts
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.props.solve_props import solve_props
from solver_backend.fitters.recipes.frame_range import solve_again
from solver_backend.fitters.solution import MethodResult, Solution
from solver_backend.fitters.subject_calibration.shape import learn_subject
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture, MarkerSubject, Motion


def solve(
    capture: Capture, settings: SolveSettings = SolveSettings(), progress: Progress = silent, *,
    prior: AutoencodingPrior | None = None, person: MarkerSubject | None = None, start: Motion | None = None,
    each: Stretches = in_turn,
) -> Solution:  # fmt: skip
    """Solve the motion of the person in a capture: from its views, or from its markers where it has no keypoints.

    Args:
        capture: calibrated cameras and 2D keypoints, or labelled optical markers.
        settings: method, backend and the rest.
        progress: called as stages advance.
        prior: decoder of poses from unit codes of zero mean, of any length; SPoser as it ships if None.
        person: whose markers they are, from an earlier calibration; None calibrates on the take itself.
        start: an earlier motion of these frames at which several cameras start, such as that of one of them.
        each: solves the stretches of a long take, on other machines perhaps; the global method's alone.

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
    problem: Problem, settings: SolveSettings, progress: Progress = silent,
    provenance: Mapping[str, Any] | None = None, each: Stretches = in_turn,
) -> Solution:  # fmt: skip
    """Solve the motion of the person from measurements of any kind.

    Args:
        problem: measurements made ready, in arrays of the settings' backend.
        settings: method and the rest.
        progress: called as stages advance.
        provenance: what the motion records besides.
        each: solves the stretches of a long take; the global method's alone.
    """
    method, named = METHODS[settings.method], problem.measurements

    def by_method(problem: Problem) -> MethodResult:
        subject = first_subject(problem, settings)
        if not method.finds_shape:
            subject = learn_subject(problem, subject, settings, progress)
        give_back_freed_memory()
        found = method.recipe(problem, subject, settings, progress, each)
        give_back_freed_memory()
        return found

    hands, origin = None, _origin(settings.backend)
    problem, (solved, convergence) = solve_with_points(problem, by_method(problem), by_method, settings, origin)
    solved = without_points(named, rest_parts(problem.measurements, solved))
    problem = replace(problem, measurements=named)
    if problem.measurements.hands is not None:
        from solver_backend.fitters.hands.solve_hands import solve_hands

        solved, hands = solve_hands(problem.measurements, solved, settings, progress)
    props, found = solve_props(problem.measurements, solved, progress)
    found = [*found, *diagnose_settings(settings, hands=problem.measurements.hands is not None)]
    prior = method.prior_of(problem)
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
    motion = build_motion(problem.measurements, solved, scale=settings.robust_scale, provenance=record)
    motion = replace(motion, props=props) if props else motion
    motion = motion if hands is None else with_hands(motion, hands)
    give_back_freed_memory()
    return Solution(motion, convergence.status)


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
    own = places_given(settings.layout)
    body, like = load_chosen_body(settings.body), _origin(settings.backend)
    sources = [source for capture in captures for source in capture.sources]
    alike, found = named_alike([split_hands(c.markers, own)[0] for c in captures if c.markers is not None], own)
    return calibrated(alike, body, load_sposer(), like, settings, progress, {"sources": sources, **found})


def resolve_range(
    capture: Capture, motion: Motion, frame_range: FrameRange, settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
) -> Solution:  # fmt: skip
    """Solve some frames of an earlier motion again, through poses that a person pinned; see ``solve_range``.

    Raises:
        JobInvalid, MotionInvalid: the take does not have the frame range; the motion is of another take or body.
        TooFewViews, NoDetections, BackendMissing: as in ``solve``.
    """
    frame_range.check(capture.num_frames or frame_range.last + 1)  # before anything is measured
    problem = prepare(capture, settings, progress, person=person_of(without_fingers(motion)))
    return solve_again(problem, first_subject(problem, settings), motion, frame_range, settings, progress)


def resolve_motion(
    measured: Motion, motion: Motion, frame_range: FrameRange, settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
) -> Solution:  # fmt: skip
    """Solve some frames of a motion again without its recording, through poses that a person pinned.

    Where nothing is pinned near by, the motion's own points are what is measured; about a pin the prior fills in.

    Args:
        measured: the motion as it came.
        motion: the motion to be changed: the same one, or an earlier change of it.
        frame_range: what to solve again, and the pins.
        settings: as of ``solve``.
        progress: called as stages advance.

    Raises:
        JobInvalid: the frame range is none of this motion.
        MotionInvalid: the motion belongs to another body, or the two are of different lengths.
        NoDetections: too few frames are left beside the pins.
    """
    body, like = load_chosen_body(settings.body), _origin(settings.backend)
    frame_range.check(measured.num_frames)
    points = measure_motion(body, without_fingers(measured), [pin.frame for pin in frame_range.pins], like)
    problem = Problem.of(body, load_sposer(), points)
    return solve_again(problem, first_subject(problem, settings), motion, frame_range, settings, progress)


def prepare(
    capture: Capture, settings: SolveSettings, progress: Progress, prior: AutoencodingPrior | None = None,
    person: MarkerSubject | None = None, start: Motion | None = None,
) -> Problem:  # fmt: skip
    """Return the views of a capture made ready for a solver, or its markers where it has no keypoints.

    Raises:
        TooFewViews, NoDetections, MarkersUnknown, SubjectInvalid, TakeTooShort, BackendMissing: as in ``solve``.
    """
    if capture.keypoints is not None or capture.markers is None:
        capture.require_views()
    require_curves(settings, capture.name)
    method = METHODS[settings.method]
    if not method.per_frame and capture.num_frames < 4:
        raise TakeTooShort(
            f"The bundle needs 4 frames, the take has {capture.num_frames}.", where=capture.name,
            hint="Use the method 'frame' for single images.",
        )  # fmt: skip
    if start is not None:
        require_start(settings, capture)
    body, like = load_chosen_body(settings.body), _origin(settings.backend)
    prior = load_sposer() if prior is None else prior
    meant = with_meant_confidence(capture, settings.noise)
    if settings.is_direct:
        require_network(settings, capture.name)
        return Problem.of(body, prior, measure_directly(capture, body, like, settings, person, progress))
    if capture.keypoints is None and capture.markers is not None:
        markers, hands = split_hands(capture.markers, places_given(settings.layout))
        if method.finds_shape and person is None:
            problem = Problem.of(body, prior, measure_markers(known_markers_of(markers), body, like))
        else:
            problem = marker_problem(markers, body, prior, like, settings, progress, person)
        worn = problem.measurements.marker_labels or ()
        beside = {"loose": loose_markers(markers, worn, settings.layout), "others": capture.others}
        return replace(problem, measurements=replace(problem.measurements, hands=hands, **beside))
    seen = without_views(meant, settings.leave_out)
    if seen.is_one_view:
        return Problem.of(body, prior, _one_view(seen, body, prior, like, settings, progress))
    from solver_backend.fitters.measurements.views import begin_at, measure_views

    views = measure_views(seen, body, like, progress, estimate_sync=settings.estimate_sync, sync=settings.sync)
    if start is not None:
        views = begin_at(views, without_fingers(start), body, prior_on_body(prior, body.layout), like)
    return Problem.of(body, prior, views)


def _one_view(
    capture: Capture, body: Body, prior: AutoencodingPrior, like: Array, settings: SolveSettings, progress: Progress
) -> Measurements:  # fmt: skip
    """Return what one camera measures, for the method that can solve it.

    Raises:
        JobInvalid: the method solves no take of one camera.
        NoDetections: see ``measure_one_view``.
    """
    require_one_view(settings, capture.name)
    from solver_backend.fitters.one_view.measure import measure_one_view

    return measure_one_view(capture, body, prior_on_body(prior, body.layout), like, settings.betas, progress)


def first_subject(problem: Problem, settings: SolveSettings) -> Subject:
    """Return the person who is known, else the average one without bias, of the shape that the settings know."""
    if problem.measurements.subject is not None:
        return problem.measurements.subject
    subject = Subject.average(problem.body, problem.measurements.landmarks, _origin(settings.backend))
    return subject if settings.betas is None else replace(subject, betas=constant(settings.betas, subject.betas))


def _origin(backend: str) -> Array:
    """Return an array of the backend's kind that constants take after."""
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


def _sources(capture: Capture, settings: SolveSettings) -> dict[str, Any]:
    """Return which files went into a solve."""
    path = resolve_body(settings.body)
    fingerprint = {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    named = {"person": capture.person} if capture.person else {}
    return {"body_file": fingerprint, "capture": capture.name, **named, "sources": list(capture.sources)}
