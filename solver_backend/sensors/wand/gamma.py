"""Up, floor and origin by three markers on the floor that make a Γ: a long and a short edge at a right angle.

Seen from above, the long edge goes down from the corner and the short one to the right, as in the letter: up is their
cross product, long times short (paper, appendix K).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.camera_calibration.extrinsics.result import CalibratedCameras, moved_world
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import MocapError
from solver_backend.geometry.rotations import skew
from solver_backend.types.shapes import Float

LENGTH_TOLERANCE_M = 0.025
"""How far an edge may be off what was given, ..."""
ANGLE_TOLERANCE_DEG = 5.0
"""... and the corner off a right angle."""
LEAST_RATIO = 1.15
"""The long edge is this much longer than the short one."""
LEAST_FRAMES = 5
MOST_POINTS = 24
"""Points of a frame beyond which it is not searched: cover the lamps."""
FRAMES_PER_NEWS = 3.0
"""Frames with correlated errors: a sensor's noise on a marker that stands has some memory."""
SHARED_SIGMA_M = 0.5e-3
"""How far a marker is off in all frames together, of a well calibrated array."""
_ROUNDS = 20
"""Rounds at most; chosen by hand."""


class GammaNotFound(MocapError):
    """No three points are apart as the markers of the Γ are."""

    code = "gamma_not_found"


class GammaInvalid(MocapError):
    """The Γ's edges are too short, too long or too alike."""

    code = "gamma_invalid"


@dataclass(frozen=True)
class Gamma:
    """The three markers."""

    long_m: float = 0.6
    """The long edge, from the corner's middle to the end's."""
    short_m: float = 0.4
    """The short edge."""
    height_m: float = 0.007
    """How high the markers' middles lie above the floor: their radius where they lie on it."""

    def __post_init__(self) -> None:
        if not (self.short_m > 0.05 and self.long_m < 5.0 and -0.1 < self.height_m < 0.5):
            raise GammaInvalid(
                f"Edges of {self.long_m} and {self.short_m} m with markers {self.height_m} m high make no Γ.",
                hint="Edges of 0.05 to 5 m are possible, 0.6 and 0.4 are good; lengths are metres.",
            )
        if self.long_m < LEAST_RATIO * self.short_m:
            raise GammaInvalid(
                f"The long edge of {self.long_m} m and the short one of {self.short_m} m are too alike.",
                hint=f"The long one comes first and is longer by a factor of {LEAST_RATIO} at least.",
            )


@dataclass(frozen=True)
class Ground:
    """The move into a world with Z up, the floor at zero, the corner above the origin: ``x_new = R x_old + t``.

    X goes along the short edge, Y against the long one.
    """

    R: Float[np.ndarray, "3 3"]
    """(3, 3)."""
    t: Float[np.ndarray, " 3"]
    """(3,) metres."""
    tilt_sigma: float
    """Standard deviation of up, radians, along its worse direction."""
    markers: Float[np.ndarray, "3 3"]
    """(3, 3) metres in the old world: corner, the long edge's end, the short edge's end."""
    frames: int
    """Clouds in which the Γ was found."""
    findings: tuple[Diagnostic, ...] = ()
    """What is odd."""


def ground_from_gamma(
    clouds: Sequence[Float[np.ndarray, "points 3"]], gamma: Gamma, sensors: Float[np.ndarray, "sensors 3"]
) -> Ground:
    """Return up, floor and origin.

    Of each cloud the three points whose edges and angle are nearest to the Γ's are taken; their places are averaged
    robustly; up is ``u × v / |u × v|`` of the edges u (long) and v (short), its covariance that of both edges. A Γ that
    was laid down mirrored follows from the sensors, which stand above the floor.

    Args:
        clouds: points of each moment, of one sensor or of all, metres; anything else may be among them.
        gamma: its edges.
        sensors: (C, 3) where the sensors stand, in the same world.

    Raises:
        GammaNotFound: in too few clouds; the message states what was seen.
    """
    padded = _padded(clouds)
    found, triples = _triples(padded, gamma)
    if found.sum() < LEAST_FRAMES:
        most = max((len(cloud) for cloud in clouds), default=0)
        raise GammaNotFound(
            f"Three markers {gamma.long_m:.3f} and {gamma.short_m:.3f} m from a corner are found at "
            f"{int(found.sum())} of {len(clouds)} moments; the moments have up to {most} points.",
            hint="Lay the Γ where two sensors see all three, measure its edges, and give them: --gamma-lengths 0.6 0.4",
        )  # fmt: skip
    places, covariance = _averaged(triples[found])
    corner, u, v = places[0], places[1] - places[0], places[2] - places[0]
    w = np.cross(u, v)
    up = w / np.linalg.norm(w)
    above = float(np.mean((sensors - corner) @ up > 0))
    mirrored: tuple[Diagnostic, ...] = ()
    if above < 0.5:
        up = -up
        mirrored = (diagnostic("gamma_mirrored"),)
    x = v - (v @ up) * up
    x = x / np.linalg.norm(x)
    R = np.stack([x, np.cross(up, x), up])
    sigma = _tilt_sigma(u, v, covariance)
    return Ground(R, -R @ corner + np.array([0, 0, gamma.height_m]), sigma, places, int(found.sum()), mirrored)


def on_ground(calibration: CalibratedCameras, ground: Ground) -> CalibratedCameras:
    """Return the calibration in the world of a Γ."""
    return moved_world(calibration, ground.R, ground.t)


def _padded(clouds: Sequence[np.ndarray]) -> np.ndarray:
    """Return (F, N, 3) clouds filled up with NaN; those of too many points are empty."""
    sizes = [len(cloud) if len(cloud) <= MOST_POINTS else 0 for cloud in clouds]
    padded = np.full((len(clouds), max(sizes, default=0), 3), np.nan)
    for f, size in enumerate(sizes):
        padded[f, :size] = clouds[f][:size]
    return padded


def _triples(clouds: np.ndarray, gamma: Gamma) -> tuple[np.ndarray, np.ndarray]:
    """Return whether each cloud has a Γ, (F,), and its corner, long and short end, (F, 3, 3)."""
    F, N, _ = clouds.shape
    found, triples = np.zeros(F, bool), np.full((F, 3, 3), np.nan)
    if N < 3:
        return found, triples
    cosine = np.sin(np.radians(ANGLE_TOLERANCE_DEG))
    # One corner at a time: all of them at once would take N times the room.
    best = np.full(F, np.inf)
    for corner in range(N):
        arm = clouds - clouds[:, corner : corner + 1]
        length = np.linalg.norm(arm, axis=-1)
        long_off = np.abs(length - gamma.long_m) / LENGTH_TOLERANCE_M
        short_off = np.abs(length - gamma.short_m) / LENGTH_TOLERANCE_M
        turn = np.einsum("fik,fjk->fij", arm, arm) / np.maximum(length[:, :, None] * length[:, None], 1e-9)
        off = np.maximum(long_off[:, :, None], short_off[:, None])
        off = np.maximum(off, np.abs(turn) / cosine)
        off = np.where(np.isfinite(off), off, np.inf).reshape(F, -1)
        pick = off.argmin(axis=1)
        value = off[np.arange(F), pick]
        better = value < np.minimum(best, 1.0)
        at = np.flatnonzero(better)
        triples[at] = np.stack([clouds[at, corner], clouds[at, pick[at] // N], clouds[at, pick[at] % N]], axis=1)
        best[at] = value[at]
    return np.isfinite(best), triples


def _averaged(triples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the robust mean (3, 3) of three markers' places (F, 3, 3) and the covariance of each mean, (3, 3, 3)."""
    mean = np.median(triples, axis=0)
    spread = np.maximum(1.4826 * np.median(np.linalg.norm(triples - mean, axis=-1), axis=0) / 1.54, 1e-5)
    weight = np.ones(triples.shape[:2])
    for _ in range(_ROUNDS):
        square = ((triples - mean) ** 2).sum(-1) / spread**2
        weight = 1.0 / (1.0 + square / 9.0)
        mean = (weight[..., None] * triples).sum(0) / weight.sum(0)[:, None]
    off = triples - mean
    scatter = np.einsum("fm,fmi,fmj->mij", weight, off, off) / weight.sum(0)[:, None, None]
    return mean, scatter * FRAMES_PER_NEWS / len(triples) + SHARED_SIGMA_M**2 * np.eye(3)


def _tilt_sigma(u: np.ndarray, v: np.ndarray, covariance: np.ndarray) -> float:
    """Return the deviation of ``u × v``'s direction, radians: ``d(u × v) = [u]ₓ dv - [v]ₓ du``."""
    w = np.cross(u, v)
    by_marker = (skew(v) - skew(u), -skew(v), skew(u))
    total = sum(J @ S @ J.T for J, S in zip(by_marker, covariance, strict=True))
    n = w / np.linalg.norm(w)
    across = np.eye(3) - np.outer(n, n)
    return float(np.sqrt(np.linalg.eigvalsh(across @ np.asarray(total) @ across)[-1]) / np.linalg.norm(w))
