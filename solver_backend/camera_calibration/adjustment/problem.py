"""What a bundle adjustment is given and gives: sightings, bodies, what is unknown, and the solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import PARAMETERS
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float, Int

CAMERA_PARAMETERS = 6 + PARAMETERS + 1
"""Rotation 3 (rad), translation 3 (m), the lens' 12 and the delay (s), of each camera."""


@dataclass(frozen=True)
class BodySightings:
    """N points of bodies in pictures."""

    camera: Int[np.ndarray, " n"]
    """(N,) which camera sees it."""
    body: Int[np.ndarray, " n"]
    """(N,) which body it belongs to."""
    local: Float[np.ndarray, "n 3"]
    """(N, 3) metres in the body's axes; zero for a point alone."""
    px: Float[np.ndarray, "n 2"]
    """(N, 2) where it is seen."""
    sigma: Float[np.ndarray, " n"]
    """(N,) px, standard deviation."""
    velocity: Float[np.ndarray, "n 2"] | None = None
    """(N, 2) px/s, how fast each moves in its picture; needed where delays are unknown."""

    def where(self, chosen: Bool[np.ndarray, " n"]) -> BodySightings:
        """Return the chosen ones."""
        velocity = None if self.velocity is None else self.velocity[chosen]
        return BodySightings(
            self.camera[chosen], self.body[chosen], self.local[chosen], self.px[chosen], self.sigma[chosen], velocity
        )


@dataclass(frozen=True)
class Bodies:
    """B bodies' poses, ``x_world = R x_local + t``."""

    R: Float[np.ndarray, "bodies 3 3"]
    """(B, 3, 3)."""
    t: Float[np.ndarray, "bodies 3"]
    """(B, 3) metres."""
    known: Float[np.ndarray, "bodies 3"] | None = None
    """(B, 3) metres, NaN where a body's place is not known beforehand."""
    known_sigma: float = 0.002
    """Metres, of the known places."""


@dataclass(frozen=True)
class Held:
    """Where C cameras are expected, by an earlier calibration."""

    cameras: Cameras
    """As they were calibrated."""
    turn_sigma: float
    """Radians."""
    centre_sigma_m: float
    """Metres."""

    def step_from(self, cameras: Cameras) -> Float[np.ndarray, "cameras 6"]:
        """Return (C, 6) the steps ``(ω, τ)`` that lead from the expected poses to these, in standard deviations."""
        turn = log_so3(cameras.R @ np.swapaxes(self.cameras.R, 1, 2))
        shift = -(cameras.R @ (cameras.centres - self.cameras.centres)[..., None])[..., 0]
        return np.concatenate([turn / self.turn_sigma, shift / self.centre_sigma_m], axis=1)

    @property
    def scale(self) -> Float[np.ndarray, " 6"]:
        """(6,) standard deviations of a step."""
        return np.repeat([self.turn_sigma, self.centre_sigma_m], 3)


@dataclass(frozen=True)
class Unknowns:
    """What is solved for beside the bodies."""

    poses: Bool[np.ndarray, " cameras"]
    """(C,) cameras whose pose is unknown."""
    lens: Bool[np.ndarray, "cameras 12"]
    """(C, 12) unknown numbers of each lens."""
    one_focal: bool = True
    """fx and fy of a camera change by one factor."""
    lens_sigma: Float[np.ndarray, "cameras 12"] | None = None
    """(C, 12) how far each number is expected from where it starts; None is anywhere."""
    delays: Bool[np.ndarray, " cameras"] | None = None
    """(C,) cameras whose delay against the others is unknown; None is no camera's."""
    held: Held | None = None
    """Poses that are known beforehand, where all are unknown; a camera far from its own is let go (Cauchy)."""


@dataclass(frozen=True)
class Adjusted:
    """The solution."""

    cameras: Cameras
    """With lenses and poses."""
    bodies: Bodies
    """Where the bodies are."""
    error: Float[np.ndarray, "n 2"]
    """(N, 2) px, projected minus seen; NaN behind a camera."""
    covariance: Float[np.ndarray, "numbers numbers"]
    """(19 C, 19 C) of ``CAMERA_PARAMETERS`` about the solution, the world's own freedom taken out."""
    steps: int
    """Taken."""
    delays: Float[np.ndarray, " cameras"]
    """(C,) seconds by which each camera's pictures are later than their frame's number states."""

    seen: BodySightings
    """What the errors are of."""

    @property
    def rmse_px(self) -> float:
        """Root of the mean squared distance."""
        return float(np.sqrt(np.nanmean((self.error**2).sum(-1))))
