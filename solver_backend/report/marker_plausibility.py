"""What a solve of markers shows of itself: how far the body is from them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.geometry.quantiles import quantile
from solver_backend.geometry.runs import true_runs
from solver_backend.types import MARKER_GHOST, Motion

FAR_MM, CENTRES_FAR_MM = 10.0, 30.0
"""Median residual of markers and of joint centres that is doubted: 60 recordings of other laboratories have 0.1 to 5
(7 where a network named the points), 3D keypoints of networks up to 25."""
ALWAYS_MM, WHILE_MM, WHILE_S = 20.0, 50.0, 0.3
"""Median residual of one marker, and that of some frames and how long these last, from which on its label or place is
doubted: of 60 recordings those that look right have medians up to 19, and 50 for 0.24 s at most."""
STANDS_OUT = 2.0
"""A marker that is far stands out where its residual is so many times the take's."""
USELESS = 5.0
"""So many times as far is a result useless."""


def marker_plausibility(motion: Motion) -> Iterator[Diagnostic]:
    """Yield what makes a solve of markers doubtful or useless."""
    places, error = motion.provenance.get("markers"), motion.marker_residual_mm
    if error is None or motion.marker_labels is None or not isinstance(places, list):
        return
    centres = any(is_joint_centre(str(place)) for place in places)
    size, limit = float(quantile(error[np.isfinite(error)], 0.5, axis=0)), CENTRES_FAR_MM if centres else FAR_MM
    if size > limit:
        code = "markers_impossible" if size > USELESS * limit else "markers_far"
        yield diagnostic(code, size=size, limit=limit, kind="joint centres" if centres else "markers")
    yield from _far_markers(motion, size, limit / FAR_MM)


def _far_markers(motion: Motion, usual: float, scale: float) -> Iterator[Diagnostic]:
    """Yield which markers are far from where the body has them, always or for a while.

    Args:
        motion: solved from markers.
        usual: median residual of the take, millimetres.
        scale: of the limits.
    """
    assert motion.marker_residual_mm is not None and motion.marker_labels is not None
    thrown_out = 0 if motion.marker_flags is None else motion.marker_flags & MARKER_GHOST
    error = np.where(thrown_out, np.nan, motion.marker_residual_mm)
    always, least = quantile(error, 0.5, axis=0), max(scale * ALWAYS_MM, STANDS_OUT * usual)
    for m in np.argsort(-np.nan_to_num(always)):
        label, far = motion.marker_labels[int(m)], np.nan_to_num(error[:, m]) > scale * WHILE_MM
        if always[m] > least:
            yield diagnostic("marker_far", markers=[label], size=always[m])
        elif runs := [run for run in true_runs(far) if run[1] + 1 - run[0] >= WHILE_S * motion.fps]:
            largest = max(float(np.nanmax(error[a : b + 1, m])) for a, b in runs)
            yield diagnostic("marker_far_for_a_while", markers=[label], frames=runs, size=largest)
