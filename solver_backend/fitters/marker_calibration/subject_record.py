"""A calibrated person as a plain record, and back on a body."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.marker_layouts import label_key
from solver_backend.body.marker_names import least_markers
from solver_backend.body.markers import MARKER_OFFSET_M, ON_BONE, marker_landmarks, skin_normals
from solver_backend.exchange.errors import SubjectInvalid
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.model.subject import Subject
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.types import MarkerSubject, Motion


def record_of(
    subject: Subject, labels: tuple[str, ...], sigma_m: np.ndarray, provenance: dict[str, Any]
) -> MarkerSubject:
    """Return the record of a person whose landmarks are the markers of these labels."""
    places, offsets = subject.landmarks.names, to_numpy(subject.offsets)
    skin = MARKER_OFFSET_M + (skin_normals(subject.body, places) * offsets).sum(-1)
    on_bone = np.array([place.startswith(ON_BONE) or is_joint_centre(place) for place in places])
    return MarkerSubject(
        body=subject.body.id,
        betas=to_numpy(subject.betas),
        labels=labels,
        places=places,
        offsets=offsets,
        sigma_m=sigma_m,
        skin_m=np.where(on_bone, np.nan, skin),
        provenance={"solver": VERSION, **provenance},
    )


def person_of(motion: Motion) -> MarkerSubject | None:
    """Return the person of an earlier solve from markers; None where the motion has none."""
    if motion.offsets is None or motion.marker_labels is None or motion.layout is None or motion.marker_sigma is None:
        return None
    unknown = np.full(len(motion.marker_labels), np.nan)
    return MarkerSubject(
        motion.body, motion.betas, motion.marker_labels, motion.layout, motion.offsets, motion.marker_sigma, unknown
    )


def subject_of(record: MarkerSubject, body: Body, like: Array) -> Subject:
    """Return the person of a record, with its markers as landmarks.

    Raises:
        SubjectInvalid: the record is of another body, or a place is none.
    """
    if record.body != body.id:
        raise SubjectInvalid(
            f"The subject was calibrated on the body {record.body!r}, the solve is for {body.id!r}.", where="subject",
            hint="Solve with --body of the subject, or calibrate again on this body.",
        )  # fmt: skip
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
    found = [
        (m, columns[key])
        for m, label in enumerate(record.labels)
        if (key := label if label in columns else label_key(label)) in columns
    ]
    least = least_markers(record.places)
    if len(found) < least:
        raise SubjectInvalid(
            f"Only {len(found)} of the subject's {len(record.labels)} markers are in the take; {least} are "
            "needed.", where="subject", hint="Choose the subject of this person and layout, or calibrate on the take.",
        )  # fmt: skip
    kept = [m for m, _ in found]
    part = MarkerSubject(
        record.body, record.betas, tuple(labels[i] for _, i in found), tuple(record.places[m] for m in kept),
        record.offsets[kept], record.sigma_m[kept], record.skin_m[kept], record.provenance,
    )  # fmt: skip
    return part, [i for _, i in found]
