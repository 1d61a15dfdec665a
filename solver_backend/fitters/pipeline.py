"""From a capture to a motion: the one entry that the command line, the job file and the add-on use."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from solver_backend.body.files.choices import load_chosen_body, resolve_body
from solver_backend.body.label_places import places_given
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.build_motion import build_motion
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.keyframes.optimise import Stretches, in_turn
from solver_backend.fitters.layers import SolvedLayer
from solver_backend.fitters.methods import (
    METHODS,
    diagnose_settings,
)
from solver_backend.fitters.prepare import first_subject, make_origin, prepare
from solver_backend.fitters.problem import Convergence, MethodResult, Problem, Solution, SolvedFrames
from solver_backend.fitters.subject_calibration.shape import learn_subject
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture, MarkerSubject, Motion


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
    from solver_backend.fitters.marker_calibration.subject_record import person_of
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
