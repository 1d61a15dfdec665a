"""Markers of a take made ready for a solver: named, calibrated or of a known person, and cleaned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.label_places import places_given
from solver_backend.body.marker_names import (
    LEAST_MARKERS,
    is_unnamed,
    least_markers,
    name_markers,
    named_bone,
    places_by_side,
)
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic, merge
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.marker_calibration.calibrate import SIGMA_RANGE_M, SubjectCalibration, calibrate
from solver_backend.fitters.marker_calibration.label_faults import (
    check_sides,
    clean_labels,
    diagnose_labels,
    exchanged_labels,
    exchanged_throughout,
    exchanged_wrists,
    gathered,
)
from solver_backend.fitters.marker_calibration.marker_places import distances, off_place, two_places
from solver_backend.fitters.marker_calibration.person_doubts import (
    EXCHANGED,
    MISPLACED,
    SIDE_FOUND,
    TWO_PLACES,
    check_handedness,
    check_one_body,
    doubt_joints,
    doubts_of,
)
from solver_backend.fitters.marker_calibration.rough_motion import rough_markers, rough_motion
from solver_backend.fitters.marker_calibration.subject_record import matched, record_of, subject_of
from solver_backend.fitters.marker_calibration.unknown_markers import Attachment, BonePoses, attach, loose_groups
from solver_backend.fitters.measurements.markers import assign_person, known_markers_of, measure_markers, measured_at
from solver_backend.fitters.measurements.sources import LocatedPoints
from solver_backend.fitters.model.subject import pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import posed
from solver_backend.geometry.arrays import Array, to_numpy
from solver_backend.geometry.marker_jumps import frozen, jumping, neighbours_of
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.types import MARKER_GHOST, MARKER_SWAPPED, MarkerCloud, MarkerSubject


def marker_problem(
    cloud: MarkerCloud, body: Body, prior: AutoencodingPrior, like: Array, settings: SolveSettings, progress: Progress,
    person: MarkerSubject | None = None,
) -> Problem:  # fmt: skip
    """Return what a solver starts from: the markers of a person whose shape and markers' places are known.

    Args:
        cloud: labelled markers.
        body: whose shape is sought.
        prior: decoder of poses.
        like: array that sets kind, type and device.
        settings: of the solve.
        progress: called as stages advance.
        person: from an earlier calibration; None calibrates on the take.

    Raises:
        MarkersUnknown, NoDetections: too few markers are known, or seen.
        MarkersMirrored: they are a mirror image of a body's.
        SubjectInvalid: the person is of another body or wears other markers.
    """
    found: list[Diagnostic] = []
    doubts: list[Diagnostic] = []
    if person is None:
        person = calibrated([cloud], body, prior, like, settings, progress)
        found = [_throughout(cloud, *pair) for pair in person.provenance.get(EXCHANGED, ())]
        doubts = [*doubt_joints(cloud, person), *doubts_of(person)]
    person, columns = matched(person, cloud.labels or ())
    worn = cloud.columns(columns, person.labels)
    subject = subject_of(person, body, like)

    check_one_body(worn.positions, subject.landmarks, body, person.offsets)
    check_handedness(worn.positions, subject.landmarks)
    check_sides(worn.positions, subject.landmarks)

    def ready(markers: MarkerCloud) -> Problem:
        measured = measured_at(markers, subject.landmarks, like, person.sigma_m)
        return Problem.of(body, prior, assign_person(measured, subject, person.sigma_m))

    problem = _cleaned(ready(worn), worn, ready, progress, found)
    if not doubts:
        return problem
    record = problem.measurements.provenance
    record = {**record, "diagnostics": [*record.get("diagnostics", ()), *(item.as_dict() for item in doubts)]}
    return replace(problem, measurements=replace(problem.measurements, provenance=record))


def _cleaned(
    problem: Problem, cloud: MarkerCloud, ready: Callable[[MarkerCloud], Problem], progress: Progress,
    found: list[Diagnostic],
) -> Problem:  # fmt: skip
    """Return the problem without the markers' wrong labels, and with what was found besides."""
    points, subject = problem.measurements.points, problem.measurements.subject
    assert subject is not None and cloud.labels is not None
    around = neighbours_of(points)
    still = frozen(points, around, cloud.fps)
    tested = jumping(points, around)
    progress("Checking the labels", 0, 1)
    points = np.where(still[..., None], np.nan, points)
    moving = ready(replace(cloud, positions=points)) if still.any() else problem
    rough = rough_motion(moving, subject)
    expected = to_numpy(pose(subject, posed(problem.prior, rough.states)).points)
    exchanged = exchanged_throughout(points[rough.frames], expected)
    exchanged += _beside(exchanged, exchanged_wrists(points, subject.landmarks.names))
    if not (still.any() or tested.any() or exchanged or found):
        return replace(problem, measurements=replace(problem.measurements, rough=rough))
    for a, b in exchanged:
        points[:, [a, b]] = points[:, [b, a]]
        found = [*found, _throughout(cloud, cloud.labels[a], cloud.labels[b])]
    cleaned = clean_labels(points, rough_markers(moving, subject, rough), around, tested, cloud.fps)
    again = ready(moved_points(cloud, cleaned.points))
    flags = np.where(still, MARKER_GHOST, cleaned.flags).astype(np.uint8)
    for item in found:
        known = [cloud.labels.index(label) for label in item.where.markers if label in cloud.labels]
        flags[:, known] |= MARKER_SWAPPED
    diagnostics = gathered(merge([*found, *diagnose_labels(still, cleaned.faults, cloud.labels)]))
    provenance = {**again.measurements.provenance, "diagnostics": [item.as_dict() for item in diagnostics]}
    progress("Checking the labels", 1, 1)
    source = again.measurements.source
    assert isinstance(source, LocatedPoints)
    source = replace(source, flags=flags)
    measured = replace(again.measurements, source=source, rough=rough, provenance=provenance)
    return replace(again, measurements=measured)


def moved_points(cloud: MarkerCloud, points: np.ndarray) -> MarkerCloud:
    """Return the cloud with its points under other labels: what is known of a point's error goes with it.

    Args:
        cloud: F frames of L markers.
        points: (F, L, 3) the same points, some in another column; NaN where a marker is left out.
    """
    if cloud.residual is None and cloud.covariance is None:
        return replace(cloud, positions=points)
    frame, column = np.nonzero((points != cloud.positions).any(-1) & np.isfinite(points).all(-1))
    same = (cloud.positions[frame] == points[frame, column][:, None]).all(-1)

    def followed(values: np.ndarray | None) -> np.ndarray | None:
        if values is None:
            return None
        moved = values.copy()
        moved[frame, column] = np.nan
        found = same.any(-1)
        moved[frame[found], column[found]] = values[frame[found], same[found].argmax(-1)]
        return moved

    residual, covariance = followed(cloud.residual), followed(cloud.covariance)
    return replace(cloud, positions=points, residual=residual, covariance=covariance)


def _throughout(cloud: MarkerCloud, *labels: str) -> Diagnostic:
    """Return that two labels are exchanged in all of a take."""
    frames = [(0, len(cloud.positions) - 1)]
    return diagnostic("markers_exchanged", markers=sorted(labels), frames=frames, remedy=Remedy.REPAIRED)


def calibrated(
    clouds: Sequence[MarkerCloud], body: Body, prior: AutoencodingPrior, like: Array, settings: SolveSettings,
    progress: Progress, provenance: dict[str, Any] | None = None,
) -> MarkerSubject:  # fmt: skip
    """Return the person who wears the same markers in one or several takes.

    Raises:
        MarkersUnknown, NoDetections: too few markers are known, or seen.
        MarkersMirrored: they are a mirror image of a body's.
        FileMissing, FileDamaged: the settings' layout cannot be read.
    """
    cloud = joined(clouds)
    given = places_given(settings.layout)
    by_side = places_by_side(cloud, given)
    own = {**given, **by_side}
    names = name_markers([label for label in cloud.labels or () if not is_unnamed(label)], own)
    known = known_markers_of(cloud, own)
    # The chosen labels alone may identify less than all together: their places go with them.
    own = {**names.known, **own}
    problem = Problem.of(body, prior, measure_markers(known, body, like, own=own))
    check_one_body(problem.measurements.points, problem.measurements.landmarks, body)
    check_handedness(problem.measurements.points, problem.measurements.landmarks)
    check_sides(problem.measurements.points, problem.measurements.landmarks)
    labels, places = known.labels or (), problem.measurements.landmarks.names
    pairs = exchanged_labels(problem, like)
    wrists = exchanged_wrists(problem.measurements.points, places)
    pairs += [(a, b) for a, b in _beside(pairs, wrists) if not {labels[a], labels[b]} & set(given)]
    exchanged = [(labels[a], places[a], labels[b], places[b]) for a, b in pairs]
    if exchanged:
        for a, place_a, b, place_b in exchanged:
            own = {**own, a: place_b, b: place_a}
        problem = Problem.of(body, prior, measure_markers(known, body, like, own=own))
    found = calibrate(problem, like, settings, progress)
    places, misplaced = problem.measurements.landmarks.names, list[tuple[str, str, float]]()
    # Again after each: a name that is wrong bends the body, and hides others.
    while far := off_place(places, off := distances(found, problem.measurements.points)):
        if len(places) - len(far) < least_markers(places):
            break
        labels = known.labels or ()
        misplaced += [(labels[m], places[m], round(float(off[m]), 3)) for m in far]
        kept = [m for m in range(len(places)) if m not in far]
        known = known.columns(kept, tuple(labels[m] for m in kept))
        problem = Problem.of(body, prior, measure_markers(known, body, like, own=own))
        places, found = problem.measurements.landmarks.names, calibrate(problem, like, settings, progress)
    doubled = list[tuple[str, float, int, int]]()
    takes = np.repeat(np.arange(len(clouds)), [len(one.positions) for one in clouds])
    for _ in range(LEAST_MARKERS if len(clouds) > 1 else 0):
        two = two_places(found, problem.measurements.points, takes)
        if not two or len(places) - len(two) < least_markers(places):
            break
        labels, gone = known.labels or (), {m for m, *_ in two}
        doubled += [(labels[m], round(apart, 3), a + 1, b + 1) for m, apart, a, b in two]
        kept = [m for m in range(len(places)) if m not in gone]
        known = known.columns(kept, tuple(labels[m] for m in kept))
        problem = Problem.of(body, prior, measure_markers(known, body, like, own=own))
        places, found = problem.measurements.landmarks.names, calibrate(problem, like, settings, progress)
    record = {"frames": found.frames.tolist(), **(provenance or {})}
    if by_side:
        record[SIDE_FOUND] = [{"label": label, "place": place} for label, place in by_side.items()]
    if doubled:
        keys = ("label", "apart_m", "take", "other")
        record[TWO_PLACES] = [dict(zip(keys, item, strict=True)) for item in doubled]
    # What is left out after all, because it is exchanged in a part of the take, is not corrected.
    if corrected := [sorted((a, b)) for a, _, b, _ in exchanged if not {a, b} & {label for label, *_ in misplaced}]:
        record[EXCHANGED] = corrected
    if misplaced:
        keys = ("label", "place", "off_m")
        record[MISPLACED] = [dict(zip(keys, item, strict=True)) for item in misplaced]
    person = record_of(found.subject, known.labels or (), found.sigma_m, record)
    return with_attached(person, found, cloud, (*names.unknown, *(label for label, *_ in misplaced)))


def _beside(pairs: Sequence[tuple[int, int]], more: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the further pairs that share no marker with those that are known."""
    known = {m for pair in pairs for m in pair}
    return [pair for pair in more if not known & set(pair)]


def with_attached(
    person: MarkerSubject, found: SubjectCalibration, cloud: MarkerCloud, unknown: Sequence[str]
) -> MarkerSubject:
    """Return the person with the markers of unknown labels that move with one of the bones, and are no prop's."""
    frames, subject = found.poses, found.subject
    skeleton = forward_kinematics(subject.body, subject.betas, frames.root, frames.local, frames.transl)
    joints, rotations = to_numpy(skeleton.joints), to_numpy(skeleton.G)
    added: dict[str, Attachment] = {}
    columns = [column for column, label in enumerate(cloud.labels or ()) if label in unknown]
    some = cloud.columns(columns, tuple((cloud.labels or ())[column] for column in columns))
    some = MarkerCloud(some.positions[found.frames], some.fps, some.labels)
    props = {columns[m] for group in loose_groups(some, BonePoses(joints, rotations)) for m in group.columns}
    for column, label in enumerate(cloud.labels or ()):
        if column in columns and column not in props:
            attachment = attach(cloud.positions[found.frames, column], joints, rotations, named_bone(label))
            added |= {} if attachment is None else {label: attachment}
    if not added:
        return person
    sigma = [min(max(item.sigma_m, SIGMA_RANGE_M[0]), SIGMA_RANGE_M[1]) for item in added.values()]
    return replace(
        person,
        labels=(*person.labels, *added),
        places=(*person.places, *(item.place for item in added.values())),
        offsets=np.concatenate([person.offsets, [item.offset for item in added.values()]]),
        sigma_m=np.append(person.sigma_m, sigma),
        skin_m=np.append(person.skin_m, np.full(len(added), np.nan)),
    )


def joined(clouds: Sequence[MarkerCloud]) -> MarkerCloud:
    """Return the frames of several takes one after the other; a marker that a take lacks is missing there."""
    if len(clouds) == 1:
        return clouds[0]
    labels = tuple(dict.fromkeys(label for cloud in clouds for label in cloud.labels or ()))

    def of_all(values: Sequence[np.ndarray]) -> np.ndarray:
        parts = []
        for cloud, value in zip(clouds, values, strict=True):
            part = np.full((len(value), len(labels), *value.shape[2:]), np.nan)
            part[:, [labels.index(label) for label in cloud.labels or ()]] = value[:, : len(cloud.labels or ())]
            parts.append(part)
        return np.concatenate(parts)

    known = [cloud.covariance for cloud in clouds if cloud.covariance is not None]
    covariance = of_all(known) if len(known) == len(clouds) else None
    return MarkerCloud(of_all([cloud.positions for cloud in clouds]), clouds[0].fps, labels, None, covariance)
