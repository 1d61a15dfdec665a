"""Whether detections were made in pictures without their lenses' distortion, which the calibration still has.

Programs that undistort videos first detect in pictures of another lens than the one that was calibrated. The views then
nearly agree, most in the middle of the pictures. What shows it is that they agree better without the distortion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.cameras.view_checks.epipolar_fit import ComparedViews, fit_epipolar
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.types import Cameras, Keypoints2D

GAIN = 8.0
"""Twice the logarithm of how much likelier the views are without distortion, from which it is a finding: five recorded
takes and the demo with lenses of k1 from -0.32 to 0.2 reach 4.7 where they are right. Undistorted they reach 9 to 33
where somebody walks to the edge of pictures that bend by 9 px there; of somebody in the middle, moved by 1 to 2
px where detectors are off by 5, nothing shows."""
LEFT_SHARE = 0.1
"""Of the gain that must be left in the mean without one camera: undistorted pixels leave 0.22 to 0.4 (four cameras), a
camera that follows somebody who crosses -0.03."""


def report_undistorted(
    cameras: Cameras, keypoints: Keypoints2D, views: ComparedViews | None = None
) -> tuple[Diagnostic, ...]:
    """Return the warning that pixels seem to be undistorted, () where the views do not clearly show it.

    Args:
        cameras: C cameras in any unit.
        keypoints: of one person in the same views.
        views: what is compared of both, where it is known.
    """
    if not cameras.distortion.any() and cameras.distortion_model == "opencv":
        return ()
    views = views or ComparedViews.of(cameras, keypoints)
    if views is None:
        return ()
    gain, rest = _gain(views), views.without_one()
    if gain < GAIN or (rest and np.mean([_gain(part) for part in rest]) < LEFT_SHARE * gain):
        return ()
    return (diagnostic("pixels_undistorted", cameras=cameras.names),)


def _gain(views: ComparedViews) -> float:
    """Return twice the logarithm of how much likelier the views are without distortion; 0 where that is unknown."""
    chosen = views.cameras
    without = replace(chosen, distortion=np.zeros_like(chosen.distortion), distortion_model="opencv")
    fits = views.fit, fit_epipolar(without, views.xy)
    if fits[0] is None or fits[1] is None or not fits[1].is_calibrated:
        return 0.0
    spread = max(fits[0].spread_px, fits[1].spread_px)
    return fits[0].misfit(spread) - fits[1].misfit(spread)
