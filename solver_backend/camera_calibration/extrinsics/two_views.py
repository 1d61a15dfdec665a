"""Estimate camera poses from two views, from known points, and along chains of camera pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TypeVar

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import CAMERA_PARAMETERS, Adjusted, Bodies, BodySightings
from solver_backend.camera_calibration.adjustment.lens import dlt_rows, homogeneous
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.rotations import log_so3
from solver_backend.geometry.small_matrices import unit
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float

HYPOTHESES, RESECTION_HYPOTHESES = 400, 300  # Number of random samples for an essential matrix, and for a resection.
COMPARED_POINTS = 600  # Maximum number of points on which samples are compared.
_REFINEMENTS, _RESECTION_REFINEMENTS = 6, 5  # Maximum number of reweighting rounds. Chosen by hand.
ImagePoints = Float[np.ndarray, "n 2"]  # Undistorted normalised coordinates.
Pose = tuple[np.ndarray, np.ndarray]  # Rotation (3, 3) and translation (3,).
Solution = TypeVar("Solution")


def _improved(
    best: Solution, refit: Callable[[Solution], Solution], cost: Callable[[Solution], float], rounds: int
) -> Solution:
    """Repeat a reweighted fit, starting from the previous solution, until the cost no longer decreases."""
    for _ in range(rounds):
        other = refit(best)
        if cost(other) >= cost(best):
            break
        best = other
    return best


def essential_matrix(
    first: ImagePoints, second: ImagePoints, scale: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "3 3"], Bool[np.ndarray, " n"]]:
    """Robustly estimate the essential matrix E in ``x2ᵀ E x1 = 0``. Also return a mask of inliers.

    Each random sample of eight points gives a candidate. The candidate with the lowest Cauchy penalty on the Sampson
    distances is refined.

    Args:
        first: at least eight points.
        second: the same points in the other view.
        scale: normalised distance above which a point loses weight.

    References: Hartley 1997, "In defense of the eight-point algorithm"; Torr and Zisserman 2000, "MLESAC"; Hartley and
    Zisserman 2004, eq. 11.9 (Sampson distance).
    """
    spread = float(np.sqrt((first**2).mean() + (second**2).mean()))
    rows = homogeneous(second / spread)[:, :, None] * homogeneous(first / spread)[:, None, :]
    rows = rows.reshape(-1, 9)
    picks = np.stack([rng.permutation(len(first))[:8] for _ in range(HYPOTHESES)])
    candidates = _essential(np.linalg.svd(rows[picks])[2][:, -1].reshape(-1, 3, 3), spread)
    compared = rng.permutation(len(first))[:COMPARED_POINTS]
    distance = sampson_distance(candidates, first[compared], second[compared])
    x1, x2 = homogeneous(first), homogeneous(second)

    def off(E: np.ndarray) -> np.ndarray:
        return sampson_distance(E[None], first, second)[0]

    def refit(E: np.ndarray) -> np.ndarray:
        slope = np.sqrt(((x1 @ E.T)[:, :2] ** 2).sum(-1) + ((x2 @ E)[:, :2] ** 2).sum(-1))
        weight = 1.0 / (1.0 + (off(E) / scale) ** 2) / np.maximum(slope, 1e-9)
        refined = np.linalg.svd(rows * weight[:, None], full_matrices=False)[2][-1].reshape(1, 3, 3)
        return _essential(refined, spread)[0]

    best = candidates[int(np.argmin(np.log1p((distance / scale) ** 2).sum(-1)))]
    best = _improved(best, refit, lambda E: float(np.log1p((off(E) / scale) ** 2).sum()), _REFINEMENTS)
    return best, off(best) < 3.0 * scale


def sampson_distance(
    E: Float[np.ndarray, "m 3 3"], first: ImagePoints, second: ImagePoints
) -> Float[np.ndarray, "m n"]:
    """Return the Sampson distances (m, n) of n point pairs for m essential matrices, in normalised coordinates.

    Reference: Hartley and Zisserman 2004, eq. 11.9.
    """
    x1, x2 = homogeneous(first), homogeneous(second)
    line2, line1 = x1 @ np.swapaxes(E, 1, 2), x2 @ E
    product = (line2 * x2).sum(-1)
    slope = (line2[..., :2] ** 2).sum(-1) + (line1[..., :2] ** 2).sum(-1)
    return np.abs(product) / np.sqrt(np.maximum(slope, 1e-18))


def pose_from_essential(
    E: Float[np.ndarray, "3 3"], first: ImagePoints, second: ImagePoints
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Return the second camera's rotation and unit translation, relative to the first camera.

    Of the four poses that E allows, the one with most points in front of both cameras is chosen.

    Reference: Hartley and Zisserman 2004, result 9.19.
    """
    U, _, Vt = np.linalg.svd(E)
    U, Vt = U * np.sign(np.linalg.det(U)), Vt * np.sign(np.linalg.det(Vt))
    W = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])
    best: tuple[int, np.ndarray, np.ndarray] = (-1, np.eye(3), U[:, 2])
    for R in (U @ W @ Vt, U @ W.T @ Vt):
        for t in (U[:, 2], -U[:, 2]):
            X = intersected(np.stack([np.eye(3), R]), np.stack([np.zeros(3), t]), np.stack([first, second]))
            before = int(((X[:, 2] > 0) & ((X @ R.T + t)[:, 2] > 0)).sum())
            if before > best[0]:
                best = before, R, t
    return best[1], best[2]


def intersected(
    R: Float[np.ndarray, "views 3 3"], t: Float[np.ndarray, "views 3"], xy: Float[np.ndarray, "views n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Triangulate n points. Each is the point closest to its viewing rays, or NaN if fewer than two views show it.

    Reference: Slabaugh, Schafer and Livingston 2001, "Optimal ray intersection".
    """
    seen = np.isfinite(xy).all(-1)
    ray = np.where(seen[..., None], homogeneous(np.nan_to_num(xy)), 0.0) @ R
    ray = unit(ray)
    along: np.ndarray = ray[..., None] * ray[..., None, :]
    across = np.subtract(np.eye(3), along) * seen[..., None, None]
    centre: np.ndarray = np.negative((np.swapaxes(R, 1, 2) @ t[..., None])[..., 0])
    A, b = across.sum(0), (across @ centre[:, None, :, None])[..., 0].sum(0)
    enough = (seen.sum(0) >= 2) & (np.abs(np.linalg.det(A)) > 1e-9)
    X = np.linalg.solve(np.where(enough[:, None, None], A, np.eye(3)), b[..., None])[..., 0]
    return np.where(enough[:, None], X, np.nan)


def point_bodies(
    cameras: Cameras, xy: np.ndarray, sigma: np.ndarray, known: np.ndarray | None = None
) -> tuple[Bodies, BodySightings, np.ndarray]:
    """Convert clicks or keypoints to single-point bodies and their sightings.

    A point is used if two cameras see it or its position is known. Also return the indices of the used points.

    Args:
        xy: (C, P, 2) points in px, NaN where not visible.
        sigma: (C, P) standard deviations in px.
        known: (P, 3) positions in metres, NaN where unknown.
    """
    located = intersected(cameras.R, cameras.t, undistort(cameras, xy))
    if known is not None:
        located = np.where(np.isfinite(known), known, located)
    used = np.isfinite(located).all(-1)
    camera, point = np.nonzero(np.isfinite(xy).all(-1) & used)
    number = np.cumsum(used) - 1
    seen = BodySightings(camera, number[point], np.zeros((len(point), 3)), xy[camera, point], sigma[camera, point])
    turns = np.tile(np.eye(3), (int(used.sum()), 1, 1))
    return Bodies(turns, located[used], None if known is None else known[used]), seen, np.flatnonzero(used)


def _essential(F: np.ndarray, spread: float) -> np.ndarray:
    """Return the essential matrices (m, 3, 3) nearest to the matrices F (m, 3, 3).

    F was estimated from normalised coordinates divided by ``spread``. The result applies to undivided coordinates.
    """
    scale = np.diag([1.0 / spread, 1.0 / spread, 1.0])
    U, _, Vt = np.linalg.svd(scale @ F @ scale)
    return U @ (np.array([1.0, 1.0, 0.0])[:, None] * Vt)


def resected_pose(
    points: Float[np.ndarray, "n 3"], xy: Float[np.ndarray, "n 2"], scale: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"], float]:
    """Robustly estimate a camera's pose from points with known positions (resection).

    Each random sample of six points gives a candidate by the direct linear transform. The candidate with the lowest
    Cauchy penalty is refined.

    Args:
        points: at least six points that do not lie in a plane.
        xy: normalised coordinates.
        scale: normalised distance above which a point loses weight.

    Returns:
        Rotation (3, 3), translation (3,), and the fraction of points with an error below three times ``scale``.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 7.1.
    """
    middle = points.mean(0)
    size = float(np.linalg.norm(points - middle, axis=1).mean())
    local = (points - middle) / size
    rows = dlt_rows(local, xy)
    picks = np.stack([rng.permutation(len(points))[:6] for _ in range(RESECTION_HYPOTHESES)])
    matrices = np.linalg.svd(rows[picks].reshape(RESECTION_HYPOTHESES, 12, 12))[2][:, -1].reshape(-1, 3, 4)

    def cost(pose: Pose) -> float:
        return float(np.log1p((_distance(pose, local, xy)[0] / scale) ** 2).sum())

    def refit(pose: Pose) -> Pose:
        distance, depth = _distance(pose, local, xy)
        weight = 1.0 / (1.0 + (distance / scale) ** 2) / np.maximum(depth, 1e-3)
        weighted = (rows * weight[:, None, None]).reshape(-1, 12)
        return _pose(np.linalg.svd(weighted, full_matrices=False)[2][-1].reshape(3, 4))

    R, t = best = _improved(min(map(_pose, matrices), key=cost), refit, cost, _RESECTION_REFINEMENTS)
    share = float((_distance(best, local, xy)[0] < 3.0 * scale).mean())
    return R, size * t - R @ middle, share


def _pose(P: np.ndarray) -> Pose:
    P = P * np.sign(np.linalg.det(P[:, :3]) or 1.0)
    scale = float(np.linalg.svd(P[:, :3])[1].mean())
    return np.asarray(nearest_rotation(P[:, :3])), P[:, 3] / max(scale, 1e-12)


def _distance(pose: Pose, points: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    camera = points @ pose[0].T + pose[1]
    depth = camera[:, 2]
    ahead = depth > 1e-6
    px = camera[:, :2] / np.where(ahead, depth, 1.0)[:, None]
    return np.where(ahead, np.linalg.norm(px - xy, axis=1), 1e3), np.abs(depth)


BOARD_REACH_M = 0.5  # Length in metres that is weighted like a rotation of one radian. Chosen by hand.


def composed(a: Pose, b: Pose) -> Pose:
    """Compose two poses: first b, then a."""
    return a[0] @ b[0], a[0] @ b[1] + a[1]


def inverted(a: Pose) -> Pose:
    """Return the inverse of a pose."""
    return a[0].T, -a[0].T @ a[1]


def relative_pose(first: Sequence[Pose], second: Sequence[Pose]) -> Pose:
    """Estimate the transform from the first to the second camera, given the board's poses in common frames.

    In each frame, the board's poses T in the two cameras give the candidate ``T_second T_first⁻¹``. Some
    candidates may be wrong, because a flat board may allow two poses in a frame. The candidate with the smallest median
    distance to the other candidates is returned.
    """
    proposals = [composed(b, inverted(a)) for a, b in zip(first, second, strict=True)]
    R, t = np.stack([p[0] for p in proposals]), np.stack([p[1] for p in proposals])
    turn = np.linalg.norm(log_so3(np.swapaxes(R, 1, 2)[:, None] @ R[None]), axis=-1)
    distance = BOARD_REACH_M * turn + np.linalg.norm(t[:, None] - t[None], axis=-1)
    return proposals[int(np.argmin(np.median(distance, axis=1)))]


Pair = Callable[[int, int, np.ndarray], tuple[Pose, int]]
"""Function of two cameras i and j and a mask of common frames. Returns the pose from i to j and its weight."""


def chained(names: Sequence[str], seen: np.ndarray, fewest: int, pair: Pair) -> list[Pose]:
    """Chain the relative poses of overlapping camera pairs. Return each camera's pose relative to the first.

    Args:
        seen: (C, F) mask of the frames that show the board or person in each camera.
        fewest: minimum number of frames that a usable pair has in common.
        pair: estimates the relative pose of two cameras (see ``Pair``).

    Reference: Prim 1957 (maximum spanning tree).
    """
    poses: dict[int, Pose] = {0: (np.eye(3), np.zeros(3))}
    both = {(i, j): seen[i] & seen[j] for i, j in combinations(range(len(names)), 2)}
    pairs = {(i, j): pair(i, j, common) for (i, j), common in both.items() if common.sum() >= fewest}
    while len(poses) < len(names):
        edges = [(n, i, j) for (i, j), (_, n) in pairs.items() if (i in poses) != (j in poses)]
        if not edges:
            inside = ", ".join(names[c] for c in sorted(poses))
            outside = ", ".join(name for c, name in enumerate(names) if c not in poses)
            message = f"The cameras {inside} never see the target at the same time as {outside}."
            raise CalibrationInvalid(message, hint="Film the target where both groups can see it at the same time.")
        _, i, j = max(edges)
        if i in poses:
            poses[j] = composed(pairs[i, j][0], poses[i])
        else:
            poses[i] = composed(inverted(pairs[i, j][0]), poses[j])
    return [poses[c] for c in range(len(names))]


@dataclass(frozen=True)
class CalibratedCameras:
    """C calibrated cameras in metres and with Z up, and the accuracy of the calibration."""

    cameras: Cameras
    method: str
    rmse_px: float
    camera_rmse_px: Float[np.ndarray, " cameras"]  # (C,) root mean square error of each camera.
    centre_sigma_m: Float[np.ndarray, " cameras"]  # (C,) standard deviation of each camera's centre in metres.
    turn_sigma: Float[np.ndarray, " cameras"]  # (C,) standard deviation of each direction in radians.
    delays_s: Float[np.ndarray, " cameras"]  # (C,) delay of each camera's frames in seconds.
    findings: tuple[Diagnostic, ...] = ()
    notes: tuple[Diagnostic, ...] = ()
    lenses: dict[str, dict[str, object]] = field(default_factory=dict)


def result_of(method: str, found: Adjusted, *, measured: bool = False) -> CalibratedCameras:
    """Convert an adjustment to a calibration. Its standard deviations come from the covariance.

    Args:
        measured: True if the standard deviations of the sightings were estimated from residuals. Otherwise, the
            covariance is scaled to match the residuals.
    """
    camera_of, noise_px = found.seen.camera, found.seen.sigma
    C = len(found.cameras)
    square = (np.nan_to_num(found.error) ** 2).sum(-1)
    inflation = float(np.median(square / noise_px**2)) / 1.386 if len(square) and not measured else 1.0
    blocks = found.covariance.reshape(C, CAMERA_PARAMETERS, C, CAMERA_PARAMETERS)[range(C), :, range(C)]
    variance = np.einsum("cii->ci", blocks) * max(inflation, 1e-6)
    of = [square[camera_of == c] for c in range(C)]
    by_camera = np.array([float(np.sqrt(part.mean())) if len(part) else np.nan for part in of])
    sigmas = np.sqrt(variance[:, 3:6].sum(-1)), np.sqrt(variance[:, :3].sum(-1))
    return CalibratedCameras(found.cameras, method, found.rmse_px, by_camera, *sigmas, found.delays)


def in_other_world(cameras: Cameras, R: np.ndarray, t: np.ndarray, scale: float = 1.0) -> Cameras:
    """Transform cameras to another world, ``x_new = scale R x_old + t``."""
    turned = cameras.R @ R.T
    return replace(cameras, R=turned, t=scale * cameras.t - (turned @ t[:, None])[..., 0])


def moved_world(calibration: CalibratedCameras, R: np.ndarray, t: np.ndarray, scale: float = 1.0) -> CalibratedCameras:
    """Transform a calibration to another world, ``x_new = scale R x_old + t``."""
    cameras = in_other_world(calibration.cameras, R, t, scale)
    return replace(calibration, cameras=cameras, centre_sigma_m=scale * calibration.centre_sigma_m)
