"""Captures and settings that solve in a moment."""

from __future__ import annotations

from dataclasses import replace

from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.types import Capture

QUICK = SolveSettings(iterations=4)


def cut(capture: Capture, start: int, stop: int) -> Capture:
    """Return frames ``start .. stop - 1`` of a capture and of its truth."""
    assert capture.keypoints is not None
    truth = {k: v if k == "betas" else v[start:stop] for k, v in capture.truth.items()}
    return replace(capture, keypoints=capture.keypoints.frames(start, stop), truth=truth)
