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
LEFT_SHARE = 0.3
"""Of the logarithm that must be left without any one camera: lenses that are all 10 to 25 % off leave 0.47 to 1.6 of it
in the demo; a camera that takes a poster for the person for a third of the take, when it is left out, -0.02."""


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
    if views is None or fit is None or not fit.is_calibrated or abs(fit.log) < max(OFF, SIGMAS * fit.sigma):
        return ()
    # One camera that saw somebody else spoils all its pairs.
    rest = [part.fit for part in views.without_one()]
    if not all(part is not None and part.log / fit.log > LEFT_SHARE for part in rest):
        return ()
    way, percent = "short" if fit.log > 0 else "long", 100 * abs(np.exp(-fit.log) - 1)
    return (diagnostic("focal_lengths_off", cameras=cameras.names, percent=percent, way=way),)
