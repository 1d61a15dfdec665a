"""Hands of a take's person, looked for where the body has its wrists, on the way from videos to a motion."""

from __future__ import annotations

from pathlib import Path

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.progress import Progress
from solver_backend.types import Capture
from solver_backend.videos.detect.choice import DetectorChoice
from solver_backend.videos.detect.find_hands import find_hands, seen_by


def with_hands(capture: Capture, detector: DetectorChoice | None, progress: Progress) -> Capture:
    """Return the capture with the hands that a detector finds; as it is without one.

    Args:
        capture: put together from the videos.
        detector: of hands in crops, or None.
        progress: called with the pictures that are done.

    Raises:
        MocapError: see ``find_hands``.
    """
    if detector is None:
        return capture
    return find_hands(capture, detector, progress)


def hands_found(capture: Capture, detector: DetectorChoice | None) -> list[Diagnostic]:
    """Return in how many frames two views, or the only one, show the hands that were looked for."""
    if detector is None or capture.keypoints is None or capture.keypoints.hands is None:
        return []
    least, code = (1, "hands_found_one_view") if capture.is_one_view else (2, "hands_found")
    shares = seen_by(capture, least)
    return [diagnostic(code, left=shares["left"], right=shares["right"])]


def made_of_hands(detector: DetectorChoice | None) -> list[str]:
    """Return what a capture with hands is made of besides: a model, which another file replaces."""
    if detector is None:
        return []
    model = Path(str(detector.options["model"]))
    return [f"hands by {model.name}, {model.stat().st_size} bytes"]
