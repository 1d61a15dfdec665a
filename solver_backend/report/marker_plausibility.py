"""What a solve of markers shows of itself: how far the body is from them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.geometry.quantiles import quantile
from solver_backend.types import Motion

FAR_MM, CENTRES_FAR_MM = 10.0, 30.0
"""Median residual of markers and of joint centres that is doubted: 60 recordings of other laboratories have 0.1 to 5
(7 where a network named the points), 3D keypoints of networks up to 25."""
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
