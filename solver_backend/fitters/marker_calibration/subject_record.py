"""A calibrated person as a plain record, and back on a body."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.marker_layouts import label_key
from solver_backend.body.marker_names import least_markers
from solver_backend.body.markers import MARKER_OFFSET_M, ON_BONE, marker_landmarks, skin_normals
from solver_backend.exchange.errors import SubjectInvalid
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.marker_calibration.calibrate import SIGMA_RANGE_M
from solver_backend.fitters.marker_calibration.unknown_markers import Attachment
from solver_backend.fitters.model.subject import Subject
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.types import MarkerSubject, Motion


def record_of(
    subject: Subject, labels: tuple[str, ...], sigma_m: np.ndarray, provenance: dict[str, Any]
) -> MarkerSubject:
    """Return the record of a person whose landmarks are the markers of these labels."""
    places, offsets = subject.landmarks.names, to_numpy(subject.offsets)
    skin = MARKER_OFFSET_M + (skin_normals(subject.body, places) * offsets).sum(-1)
    skin[[place.startswith(ON_BONE) or is_joint_centre(place) for place in places]] = np.nan
    record = {"solver": VERSION, **provenance}
    return MarkerSubject(subject.body.id, to_numpy(subject.betas), labels, places, offsets, sigma_m, skin, record)


def with_marker(person: MarkerSubject, label: str, marker: Attachment) -> MarkerSubject:
    """Return the person with a further marker on a bone."""
    return replace(
        person,
        labels=(*person.labels, label),
        places=(*person.places, marker.place),
        offsets=np.concatenate([person.offsets, [marker.offset]]),
        sigma_m=np.append(person.sigma_m, np.clip(marker.sigma_m, *SIGMA_RANGE_M)),
        skin_m=np.append(person.skin_m, np.nan),
    )


def person_of(motion: Motion) -> MarkerSubject | None:
    """Return the person of an earlier solve from markers, None where the motion has none."""
    labels, places, offsets, sigma = motion.marker_labels, motion.layout, motion.offsets, motion.marker_sigma
    if offsets is None or labels is None or places is None or sigma is None:
        return None
    return MarkerSubject(motion.body, motion.betas, labels, places, offsets, sigma, np.full(len(labels), np.nan))


def subject_of(record: MarkerSubject, body: Body, like: Array) -> Subject:
    """Return the person of a record, with its markers as landmarks.

    Raises:
        SubjectInvalid: the record is of another body, or has a marker at an unknown place.
    """
    if record.body != body.id:
        raise SubjectInvalid(
            f"The subject was calibrated on the body {record.body!r}, the solve is for {body.id!r}.",
            where="subject",
            hint="Solve with --body of the subject, or calibrate again on this body.",
        )
    try:
        landmarks = marker_landmarks(body, record.places)
    except (KeyError, ValueError) as error:
        raise SubjectInvalid(
            f"The subject has a marker at {error}, which no layout knows.", where="subject", hint="Calibrate again."
        ) from error
    return Subject(body, landmarks, constant(record.betas, like), constant(record.offsets, like))


def matched(record: MarkerSubject, labels: tuple[str, ...]) -> tuple[MarkerSubject, list[int]]:
    """Return the record of the markers that a take has too, under the take's labels, and their columns there.

    Labels match without regard to prefix, case and punctuation.

    Raises:
        SubjectInvalid: fewer match than ``least_markers``.
    """
    # The label itself goes first: parts of one person may have a Marker1 each.
    columns = {key(label): i for key in (label_key, str) for i, label in reversed(list(enumerate(labels)))}
    keys = [label if label in columns else label_key(label) for label in record.labels]
    kept = [m for m, key in enumerate(keys) if key in columns]
    least = least_markers(record.places)
    if len(kept) < least:
        raise SubjectInvalid(
            f"Only {len(kept)} of the subject's {len(keys)} markers are in the take; {least} are needed.",
            where="subject",
            hint="Choose the subject of this person and layout, or calibrate on the take.",
        )
    found, places = [columns[keys[m]] for m in kept], tuple(record.places[m] for m in kept)
    own = {name: getattr(record, name)[kept] for name in ("offsets", "sigma_m", "skin_m")}
    return replace(record, labels=tuple(labels[i] for i in found), places=places, **own), found
