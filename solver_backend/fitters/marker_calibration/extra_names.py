"""Name points that the labelling network leaves unnamed, by their positions relative to bones."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.marker_names import is_unnamed
from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.marker_calibration.calibrate import matched, subject_of, with_marker
from solver_backend.fitters.marker_calibration.unknown_markers import LEAST_FRAMES_OF_BONE as LEAST_FRAMES
from solver_backend.fitters.marker_calibration.unknown_markers import (
    REACH_M,
    RESIDUAL_M,
    Attachment,
    BonePoses,
    bone_offsets,
    loose_groups,
)
from solver_backend.fitters.measurements.markers import assign_person, measured_at
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import posed, rough_markers, rough_motion
from solver_backend.geometry.arrays import quantile
from solver_backend.labelling.outputs import MARKERS
from solver_backend.labelling.tracklets import tracklets_of
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import MarkerCloud, MarkerSubject


def in_words_of(person: MarkerSubject, cloud: MarkerCloud) -> MarkerCloud:
    """Replace a take's anatomical marker names by the person's labels."""
    own = dict(zip(person.places, person.labels, strict=True))
    own = {place: label for place, label in own.items() if not place.startswith(ON_BONE) and label not in cloud.names}
    return replace(cloud, labels=tuple(own.get(label, label) for label in cloud.names))


def nameless_columns(cloud: MarkerCloud, others: Collection[str] = ()) -> np.ndarray:
    """Return the columns of unnamed points, and of points with a name in ``others``."""
    return np.flatnonzero([is_unnamed(label) or label in others for label in cloud.names])


def missing_markers(cloud: MarkerCloud, person: MarkerSubject) -> np.ndarray:
    """Return an (F, L) mask of the person's markers that are missing under their labels."""
    missing = np.ones((len(cloud.positions), len(person.labels)), dtype=bool)
    for m, label in enumerate(person.labels):
        if label in cloud.names:
            missing[:, m] = ~np.isfinite(cloud.positions[:, cloud.names.index(label)]).all(-1)
    return missing


def with_names(cloud: MarkerCloud, columns: np.ndarray, which: np.ndarray, labels: Sequence[str]) -> MarkerCloud:
    """Move recognised points to the columns of their markers.

    Args:
        columns: (N,) columns of the points.
        which: (F, N) marker of each point, -1 if unknown.
        labels: labels of the markers.
    """
    given, names = cloud.values, list(cloud.names)
    values = given.copy()
    f, n = np.nonzero(which >= 0)
    values[f, columns[n]] = np.nan

    def add(name: str) -> None:
        nonlocal values
        names.append(name)
        values = np.concatenate([values, np.full_like(values[:, :1], np.nan)], axis=1)

    for marker in map(int, np.unique(which[which >= 0])):
        f, n = np.nonzero(which == marker)
        if labels[marker] not in names:
            add(labels[marker])
        column = names.index(labels[marker])
        before = values[f, column]
        # If the network gave this label to another point, that point loses its name.
        if np.isfinite(before[:, 0]).any():
            add(next(name for k in range(len(names) + 1) if (name := f"*{k}") not in names))
            values[f, -1] = before
        values[f, column] = given[f, columns[n]]
    kept = [i for i in range(len(names)) if i not in columns or np.isfinite(values[:, i, 0]).any()]
    return cloud.with_values(values[:, kept], tuple(names[i] for i in kept))


MARGIN_M = 0.03  # Largest median distance between a point and its marker on the body.
CLEAR = 0.7  # The distance to a marker must be below this factor times the distances of all rivals.
LEAST_SHARE = 0.25  # Smallest share of a take that shows a new marker. Stray points are brief.
APART_M = 0.02  # Smallest distance between a new marker and known ones on its bone. A closer one may be the same.
TURN = 0.05  # Rotation error of a bone in a rough pose, radians. Its effect grows with the distance from the joint.

_BONES = "hip THI, knee SHN, ankle FOOT, foot TOES, collar COL, shoulder UPA, elbow FRM, wrist HAND, hand FINGERS"
_SIDED = dict[str, str](map(str.split, _BONES.split(", ")))
"""Abbreviation, in marker names, of the bone that begins at each joint."""


@dataclass(frozen=True)
class ExtraNames:
    """Take after unnamed points received the labels of the person's markers."""

    cloud: MarkerCloud
    named: tuple[str, ...]  # Labels that points received.
    doubtful: int  # Chains of points near a known marker with an ambiguous match, which stay unnamed.


@dataclass(frozen=True)
class _ChainPoints:
    frames: np.ndarray  # (K,)
    points: np.ndarray  # (K, 3) metres

    def part(self, frames: np.ndarray) -> _ChainPoints:
        inside = np.isin(self.frames, frames)
        return _ChainPoints(self.frames[inside], self.points[inside])


@dataclass(frozen=True)
class _Take:
    expected: np.ndarray  # (F, L, 3) metres, the person's markers on the body
    frames: np.ndarray  # (K,) frames with known poses
    bones: BonePoses  # in these frames
    columns: np.ndarray  # (N,) columns of the points without names
    chain: np.ndarray  # (F, N) chain of each point, -1 where there is none
    tracks: list[_ChainPoints]  # by chain


def named_extras(
    cloud: MarkerCloud, person: MarkerSubject, body: Body, progress: Progress = silent, kept: Collection[str] = ()
) -> ExtraNames:
    """Rename a take's markers to the person's labels, and name unnamed points.

    Args:
        person: a person calibrated on this body, with markers attached to bones.
        kept: names that the user assigned. These names stay even if the person has no such marker.

    Raises:
        SubjectInvalid: the person was calibrated on another body or wears other markers.
    """
    cloud = in_words_of(person, cloud)
    kept = {*kept, *(label for label, place in zip(person.labels, person.places, strict=True) if place in kept)}
    nameless = nameless_columns(cloud, {*MARKERS} - {*person.labels, *kept})
    if not nameless.size:
        return ExtraNames(cloud, (), 0)
    take = _take(cloud, nameless, person, body, progress)
    elsewhere = _elsewhere(cloud, person, take) - {*kept}
    # If half of them are elsewhere, it is another person, which the solve reports.
    elsewhere = elsewhere if 2 * len(elsewhere) < len(set(person.labels) & set(cloud.names)) else set[str]()
    if elsewhere:
        nameless = nameless_columns(cloud, {*MARKERS, *elsewhere} - ({*person.labels, *kept} - elsewhere))
        take = _take(cloud, nameless, person, body, progress)
    missing = missing_markers(cloud, person)
    missing[:, [m for m, label in enumerate(person.labels) if label in elsewhere]] = True
    found, doubtful = _matched(take, missing)
    which = np.where(take.chain >= 0, found[take.chain], -1)
    renamed = with_names(cloud, take.columns, which, person.labels)
    named = sorted(set(found[found >= 0].tolist()))
    return ExtraNames(renamed, tuple(person.labels[m] for m in named), int(doubtful.sum()))


def with_extras(
    person: MarkerSubject, clouds: Sequence[MarkerCloud], body: Body, progress: Progress = silent
) -> MarkerSubject:
    """Find the takes' unlabelled points that move with a bone, and add them to a person as markers.

    A new marker is named after its bone and a number (``LTHI_X1``). A marker from an earlier take keeps its name. The
    person must have been calibrated on this body with the markers named in these takes.
    """
    for cloud in clouds:
        nameless = nameless_columns(cloud, {*MARKERS} - {*person.labels})
        if not nameless.size:
            continue
        take = _take(cloud, nameless, person, body, progress)
        found, doubtful = _matched(take, missing_markers(cloud, person))
        person = _with_new(person, take, np.flatnonzero((found < 0) & ~doubtful), cloud.fps)
    return person


def _take(cloud: MarkerCloud, nameless: np.ndarray, person: MarkerSubject, body: Body, progress: Progress) -> _Take:
    like = np.zeros(1)
    named = cloud.columns([i for i in range(len(cloud.names)) if i not in nameless])
    part, columns = matched(person, named.names)
    worn, subject = named.columns(columns, part.labels), subject_of(part, body, like)
    measured = measured_at(worn, subject.landmarks, like, part.sigma_m)
    problem = Problem.of(body, load_sposer(), assign_person(measured, subject, part.sigma_m))
    progress("Naming the other points", 0, 1)
    rough = rough_motion(problem, subject)
    bones = BonePoses.of(subject, posed(problem.prior, rough.states))
    expected = rough_markers(problem, subject_of(person, body, like), rough)
    points = cloud.positions[:, nameless]
    tracklets = tracklets_of(points, cloud.fps)
    chain = np.where(tracklets.number >= 0, tracklets.chain[tracklets.number], -1)
    f, n = np.nonzero(chain >= 0)
    order = np.argsort(chain[f, n], kind="stable")
    f, n = f[order], n[order]
    edges = np.searchsorted(chain[f, n], np.arange(1, tracklets.num_chains))
    parts = zip(np.split(f, edges), np.split(points[f, n], edges), strict=True)
    tracks = [_ChainPoints(*part) for part in parts] if len(f) else []
    progress("Naming the other points", 1, 1)
    return _Take(expected, rough.frames, bones, nameless, chain, tracks)


def _elsewhere(cloud: MarkerCloud, person: MarkerSubject, take: _Take) -> set[str]:
    found = set[str]()
    for m, label in enumerate(person.labels):
        if label in cloud.names:
            points = cloud.positions[take.frames, cloud.names.index(label)]
            away = quantile(np.linalg.norm(points - take.expected[take.frames, m], axis=-1), 0.5, axis=0)
            found |= {label} if away > MARGIN_M else set()
    return found


def _matched(take: _Take, missing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Match C chains of tracklets to the person's missing markers.

    Return the marker (C,) of each chain, or -1 without a clear match, and a (C,) mask of unmatched chains near a
    marker. ``missing`` (F, L) marks the person's markers that are not observed under their labels.
    """
    tracks, taken = take.tracks, ~missing
    away, found = np.full((len(tracks), missing.shape[1]), np.inf), np.full(len(tracks), -1)
    first, last = (np.array([track.frames[k] for track in tracks], dtype=int) for k in (0, -1))
    for c, track in enumerate(tracks):
        # Interpolated body positions between fitted frames are less accurate.
        fitted = track.part(take.frames)
        fitted = fitted if len(fitted.frames) >= LEAST_FRAMES else track
        if len(fitted.frames) >= LEAST_FRAMES:
            off = np.linalg.norm(fitted.points[:, None] - take.expected[fitted.frames], axis=-1)
            away[c] = np.where(missing[track.frames].mean(0) > 0.5, np.median(off, axis=0), np.inf)
    nearest = away.min(1, initial=np.inf)
    near = nearest < MARGIN_M
    # The nearest chains are matched first, and occupy their marker in these frames.
    for c in np.argsort(nearest, kind="stable")[: near.sum()]:
        best = int(np.argmin(away[c]))
        beside = (first <= last[c]) & (last >= first[c]) & (found < 0)
        beside[c] = False
        rivals = np.append(np.delete(away[c], best), away[beside, best])
        if away[c, best] < CLEAR * rivals.min(initial=np.inf) and not taken[tracks[c].frames, best].any():
            found[c] = best
            taken[tracks[c].frames, best] = True
    return found, near & (found < 0)


def _with_new(person: MarkerSubject, take: _Take, chains: np.ndarray, fps: float) -> MarkerSubject:
    count = np.array([len(take.tracks[c].frames) for c in chains])
    order = np.argsort(-count, kind="stable")
    chains = chains[order][count[order] >= LEAST_SHARE * len(take.expected)]
    if not len(chains):
        return person
    points = np.full((len(take.frames), len(chains), 3), np.nan)
    for m, c in enumerate(chains):
        track = take.tracks[c].part(take.frames)
        points[np.searchsorted(take.frames, track.frames), m] = track.points
    some = MarkerCloud(points, fps, tuple(f"*{c}" for c in chains))
    props = {m for group in loose_groups(some, take.bones) for m in group.columns}
    for m in range(len(chains)):
        found = _attached(points[:, m], take.bones)
        if m in props or found is None:
            continue
        near = [offset for offset, place in zip(person.offsets, person.places, strict=True) if place == found.place]
        if near and np.linalg.norm(found.offset - np.array(near), axis=-1).min() < APART_M:
            continue
        person = with_marker(person, _new_name(found.place, person.labels), found)
    return person


def _attached(points: np.ndarray, bones: BonePoses) -> Attachment | None:
    """Attach points (K, 3) of one marker to a bone. Return None if no bone fits, or too few frames show the marker.

    Unlike ``attach``, this allows for rotation errors: the bone with the smallest ``s + TURN |o|`` is chosen. o is the
    marker's offset from the bone, and s is the median distance from this offset.
    """
    if np.isfinite(points).all(-1).sum() < LEAST_FRAMES:
        return None
    offset, spread, reach = bone_offsets(points, bones.joints, bones.rotations)
    bone = int(np.argmin(np.where(reach < REACH_M, spread + TURN * reach, np.inf)))
    fits = reach[bone] <= REACH_M and spread[bone] <= RESIDUAL_M
    return Attachment.on_bone(bone, offset, spread) if fits else None


def _new_name(place: str, taken: Sequence[str]) -> str:
    joint = place[len(ON_BONE) :]
    side, _, part = joint.partition("_")
    bone = side[0].upper() + _SIDED[part] if part else joint.upper()
    return next(name for k in range(1, len(taken) + 2) if (name := f"{bone}_X{k}") not in taken)
