"""What is done for a person who is known: how close keys stand, and which passes are made."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.fitters.keyframes.key_density import closer_window, paces
from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.keyframes.posterior import keypoint_constant_m, marker_constant_m
from solver_backend.fitters.keyframes.turned_keys import LOOSENESS
from solver_backend.fitters.marker_calibration.rough_motion import RATE_HZ
from solver_backend.fitters.problem import REFERENCE_FPS, Problem
from solver_backend.fitters.settings import SolveSettings

CALM_M_S2, CLOSEST = 4.0, 0.4
"""Mean acceleration of markers up to which the settings' window holds, and the least share of it, which runners reach:
markers err by less than what keypoints need wider windows for. At 7 m/s knees bend by 3.2 degrees RMS from OpenSim's
with 0.4 times the window, 5.7 with all of it."""
NEAR_M = 0.01
"""A body between two frames of a rough motion is off by ``a h² / 8``; where that is less for all but the fastest
twentieth of the markers, no pass has to come near."""


@dataclass(frozen=True)
class KnownPersonPlan:
    """Which passes are made, and on what."""

    window: int
    """Frames of a window."""
    first: Schedule | None
    """Of the pass on the prior's manifold; None where the take starts near enough."""
    second: Schedule
    """Of the pass off it: codes stay, see ``turned_keys``."""
    drawing: Schedule
    """Around markers that the second left far behind, which draw at its first scale."""
    stride: int
    """Every so many frames are looked at between the passes."""
    covariance_stride: int
    """Covariances of every so many frames are formed."""
    calibrated: bool
    """The person was calibrated from markers: what does not average out is what that leaves."""
    looseness: float = LOOSENESS
    """How far joints may leave the manifold, in the prior's own deviations."""

    def constant_m(self, layout: BodyLayout) -> np.ndarray:
        """Return (J,) standard deviations per axis of what does not average out at each joint, metres."""
        return marker_constant_m(layout) if self.calibrated else keypoint_constant_m(layout)

    @classmethod
    def of(cls, problem: Problem, settings: SolveSettings) -> KnownPersonPlan:
        """Return the plan of a problem whose person is known."""
        scale, steps, usual = settings.robust_scale, settings.iterations, problem.frames_of(settings.refine_window)
        measured, stride = problem.measurements, problem.frames_of(1, 1)
        rate = problem.fps / stride
        apart = max(1, round(0.5 * settings.refine_window * rate / REFERENCE_FPS))
        mean, fastest = paces(measured.points[::stride], rate, apart)
        window = closer_window(usual, mean, CALM_M_S2, CLOSEST)
        near = measured.rough is not None and fastest / (8 * RATE_HZ**2) < NEAR_M
        # Markers are exact: five frames or so between two keys tell what all of them do, and three are near enough.
        third, second = max(1, round(0.3 * window)), max(1, round(0.2 * window))
        first = None if near else Schedule((2 * scale,), min(3, steps), third, 3e-2, hessian_frames=3)
        last = Schedule((scale,), steps, second, 1e-2)
        drawing = replace(last, scales=(4 * scale, scale))
        return cls(window, first, last, drawing, stride, problem.frames_of(4, 1), measured.marker_sigma is not None)
