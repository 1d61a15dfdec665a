"""Label a take's markers, calibrate or match the person, and clean the labels."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.label_places import places_given
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import (
    LEAST_MARKERS,
    is_unnamed,
    least_markers,
    name_markers,
    named_bone,
    places_by_side,
)
from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic, merge
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.marker_calibration.calibrate import (
    SubjectCalibration,
    calibrate,
    matched,
    record_of,
    subject_of,
    with_marker,
)
from solver_backend.fitters.marker_calibration.label_evidence import check_sides, exchanged_wrists
from solver_backend.fitters.marker_calibration.label_faults import (
    clean_labels,
    diagnose_labels,
    exchanged_labels,
    exchanged_throughout,
    gathered,
)
from solver_backend.fitters.marker_calibration.person_doubts import (
    EXCHANGED,
    MISPLACED,
    SIDE_FOUND,
    TWO_PLACES,
    check_one_body,
    doubt_joints,
    doubts_of,
)
from solver_backend.fitters.marker_calibration.unknown_markers import (
    NUM_ATTACHED,
    BonePoses,
    attach,
    common_bones,
    loose_groups,
)
from solver_backend.fitters.measurements.markers import assign_person, known_markers_of, measure_markers, measured_at
from solver_backend.fitters.measurements.views import LocatedPoints
from solver_backend.fitters.model.subject import pose
from solver_backend.fitters.problem import Problem, noted
from solver_backend.fitters.single_frame import posed, rough_markers, rough_motion
from solver_backend.geometry.arrays import Array, quantile, to_numpy
from solver_backend.geometry.marker_jumps import frozen, jumping, neighbours_of
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.types import MARKER_GHOST, MARKER_SWAPPED, MarkerCloud, MarkerSubject

FARTHEST_M = {"shaft": 0.19, "hand": 0.15, "trunk": 0.15, "head": 0.15, "bone": 0.13, "foot": 0.11}
"""Largest distance in metres of a marker from its location, for each kind of location. Wands reach 0.155, others 0.13
(1,900 markers)."""
FREE_M = {"BAC": 0.25, "SACR": 0.16}  # The same for freely chosen positions: the back's offset, the sacrum's wands.


def off_place(places: tuple[str, ...], distance: np.ndarray) -> list[int]:
    """Return the markers that are too far from their usual locations on the body, farthest first.

    Joint centres and markers known only by their bone have no expected position.
    """
    far = [m for m, place in enumerate(places) if distance[m] > _farthest(place)]
    return sorted(far, key=lambda m: -distance[m])


def distances(found: SubjectCalibration, points: np.ndarray) -> np.ndarray:
    """Return the sum of each marker's distance from its usual location and its median residual, in metres (M,)."""
    away = np.linalg.norm(points[found.frames] - to_numpy(pose(found.subject, found.poses).points), axis=-1)
    residual = np.nan_to_num(quantile(away, 0.5, axis=0))
    return np.linalg.norm(to_numpy(found.subject.offsets), axis=-1) + residual


def _farthest(place: str) -> float:
    layouts = load_layouts()
    rule = layouts.midline.get(place) or layouts.sided.get(place[1:])
    if place.startswith(ON_BONE) or is_joint_centre(place) or rule is None:
        return np.inf
    bare = place if place in layouts.midline else place[1:]
    return FREE_M.get(bare, FARTHEST_M[rule["kind"]])


APART_M = 0.09
"""Smallest distance in metres between a marker's positions on the body in two takes. For five people in UI-PRMD, the
median distances are 11 to 20 mm, at shoulders up to 85 mm. Subject 5's moved thigh markers have 90 and 111 mm."""
STEADY = 0.25  # Largest spread of a marker within a take, relative to its distance between takes. Others slide.
_TWISTED = ("elbow", "wrist", "hand")  # Twist of these bones alone moves markers by up to 114 mm.
LEAST_FRAMES = 4  # Smallest number of frames in a take that show a marker.


def two_places(found: SubjectCalibration, points: np.ndarray, takes: np.ndarray) -> list[tuple[int, float, int, int]]:
    """Find markers that are at different positions on the body in two takes.

    Return each marker, the distance between its two positions in metres, and the two takes.

    A marker's position in a take is the median of ``Gᵀ (x - p)`` over the calibrated frames, where p and G are the
    position and rotation of the landmark's main bone. ``points`` (F, M, 3) are the takes' markers in metres, NaN where
    missing. ``takes`` (F,) is the take that each frame belongs to.
    """
    subject, poses = found.subject, BonePoses.of(found.subject, found.poses)
    bones = np.argmax(subject.landmarks.weights, axis=1)
    away = points[found.frames] - poses.joints[:, bones]
    local = (np.swapaxes(poses.rotations[:, bones], -1, -2) @ away[..., None])[..., 0]
    take = takes[found.frames]
    numbers = [number for number in np.unique(take).tolist() if (take == number).sum() >= LEAST_FRAMES]
    parts = [local[take == number] for number in numbers]
    places = [quantile(part, 0.5, axis=0) for part in parts]
    around = [
        quantile(np.linalg.norm(part - place, axis=-1), 0.5, axis=0) for part, place in zip(parts, places, strict=True)
    ]
    seen = [np.isfinite(part).all(-1).sum(axis=0) >= LEAST_FRAMES for part in parts]
    doubts = []
    for m, bone in enumerate(bones):
        there = [i for i in range(len(numbers)) if seen[i][m]]
        pairs = [(float(np.linalg.norm(places[a][m] - places[b][m])), a, b) for a, b in combinations(there, 2)]
        if not pairs or subject.body.layout.joints[bone].endswith(_TWISTED):
            continue
        apart, a, b = max(pairs)
        if apart > APART_M and max(around[a][m], around[b][m]) < STEADY * apart:
            doubts.append((m, apart, numbers[a], numbers[b]))
    return sorted(doubts, key=lambda doubt: -doubt[1])


def marker_problem(
    cloud: MarkerCloud,
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
    settings: SolveSettings,
    progress: Progress,
    person: MarkerSubject | None = None,
) -> Problem:
    """Prepare the problem of solving labelled markers on a calibrated person.

    Args:
        person: a person from an earlier calibration. None calibrates on this take.

    Raises:
        MarkersUnknown, NoDetections: too few markers are known or visible.
        MarkersMirrored: the markers are a mirror image of markers on a body.
        SubjectInvalid: the person was calibrated on another body or wears other markers.
    """
    found: list[Diagnostic] = []
    doubts: list[Diagnostic] = []
    if person is None:
        person = calibrated([cloud], body, prior, like, settings, progress)
        found = [_throughout(cloud, *pair) for pair in person.provenance.get(EXCHANGED, ())]
        doubts = [*doubt_joints(cloud, person), *doubts_of(person)]
    person, columns = matched(person, cloud.names)
    worn = cloud.columns(columns, person.labels)
    subject = subject_of(person, body, like)
    _check(worn.positions, subject.landmarks, body, person.offsets)

    def ready(markers: MarkerCloud) -> Problem:
        measured = measured_at(markers, subject.landmarks, like, person.sigma_m)
        return Problem.of(body, prior, assign_person(measured, subject, person.sigma_m))

    problem = _cleaned(ready(worn), worn, ready, progress, found)
    if not doubts:
        return problem
    measured = problem.measurements
    return replace(problem, measurements=replace(measured, provenance=noted(measured.provenance, doubts)))


def _check(points: np.ndarray, landmarks: Landmarks, body: Body, offsets: np.ndarray | float = 0.0) -> None:
    check_one_body(points, landmarks, body, offsets)
    check_sides(points, landmarks)


def _cleaned(
    problem: Problem,
    cloud: MarkerCloud,
    ready: Callable[[MarkerCloud], Problem],
    progress: Progress,
    found: list[Diagnostic],
) -> Problem:
    points, subject = problem.measurements.points, problem.measurements.known_person
    assert subject is not None
    around = neighbours_of(points)
    still = frozen(points, around, cloud.fps)
    tested = jumping(points, around)
    progress("Checking the labels", 0, 1)
    points = np.where(still[..., None], np.nan, points)
    moving = ready(replace(cloud, positions=points)) if still.any() else problem
    rough = rough_motion(moving, subject)
    expected = to_numpy(pose(subject, posed(problem.prior, rough.states)).points)
    exchanged = exchanged_throughout(points[rough.frames], expected)
    exchanged += _disjoint(exchanged, exchanged_wrists(points, subject.landmarks.names))
    if not (still.any() or tested.any() or exchanged or found):
        return replace(problem, measurements=replace(problem.measurements, rough=rough))
    for a, b in exchanged:
        points[:, [a, b]] = points[:, [b, a]]
        found = [*found, _throughout(cloud, cloud.names[a], cloud.names[b])]
    cleaned = clean_labels(points, rough_markers(moving, subject, rough), around, tested, cloud.fps)
    again = ready(moved_points(cloud, cleaned.points))
    flags = np.where(still, MARKER_GHOST, cleaned.flags).astype(np.uint8)
    for item in found:
        flags[:, [cloud.names.index(label) for label in item.where.markers if label in cloud.names]] |= MARKER_SWAPPED
    diagnostics = gathered(merge([*found, *diagnose_labels(still, cleaned.faults, cloud.names)]))
    provenance = {**again.measurements.provenance, "diagnostics": [item.as_dict() for item in diagnostics]}
    progress("Checking the labels", 1, 1)
    source = again.measurements.source
    assert isinstance(source, LocatedPoints)
    source = replace(source, flags=flags)
    return replace(again, measurements=replace(again.measurements, source=source, rough=rough, provenance=provenance))


def moved_points(cloud: MarkerCloud, points: np.ndarray) -> MarkerCloud:
    """Return the cloud with corrected markers. Residuals and covariances move with the points that got another label.

    ``points`` (F, L, 3) are the corrected positions. Excluded markers are NaN.
    """
    if cloud.residual is None and cloud.covariance is None:
        return replace(cloud, positions=points)
    frame, column = np.nonzero((points != cloud.positions).any(-1) & np.isfinite(points).all(-1))
    same = (cloud.positions[frame] == points[frame, column][:, None]).all(-1)
    found = same.any(-1)

    def follow(values: np.ndarray | None) -> np.ndarray | None:
        if values is None:
            return None
        moved = values.copy()
        moved[frame, column] = np.nan
        moved[frame[found], column[found]] = values[frame[found], same[found].argmax(-1)]
        return moved

    return replace(cloud, positions=points, residual=follow(cloud.residual), covariance=follow(cloud.covariance))


def _throughout(cloud: MarkerCloud, *labels: str) -> Diagnostic:
    frames = [(0, len(cloud.positions) - 1)]
    return diagnostic("markers_exchanged", markers=sorted(labels), frames=frames, remedy=Remedy.REPAIRED)


def calibrated(
    clouds: Sequence[MarkerCloud],
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
    settings: SolveSettings,
    progress: Progress,
    provenance: dict[str, Any] | None = None,
) -> MarkerSubject:
    """Calibrate a person who wears the same markers in one or more takes.

    Raises:
        MarkersUnknown, NoDetections: too few markers are known or visible.
        MarkersMirrored: the markers are a mirror image of markers on a body.
        FileMissing, FileDamaged: the layout file in the settings cannot be read.
    """
    cloud = joined(clouds)
    given = places_given(settings.layout)
    by_side = places_by_side(cloud, given)
    own = {**given, **by_side}
    names = name_markers([label for label in cloud.names if not is_unnamed(label)], own)
    known = known_markers_of(cloud, own)
    # A few chosen labels identify fewer markers than all of them together, so keep what these identified.
    own = {**names.known, **own}

    def ready() -> Problem:
        return Problem.of(body, prior, measure_markers(known, body, like, own=own))

    problem = ready()
    points, landmarks = problem.measurements.points, problem.measurements.landmarks
    _check(points, landmarks, body)
    pairs, labels = exchanged_labels(problem, like), known.names
    wrists = _disjoint(pairs, exchanged_wrists(points, landmarks.names))
    pairs += [(a, b) for a, b in wrists if not {labels[a], labels[b]} & set(given)]
    if pairs:
        for a, b in pairs:
            own = {**own, labels[a]: landmarks.names[b], labels[b]: landmarks.names[a]}
        problem = ready()
    exchanged = [sorted((labels[a], labels[b])) for a, b in pairs]
    found = calibrate(problem, like, settings, progress)
    misplaced, doubled = list[dict[str, Any]](), list[dict[str, Any]]()
    takes = np.repeat(np.arange(len(clouds)), [len(one.positions) for one in clouds])

    def leave_out(gone: Collection[int]) -> bool:
        """Calibrate again without some markers. Return whether enough markers remain."""
        nonlocal known, problem, found
        places = problem.measurements.landmarks.names
        if not gone or len(places) - len(gone) < least_markers(places):
            return False
        known = known.columns([m for m in range(len(places)) if m not in gone])
        problem = ready()
        found = calibrate(problem, like, settings, progress)
        return True

    # Repeat, because one wrong name distorts the body and hides others.
    while True:
        places, off = problem.measurements.landmarks.names, distances(found, problem.measurements.points)
        far, labels = off_place(places, off), known.names
        if not leave_out(far):
            break
        misplaced += [{"label": labels[m], "place": places[m], "off_m": round(float(off[m]), 3)} for m in far]
    for _ in range(LEAST_MARKERS if len(clouds) > 1 else 0):
        two, labels = two_places(found, problem.measurements.points, takes), known.names
        if not leave_out({m for m, *_ in two}):
            break
        doubled += [{"label": labels[m], "apart_m": round(d, 3), "take": a + 1, "other": b + 1} for m, d, a, b in two]
    sides = [{"label": label, "place": place} for label, place in by_side.items()]
    away = {row["label"] for row in misplaced}
    # Swapped markers that are excluded later, because only part of the take swaps them, are not corrected.
    corrected = [pair for pair in exchanged if not away & set(pair)]
    doubts = {SIDE_FOUND: sides, TWO_PLACES: doubled, EXCHANGED: corrected, MISPLACED: misplaced}
    record = {"frames": found.frames.tolist(), **(provenance or {})} | {
        key: rows for key, rows in doubts.items() if rows
    }
    person = record_of(found.subject, known.names, found.sigma_m, record)
    return _with_attached(person, found, cloud, {*names.unknown, *away})


def _disjoint(pairs: Sequence[tuple[int, int]], more: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    known = {m for pair in pairs for m in pair}
    return [pair for pair in more if not known & set(pair)]


def _with_attached(
    person: MarkerSubject, found: SubjectCalibration, cloud: MarkerCloud, unknown: Collection[str]
) -> MarkerSubject:
    """Add markers with unknown labels to a person if they move with a bone and do not belong to a prop."""
    bones = BonePoses.of(found.subject, found.poses)
    columns = [column for column, label in enumerate(cloud.names) if label in unknown]
    some = MarkerCloud(cloud.positions[found.frames][:, columns], cloud.fps, tuple(cloud.names[i] for i in columns))
    props = {m for group in loose_groups(some, bones) for m in group.columns}
    carriers = found.subject.landmarks.weights[:, :NUM_ATTACHED].argmax(axis=1).tolist()
    parents = found.subject.body.parents
    known = {label: (bone, max(int(parents[bone]), 0)) for label, bone in zip(person.labels, carriers, strict=True)}
    common = common_bones(cloud.positions[found.frames], cloud.names, bones, known)
    for m, label in enumerate(some.names):
        if m in props or label in person.labels:
            continue
        points, bone = some.positions[:, m], named_bone(label)
        if marker := attach(points, bones, bone or common.get(label)) or attach(points, bones, bone):
            person = with_marker(person, label, marker)
    return person


def joined(clouds: Sequence[MarkerCloud]) -> MarkerCloud:
    """Concatenate the frames of several takes. Markers that a take lacks are NaN there."""
    if len(clouds) == 1:
        return clouds[0]
    labels = tuple(dict.fromkeys(label for cloud in clouds for label in cloud.names))

    def join(values: Sequence[np.ndarray]) -> np.ndarray:
        parts = []
        for cloud, value in zip(clouds, values, strict=True):
            part = np.full((len(value), len(labels), *value.shape[2:]), np.nan)
            part[:, [labels.index(label) for label in cloud.names]] = value[:, : len(cloud.names)]
            parts.append(part)
        return np.concatenate(parts)

    known = [cloud.covariance for cloud in clouds if cloud.covariance is not None]
    covariance = join(known) if len(known) == len(clouds) else None
    return MarkerCloud(join([cloud.positions for cloud in clouds]), clouds[0].fps, labels, None, covariance)
