"""Whether all focal lengths are off alike: by the factor under which the views agree best.

A zoom that moved, or a mode of the cameras that crops, makes every focal length wrong by one factor. The views still
nearly agree, on somebody of another size elsewhere. What shows it is that they agree better with other focal lengths.
"""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.view_checks.epipolar_fit import ComparedViews
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.types import Cameras, Keypoints2D

OFF = 0.05
"""Logarithm of a factor from which it is a finding."""
SIGMAS = 3.5
"""Standard deviations from which it is: right lenses reach 2.5 in ten simulated takes, the demo and recorded takes;
those of nine in ten simulated takes that are calibrated 10 % too long, 3.9."""


def report_focal_lengths(
    cameras: Cameras, keypoints: Keypoints2D, views: ComparedViews | None = None
) -> tuple[Diagnostic, ...]:
    """Return the warning that all focal lengths seem too long or too short, () where the views do not clearly show it.

    Args:
        cameras: C cameras in any unit.
        keypoints: of one person in the same views.
        views: what is compared of both, where it is known.
    """
    views = views or ComparedViews.of(cameras, keypoints)
    fit = None if views is None else views.fit
    if fit is None or not fit.is_calibrated or abs(fit.log) < max(OFF, SIGMAS * fit.sigma):
        return ()
    way, percent = "short" if fit.log > 0 else "long", 100 * abs(np.exp(-fit.log) - 1)
    return (diagnostic("focal_lengths_off", cameras=cameras.names, percent=percent, way=way),)
