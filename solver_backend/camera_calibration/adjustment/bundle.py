"""Adjust lens parameters, camera poses, boards and points jointly by Levenberg-Marquardt.

Reference: Triggs et al. 2000, "Bundle adjustment: a modern synthesis", sec. 6.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import PARAMETERS, moved, pixels_of, project_local
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.arrays import Rows
from solver_backend.geometry.rotations import exp_so3, log_so3, skew
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float, Int

CAMERA_PARAMETERS = 6 + PARAMETERS + 1
"""Unknowns of a camera: rotation (3, rad), translation (3, m), the lens ``PARAMETERS`` and its delay (s)."""
PLACE_SIGMA_M = 0.003  # Standard deviation of a measured position, in metres.


@dataclass(frozen=True)
class BodySightings(Rows):
    """N observations of points in camera images. A body is a board with many points, or a single point."""

    camera: Int[np.ndarray, " n"]  # (N,) index of the camera.
    body: Int[np.ndarray, " n"]  # (N,) index of the body.
    local: Float[np.ndarray, "n 3"]  # (N, 3) positions in metres in the body's axes. Zero for a single point.
    px: Float[np.ndarray, "n 2"]  # (N, 2) pixels.
    sigma: Float[np.ndarray, " n"]  # (N,) standard deviation in pixels.
    velocity: Float[np.ndarray, "n 2"] | None = None  # (N, 2) image velocities in px/s, needed to estimate delays.


@dataclass(frozen=True)
class Bodies(Rows):
    """Poses of B bodies (boards or single points), ``x_world = R x_local + t``."""

    R: Float[np.ndarray, "bodies 3 3"]
    t: Float[np.ndarray, "bodies 3"]  # (B, 3) translations in metres.
    known: Float[np.ndarray, "bodies 3"] | None = None  # (B, 3) measured positions in metres, NaN where unknown.


@dataclass(frozen=True)
class Held:
    """Expected poses of C cameras from an earlier calibration, with their standard deviations."""

    cameras: Cameras
    turn_sigma: float
    centre_sigma_m: float

    def step_from(self, cameras: Cameras) -> Float[np.ndarray, "cameras 6"]:
        """Return how far cameras are rotated and shifted (C, 6) from their expected poses, in standard deviations."""
        turn = log_so3(cameras.R @ np.swapaxes(self.cameras.R, 1, 2))
        moved: np.ndarray = cameras.R @ (cameras.centres - self.cameras.centres)[..., None]
        shift = -moved[..., 0]
        return np.concatenate([turn / self.turn_sigma, shift / self.centre_sigma_m], axis=1)

    @property
    def scale(self) -> Float[np.ndarray, " 6"]:
        """(6,) standard deviations of the expected poses: rotation vector (rad), then translation (m)."""
        return np.repeat([self.turn_sigma, self.centre_sigma_m], 3)


@dataclass(frozen=True)
class Unknowns:
    """The camera parameters that an adjustment estimates, and their priors."""

    poses: Bool[np.ndarray, " cameras"]  # (C,) mask of the cameras whose poses are unknown.
    lens: Bool[np.ndarray, "cameras 12"] | None = None
    """(C, 12) mask of the unknown parameters of each lens, None if all are fixed. The ratio of fx to fy is constant."""
    lens_sigma: Float[np.ndarray, "cameras 12"] | None = None  # (C, 12) prior standard deviations. None for no prior.
    delays: Bool[np.ndarray, " cameras"] | None = None  # (C,) mask of cameras with unknown delays. None for no camera.
    held: Held | None = None  # Expected poses. A Cauchy penalty lets cameras leave them.


@dataclass(frozen=True)
class Adjusted:
    """Cameras and bodies after the adjustment, and the remaining reprojection errors."""

    cameras: Cameras
    bodies: Bodies
    error: Float[np.ndarray, "n 2"]  # (N, 2) projected minus observed px. NaN behind a camera.
    covariance: Float[np.ndarray, "numbers numbers"]  # (19 C, 19 C) over ``CAMERA_PARAMETERS``, in a fixed world.
    delays: Float[np.ndarray, " cameras"]  # (C,) delay of each camera's images in seconds.
    seen: BodySightings

    @property
    def rmse_px(self) -> float:
        """Root mean square reprojection error in pixels."""
        return float(np.sqrt(np.nanmean((self.error**2).sum(-1))))


def median_by_camera(far: Float[np.ndarray, " n"], seen: BodySightings, count: int) -> Float[np.ndarray, " cameras"]:
    """Return the median of the errors ``far`` (N,) for each camera, or NaN for a camera without known errors."""
    parts = (far[(seen.camera == c) & ~np.isnan(far)] for c in range(count))
    return np.array([np.median(part) if len(part) else np.nan for part in parts])


_LENS, _DELAY = slice(6, 6 + PARAMETERS), 6 + PARAMETERS
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e9


def adjust(
    cameras: Cameras,
    bodies: Bodies,
    seen: BodySightings,
    unknowns: Unknowns,
    *,
    delays: Float[np.ndarray, " cameras"] | None = None,
    robust_scale: float = 3.0,
    steps: int = 60,
    gauge: int = 6,
    tolerance: float = 1e-8,
    progress: Progress = silent,
) -> Adjusted:
    """Fit cameras, lenses and body poses to observed points by minimising a Cauchy penalty (bundle adjustment).

    The penalty is ``Σ c²/2 ln(1 + |e/σ|²/c²)``, where e is the reprojection error and c is ``robust_scale``.

    Args:
        delays: (C,) initial delays in seconds, zero by default.
        gauge: number of directions that do not affect the errors and are excluded from the covariance: 6, or 7 if the
            scale is free.

    References: Triggs et al. 2000; Levenberg 1944, Marquardt 1963; Black and Rangarajan 1996 (penalty).
    """
    free, columns = _free_matrix(unknowns)
    now = _BundleState(cameras, bodies, np.zeros(len(cameras)) if delays is None else delays)
    task = _Task(cameras, seen, unknowns, robust_scale, columns, slice(0 if seen.local.any() else 3, 6))
    damping, best = 1e-4, task.cost(now)
    for step in range(1, steps + 1):
        equations, accepted, gain = _Equations.at(now, task), False, 0.0
        while damping < _MOST_DAMPING and not accepted:
            by_cameras, by_bodies = equations.solved(free, damping)
            trial = now.moved(task.whole(by_cameras), by_bodies)
            cost = task.cost(trial)
            accepted = cost < best
            if accepted:
                gain = (best - cost) / max(best, 1e-30)
                now, best = trial, cost
                damping = max(damping / 10.0, _LEAST_DAMPING)
            else:
                damping *= 10.0
        progress("Adjusting cameras", step, steps)
        if not accepted or gain < tolerance:
            break
    covariance = task.whole(task.whole(_Equations.at(now, task).covariance(free, gauge)).T)
    return Adjusted(now.cameras, now.bodies, task.errors(now), covariance, now.delays, seen)


@dataclass(frozen=True)
class _BundleState:
    cameras: Cameras
    bodies: Bodies
    delays: np.ndarray

    def moved(self, by_cameras: np.ndarray, by_bodies: np.ndarray) -> _BundleState:
        """Add steps (19 C,) to the 19 parameters of C cameras, and steps (B, 3 or 6) to B bodies. Return the result."""
        step = by_cameras.reshape(len(self.cameras), CAMERA_PARAMETERS)
        turn = exp_so3(step[:, :3])
        t = (turn @ self.cameras.t[..., None])[..., 0] + step[:, 3:6]
        cameras = moved(replace(self.cameras, R=turn @ self.cameras.R, t=t), step[:, _LENS])
        bodies = replace(self.bodies, t=self.bodies.t + by_bodies[:, -3:])
        if by_bodies.shape[1] == 6:
            bodies = replace(bodies, R=exp_so3(by_bodies[:, :3]) @ bodies.R)
        return _BundleState(cameras, bodies, self.delays + step[:, _DELAY])


@dataclass(frozen=True)
class _Task:
    start: Cameras
    seen: BodySightings
    unknowns: Unknowns
    scale: float
    columns: np.ndarray  # ``CAMERA_PARAMETERS`` that are unknown for at least one camera.
    turning: slice  # Rotation parameters among a body's six. Single points have no rotation.

    def whole(self, values: np.ndarray) -> np.ndarray:
        """Expand values of unknown parameters to all 19 parameters of C cameras (19 C,). Fixed parameters get zeros."""
        C = len(self.start)
        full = np.zeros((C, CAMERA_PARAMETERS, *values.shape[1:]))
        full[:, self.columns] = values.reshape(C, len(self.columns), *values.shape[1:])
        return full.reshape(C * CAMERA_PARAMETERS, *values.shape[1:])

    def in_cameras(self, now: _BundleState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points (N, 3) in camera axes and their offsets (N, 3) from body origins, in world axes.

        Also return the observed pixels (N, 2), corrected for camera delays.
        """
        seen, bodies, cameras = self.seen, now.bodies, now.cameras
        arm = (bodies.R[seen.body] @ seen.local[..., None])[..., 0]
        world = arm + bodies.t[seen.body]
        x_cam = (cameras.R[seen.camera] @ world[..., None])[..., 0] + cameras.t[seen.camera]
        target = seen.px
        if seen.velocity is not None:
            target = target - seen.velocity * now.delays[seen.camera, None]
        return x_cam, arm, target

    def errors(self, now: _BundleState) -> np.ndarray:
        """Return the reprojection errors (N, 2) in px: projected minus observed. Points behind a camera get NaN."""
        x_cam, _, target = self.in_cameras(now)
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            return pixels_of(now.cameras, self.seen.camera, x_cam) - target

    def of_camera(self, by_pose: np.ndarray, by_lens: np.ndarray, by_delay: np.ndarray) -> np.ndarray:
        """Select the derivatives of N pixels with respect to the P unknown parameters of each camera.

        The inputs are the derivatives with respect to pose, lens and delay. The result is (N, 2, P).
        """
        if self.columns.max(initial=0) < 6:
            return by_pose[..., self.columns]
        return np.concatenate([by_pose, by_lens, by_delay], axis=-1)[..., self.columns]

    def lens_change(self, cameras: Cameras) -> np.ndarray:
        """Return the steps (C, 12) of the lens ``PARAMETERS`` from their initial values (see ``lens.moved``)."""
        before, after = (c.K[:, [0, 1], [0, 1]] for c in (self.start, cameras))
        centre = (cameras.K[:, :2, 2] - self.start.K[:, :2, 2]) / before
        bent = cameras.distortion - self.start.distortion
        return np.concatenate([np.log(after / before), centre, bent], axis=1)

    def cost(self, now: _BundleState) -> float:
        square = (self.errors(now) ** 2).sum(-1) / self.seen.sigma**2 / self.scale**2
        cost = 0.5 * self.scale**2 * float(np.log1p(np.where(np.isfinite(square), square, 1e6)).sum())
        bodies = now.bodies
        if bodies.known is not None:
            cost += 0.5 * float(np.nansum((bodies.t - bodies.known) ** 2)) / PLACE_SIGMA_M**2
        if self.unknowns.held is not None:
            far = (self.unknowns.held.step_from(now.cameras) ** 2).sum(-1) / self.scale**2
            cost += 0.5 * self.scale**2 * float(np.log1p(far).sum())
        if self.unknowns.lens_sigma is not None:
            cost += 0.5 * float(((self.lens_change(now.cameras) / self.unknowns.lens_sigma) ** 2).sum())
        return cost


@dataclass(frozen=True)
class _Equations:
    """Normal equations: ``U`` for cameras, ``V`` for bodies, and ``W``, which couples them."""

    U: np.ndarray
    V: np.ndarray
    W: np.ndarray
    by_camera: np.ndarray
    by_body: np.ndarray

    @classmethod
    def at(cls, now: _BundleState, task: _Task) -> _Equations:
        cameras, bodies, seen, unknowns = now.cameras, now.bodies, task.seen, task.unknowns
        x_cam, arm, target = task.in_cameras(now)
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            px, by_point, by_lens = project_local(cameras, seen.camera, x_cam)
        error = px - target
        good = np.isfinite(error).all(-1) & np.isfinite(by_lens).all((-1, -2))
        square = (np.nan_to_num(error) ** 2).sum(-1) / seen.sigma**2
        weight = np.where(good, 1.0 / (1.0 + square / task.scale**2), 0.0) / seen.sigma**2
        by_pose = np.concatenate([-by_point @ skew(x_cam), by_point], axis=-1)
        by_delay = np.zeros((len(error), 2, 1)) if seen.velocity is None else seen.velocity[..., None]
        J_camera = np.where(good[:, None, None], task.of_camera(by_pose, by_lens, by_delay), 0.0)
        in_world: np.ndarray = by_point @ cameras.R[seen.camera]
        by_body_pose = np.concatenate([-in_world @ skew(arm), in_world], axis=-1)[..., task.turning]
        J_body = np.where(good[:, None, None], by_body_pose, 0.0)
        weighted_body, weighted_camera = J_body * weight[:, None, None], J_camera * weight[:, None, None]
        residual = np.where(good[:, None], error, 0.0)[..., None]
        C, B, P = len(cameras), len(bodies.t), len(task.columns)
        T = np.swapaxes
        U = np.zeros((C, P, C, P))
        U[range(C), :, range(C)] = _sums(T(weighted_camera, 1, 2) @ J_camera, seen.camera, C)
        pair = _sums(T(weighted_camera, 1, 2) @ J_body, seen.body * C + seen.camera, B * C)
        by_camera = _sums((T(weighted_camera, 1, 2) @ residual)[..., 0], seen.camera, C)
        V = _sums(T(weighted_body, 1, 2) @ J_body, seen.body, B)
        by_body = _sums((T(weighted_body, 1, 2) @ residual)[..., 0], seen.body, B)
        if bodies.known is not None:
            given = np.isfinite(bodies.known).all(-1)
            V[given, -3:, -3:] += np.eye(3) / PLACE_SIGMA_M**2
            by_body[given, -3:] += (bodies.t - bodies.known)[given] / PLACE_SIGMA_M**2
        if unknowns.held is not None:
            step, scale = unknowns.held.step_from(cameras), unknowns.held.scale
            sure = 1.0 / (1.0 + (step**2).sum(-1, keepdims=True) / task.scale**2)
            U[np.arange(C)[:, None], np.arange(6), np.arange(C)[:, None], np.arange(6)] += sure / scale**2
            by_camera[:, :6] += sure * step / scale
        U = U.reshape(C * P, C * P)
        if unknowns.lens_sigma is not None:
            precision = np.pad(1.0 / unknowns.lens_sigma**2, ((0, 0), (6, 1)))
            pull = precision * np.pad(task.lens_change(cameras), ((0, 0), (6, 1)))
            U[range(C * P), range(C * P)] += precision[:, task.columns].ravel()
            by_camera = by_camera + pull[:, task.columns]
        return cls(U, V, pair.reshape(B, C * P, J_body.shape[-1]), by_camera.ravel(), by_body)

    def solved(self, free: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Solve the damped normal equations for steps of P parameters per camera (C P,) and of bodies (B, 3 or 6)."""
        V_inverse, W, S, g = self._reduced(free, damping)
        diagonal = np.einsum("ii->i", S)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(free.T @ self.U @ free), 1e-12))
        diagonal += damping / scale**2 + 1e-12
        by_camera = -scale * np.linalg.solve(scale[:, None] * S * scale, scale * g)
        right = self.by_body + np.einsum("bqi,q->bi", W, by_camera)
        return free @ by_camera, -(V_inverse @ right[..., None])[..., 0]

    def _reduced(self, free: np.ndarray, damping: float) -> tuple[np.ndarray, ...]:
        V = self.V.copy()
        diagonal = np.einsum("bii->bi", V)
        diagonal += damping * diagonal + np.where(diagonal > 0, 1e-12 * diagonal.max(initial=1.0), 1.0)
        V_inverse = np.linalg.inv(V)
        W = np.swapaxes(np.swapaxes(self.W, 1, 2) @ free, 1, 2)
        Y = W @ V_inverse
        S = free.T @ self.U @ free - np.tensordot(Y, W, axes=((0, 2), (0, 2)))
        g = free.T @ self.by_camera - np.einsum("bqi,bi->q", Y, self.by_body)
        return V_inverse, W, S, g

    def covariance(self, free: np.ndarray, gauge: int) -> np.ndarray:
        """Return the covariance (C P, C P) of P parameters of each of C cameras.

        It is the inverse of the reduced normal equations without the ``gauge`` smallest eigenvalues.
        """
        _, _, S, _ = self._reduced(free, 0.0)
        if not len(S):
            return np.zeros_like(self.U)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(free.T @ self.U @ free), 1e-12))
        values, vectors = np.linalg.eigh(scale[:, None] * S * scale)
        kept = np.arange(len(values)) >= gauge
        kept &= values > 1e-14
        vectors = scale[:, None] * vectors[:, kept]
        return free @ ((vectors / values[kept]) @ vectors.T) @ free.T


def _free_matrix(unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix (C P, Q) that maps Q independent unknowns to P parameters of each of C cameras.

    Also return the indices (P,) of these parameters.
    """
    C = len(unknowns.poses)
    late = np.zeros(C, bool) if unknowns.delays is None else unknowns.delays
    lens = np.zeros((C, PARAMETERS), bool) if unknowns.lens is None else unknowns.lens
    free = np.concatenate([np.tile(unknowns.poses[:, None], (1, 6)), lens, late[:, None]], axis=1)
    tied = free[:, 6] & free[:, 7]
    columns = np.flatnonzero(free.any(0))
    alone = free.copy()
    alone[tied, 7] = False
    matrix = np.eye(free.size)[:, alone.ravel()]
    for c in np.flatnonzero(tied):
        matrix[c * CAMERA_PARAMETERS + 7] = matrix[c * CAMERA_PARAMETERS + 6]
    kept = (np.arange(C)[:, None] * CAMERA_PARAMETERS + columns).ravel()
    return matrix[kept], columns


def _sums(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Sum the values (N, ...) of each group. Return the sums (count, ...)."""
    total = np.zeros((count, *values.shape[1:]))
    order = np.argsort(group, kind="stable")
    firsts = np.flatnonzero(np.diff(group[order], prepend=-1))
    if len(firsts):
        total[group[order][firsts]] = np.add.reduceat(values[order], firsts, axis=0)
    return total
