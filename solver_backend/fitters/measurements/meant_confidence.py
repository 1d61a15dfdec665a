"""Keypoints weighed by what their detector's confidence means, where a noise map states it."""

from __future__ import annotations

from dataclasses import replace

from solver_backend.cameras.noise_map import detector_of, is_applied, read_noise_map
from solver_backend.exchange.errors import JobInvalid
from solver_backend.types import Capture


def with_meant_confidence(capture: Capture, path: str) -> Capture:
    """Return the capture with its confidences read by a noise map, and a note that reports it.

    Args:
        capture: keypoints of one person.
        path: file of the noise map; empty leaves the capture as it is.

    Raises:
        JobInvalid: the capture has no keypoints, or its confidences were weighted before.
        FileMissing, FileDamaged: the noise map is not there, or is none.
    """
    if not path:
        return capture
    noise = read_noise_map(path)
    if capture.keypoints is None:
        raise JobInvalid(
            "A noise map is for a detector's confidences, and the capture has no keypoints.",
            where=capture.name, hint="Leave out --noise for recordings of markers.",
        )  # fmt: skip
    if is_applied(capture.notes):
        raise JobInvalid(
            "The capture's confidences were weighted by a noise map when it was written.",
            where=capture.name, hint="Leave out --noise here, or detect again without it.",
        )  # fmt: skip
    detector = detector_of(capture.notes) or noise.detector
    keypoints, note = noise.applied(capture.keypoints, detector)
    return replace(capture, keypoints=keypoints, notes=(*capture.notes, note))
