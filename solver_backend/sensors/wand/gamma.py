"""Find the up axis, floor and origin from a Γ of three markers on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.extrinsics.two_views import intersected
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationMismatch, FileMissing, MocapError
from solver_backend.geometry.rotations import skew
from solver_backend.sensors.wand.views import points_files, read_table
from solver_backend.types import Cameras
from solver_backend.types.shapes import Float

LENGTH_TOLERANCE_M = 0.025  # Largest difference between the length of an edge and its given length, in metres.
ANGLE_TOLERANCE_DEG = 5.0  # Largest deviation of the corner from a right angle.
LEAST_RATIO = 1.15  # Smallest ratio between the long and the short edge.
LEAST_FRAMES = 5  # Minimum number of frames with the Γ. Chosen by hand.
MOST_POINTS = 24  # Maximum number of points in a frame. Frames with more, for example because of lamps, are skipped.
FRAMES_PER_NEWS = 3.0  # Number of consecutive frames whose errors are correlated. Chosen by hand.
SHARED_SIGMA_M = 0.5e-3  # Marker error in metres that does not average out, in a well calibrated array.
_ROUNDS = 20  # Maximum number of iterations. Chosen by hand.


class GammaNotFound(MocapError):
    """No three points match the marker distances of the Γ."""


class GammaInvalid(MocapError):
    """The edges of the Γ are too short, too long, or too similar."""


@dataclass(frozen=True)
class Gamma:
    """A Γ of three markers: a right angle with a long and a short edge."""

    long_m: float = 0.6  # Distance in metres between the marker centres on the long edge.
    short_m: float = 0.4
    height_m: float = 0.007  # Height of the marker centres above the floor in metres: their radius if they lie on it.

    def __post_init__(self) -> None:
        if not (self.short_m > 0.05 and self.long_m < 5.0 and -0.1 < self.height_m < 0.5):
            sizes = f"Edges of {self.long_m} and {self.short_m} m with markers {self.height_m} m high"
            message = f"{sizes} are not valid for a Γ."
            hint = "Use edges of 0.05 to 5 m, preferably 0.6 and 0.4 m. Specify lengths in metres."
            raise GammaInvalid(message, hint=hint)
        if self.long_m < LEAST_RATIO * self.short_m:
            message = f"The long edge of {self.long_m} m and the short one of {self.short_m} m are too similar."
            hint = f"Specify the long edge first. It must be at least {LEAST_RATIO} times as long."
            raise GammaInvalid(message, hint=hint)


@dataclass(frozen=True)
class Ground:
    """Transform ``x_new = R x_old + t`` to a world with Z up and the floor at zero height.

    X points along the short edge, and Y points opposite to the long edge.
    """

    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, " 3"]  # (3,) translation in metres.
    tilt_sigma: float  # Standard deviation of the up axis in radians, in its less certain direction.
    markers: Float[np.ndarray, "3 3"]
    """(3, 3) positions in metres in the old world: corner, end of the long edge, and end of the short edge."""
    frames: int
    findings: tuple[Diagnostic, ...] = ()


def ground_from_gamma(
    clouds: Sequence[Float[np.ndarray, "points 3"]], gamma: Gamma, sensors: Float[np.ndarray, "sensors 3"]
) -> Ground:
    """Compute the up axis, floor and origin from the robust mean of the points that match a Γ.

    Each cloud contains the (N, 3) points of one frame in metres, which may include points outside the Γ. Up is
    ``u × v / |u × v|`` for the long edge u and the short edge v. The sensors' positions (C, 3) reveal a mirrored Γ,
    because they must be above the floor.

    Raises:
        GammaNotFound: too few clouds contain the Γ.
    """
    padded = _padded(clouds)
    found, triples = _triples(padded, gamma)
    if found.sum() < LEAST_FRAMES:
        most = max((len(cloud) for cloud in clouds), default=0)
        raise GammaNotFound(
            f"The three markers of the Γ ({gamma.long_m:.3f} and {gamma.short_m:.3f} m) were found in only "
            f"{int(found.sum())} of {len(clouds)} frames, which have up to {most} points.",
            hint="Lay the Γ where two sensors see all three markers, and specify its edges (--gamma-lengths 0.6 0.4).",
        )
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


def _padded(clouds: Sequence[np.ndarray]) -> np.ndarray:
    sizes = [len(cloud) if len(cloud) <= MOST_POINTS else 0 for cloud in clouds]
    padded = np.full((len(clouds), max(sizes, default=0), 3), np.nan)
    for f, size in enumerate(sizes):
        padded[f, :size] = clouds[f][:size]
    return padded


def _triples(clouds: np.ndarray, gamma: Gamma) -> tuple[np.ndarray, np.ndarray]:
    """Return the (F,) mask of clouds with a Γ, and the (F, 3, 3) corner, long end and short end of the Γ."""
    F, N, _ = clouds.shape
    found, triples = np.zeros(F, bool), np.full((F, 3, 3), np.nan)
    if N < 3:
        return found, triples
    cosine = np.sin(np.radians(ANGLE_TOLERANCE_DEG))
    # Process one corner at a time, because all corners at once would need N times the memory.
    best = np.full(F, np.inf)
    for corner in range(N):
        arm = clouds - clouds[:, corner : corner + 1]
        length = np.linalg.norm(arm, axis=-1)
        long_off = np.abs(length - gamma.long_m) / LENGTH_TOLERANCE_M
        short_off = np.abs(length - gamma.short_m) / LENGTH_TOLERANCE_M
        turn = np.einsum("fik,fjk->fij", arm, arm) / np.maximum(length[:, :, None] * length[:, None], 1e-9)
        off = np.maximum(np.maximum(long_off[:, :, None], short_off[:, None]), np.abs(turn) / cosine)
        off = np.where(np.isfinite(off), off, np.inf).reshape(F, -1)
        pick = off.argmin(axis=1)
        value = off[np.arange(F), pick]
        better = value < np.minimum(best, 1.0)
        at = np.flatnonzero(better)
        triples[at] = np.stack([clouds[at, corner], clouds[at, pick[at] // N], clouds[at, pick[at] % N]], axis=1)
        best[at] = value[at]
    return np.isfinite(best), triples


def _averaged(triples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the robust means (3, 3) of three marker positions over F frames (F, 3, 3), and their covariances."""
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
    """Return the standard deviation of the direction of ``u × v`` in radians."""
    w = np.cross(u, v)
    by_marker = (skew(v) - skew(u), -skew(v), skew(u))
    total = sum(J @ S @ J.T for J, S in zip(by_marker, covariance, strict=True))
    n = w / np.linalg.norm(w)
    across = np.eye(3) - np.outer(n, n)
    return float(np.sqrt(np.linalg.eigvalsh(across @ np.asarray(total) @ across)[-1]) / np.linalg.norm(w))


MEETING_PX = 4.0  # Largest reprojection error in pixels of the midpoint of two intersecting camera rays.
MOST_MOMENTS = 300  # Maximum number of frames used, spread over the recording.


def gamma_clouds(folder: Path, cameras: Cameras) -> list[np.ndarray]:
    """Read the tables of a Γ recording as point clouds, one per frame, in the cameras' world in metres.

    A cloud contains the points that one sensor saw with depth, or all intersections between the rays of two cameras.
    Most of these intersections are false. The edge lengths of the Γ select the true intersections.

    Raises:
        FileMissing, CalibrationMismatch: there is no table, or the calibration does not contain the sensor.
    """
    files = points_files(folder)
    if not files:
        raise FileMissing("The folder has no Γ table (.csv). Choose a recording of the Γ.", where=str(folder))
    unknown = [path.stem for path in files if path.stem not in cameras.names]
    if unknown:
        raise CalibrationMismatch(
            f"{', '.join(unknown)} saw the Γ, but only {', '.join(cameras.names)} saw the wand.", where=str(folder)
        )
    clouds: list[np.ndarray] = []
    lights: dict[int, np.ndarray] = {}
    for path in files:
        table, with_depth = read_table(path)
        camera = cameras.names.index(path.stem)
        if with_depth:
            clouds += _depth_clouds(cameras, camera, table[:, 0], table[:, 1:3], 1e-3 * table[:, 3])
        else:
            lights[camera] = table
    return clouds + _meetings(cameras, lights)


def _depth_clouds(
    cameras: Cameras, camera: int, times: np.ndarray, px: np.ndarray, depth_m: np.ndarray
) -> list[np.ndarray]:
    """Return the (N, 3) points in metres that one sensor saw in each frame.

    Each row contains a time, a pixel and a depth along the axis in metres. Rows with equal times belong to one frame.
    Rows without a positive depth are skipped.
    """
    known = np.isfinite(px).all(1) & (px >= 0).all(1) & (depth_m > 0)
    times, px, depth_m = times[known], px[known], depth_m[known]
    one = cameras.subset([camera])
    flat = undistort(one, px[None])[0]
    ray = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
    points = (ray * depth_m[:, None] - one.t[0]) @ one.R[0]
    starts = np.flatnonzero(np.r_[True, np.diff(times) != 0])[1:] if len(times) else []
    return _spread([part for part in np.split(points, starts) if len(part) >= 3])


def _meetings(cameras: Cameras, lights: dict[int, np.ndarray]) -> list[np.ndarray]:
    """Intersect the rays of each camera pair at common times. Return up to nine points (N, 3) per pair and time."""
    clouds: list[np.ndarray] = []
    for a, b in combinations(sorted(lights), 2):
        times, first, second = np.intersect1d(lights[a][:, 0], lights[b][:, 0], return_indices=True)
        if len(times):
            rows = np.stack([lights[a][first, 1:], lights[b][second, 1:]]).reshape(2, -1, 3, 2)
            clouds += _of_pair(cameras.subset([a, b]), np.where((rows < 0).any(-1, keepdims=True), np.nan, rows))
    return _spread(clouds)


def _of_pair(pair: Cameras, px: np.ndarray) -> list[np.ndarray]:
    """Intersect each ray of the first camera with each ray of the second, given (2, F, 3, 2) pixels."""
    flat = undistort(pair, px)
    i, j = (grid.ravel() for grid in np.meshgrid(range(3), range(3), indexing="ij"))
    both = np.stack([flat[0][:, i], flat[1][:, j]])
    at = intersected(pair.R, pair.t, both.reshape(2, -1, 2)).reshape(*both.shape[1:3], 3)
    local = np.einsum("cij,fnj->cfni", pair.R, at) + pair.t[:, None, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.abs(local[..., :2] / local[..., 2:] - both).max(-1) * pair.K[:, 0, 0][:, None, None]
        good = (off < MEETING_PX).all(0) & (local[..., 2] > 0).all(0)
    return [points[keep] for points, keep in zip(at, good, strict=True) if keep.sum() >= 3]


def _spread(clouds: Sequence[np.ndarray]) -> list[np.ndarray]:
    if len(clouds) <= MOST_MOMENTS:
        return list(clouds)
    return [clouds[i] for i in np.linspace(0, len(clouds) - 1, MOST_MOMENTS).astype(int)]
