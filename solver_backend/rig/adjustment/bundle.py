"""One bundle adjustment for lenses, camera poses, boards and points: Levenberg-Marquardt on Schur's complement.

What is seen is a body (a board of many points, or a point alone, which has no rotation) at a pose of its own; what sees
is a camera with a pose and a lens. Bodies are eliminated, so that the equations solved are those of the cameras.

Reference: Triggs et al. 2000, "Bundle adjustment: a modern synthesis", sec. 6.1 (reduced camera system).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.geometry.rotations import exp_so3, skew
from solver_backend.rig.adjustment.lens import PARAMETERS, moved, project_local
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float, Int

CAMERA_PARAMETERS = 6 + PARAMETERS
"""Rotation 3 (rad), translation 3 (m) and the lens' 12, of each camera."""
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e9


@dataclass(frozen=True)
class Sightings:
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

    def where(self, chosen: Bool[np.ndarray, " n"]) -> Sightings:
        """Return the chosen ones."""
        return Sightings(*(a[chosen] for a in (self.camera, self.body, self.local, self.px, self.sigma)))


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
    """(18 C, 18 C) of ``CAMERA_PARAMETERS`` about the solution, the world's own freedom taken out."""
    steps: int
    """Taken."""

    @property
    def rmse_px(self) -> float:
        """Root of the mean squared distance."""
        return float(np.sqrt(np.nanmean((self.error**2).sum(-1))))


def adjust(
    cameras: Cameras,
    bodies: Bodies,
    seen: Sightings,
    unknowns: Unknowns,
    *,
    robust_scale: float = 3.0,
    steps: int = 60,
    gauge: int = 6,
    tolerance: float = 1e-8,
    watch: Callable[[int, float], None] = lambda step, cost: None,
) -> Adjusted:
    """Minimise ``Σ c²/2 ln(1 + |e/σ|²/c²)`` (Cauchy) over cameras, lenses and bodies.

    Args:
        cameras: C cameras at a start.
        bodies: B bodies at a start.
        seen: N sightings.
        unknowns: what changes.
        robust_scale: c, in standard deviations.
        steps: at most.
        gauge: directions that change nothing (6, or 7 where the scale is free), left out of the covariance.
        tolerance: relative gain of a step below which it ends.
        watch: called with the step and the cost.

    Reference: Triggs et al. 2000; Levenberg 1944, Marquardt 1963; Black and Rangarajan 1996 (the penalty).
    """
    free = _free_matrix(unknowns)
    start = cameras
    damping, best = 1e-4, _cost(cameras, start, bodies, seen, unknowns, robust_scale)
    step = 0
    for step in range(1, steps + 1):
        equations = _Equations.at(cameras, start, bodies, seen, unknowns, robust_scale)
        accepted = False
        gain = 0.0
        while damping < _MOST_DAMPING and not accepted:
            by_cameras, by_bodies = equations.solved(free, damping)
            trial = _moved_cameras(cameras, by_cameras), _moved_bodies(bodies, by_bodies)
            cost = _cost(trial[0], start, trial[1], seen, unknowns, robust_scale)
            accepted = cost < best
            if accepted:
                gain = (best - cost) / max(best, 1e-30)
                (cameras, bodies), best = trial, cost
                damping = max(damping / 10.0, _LEAST_DAMPING)
            else:
                damping *= 10.0
        watch(step, best)
        if not accepted or gain < tolerance:
            break
    equations = _Equations.at(cameras, start, bodies, seen, unknowns, robust_scale)
    error, *_ = _errors(cameras, bodies, seen)
    return Adjusted(cameras, bodies, error, equations.covariance(free, gauge), step)


@dataclass(frozen=True)
class _Equations:
    """Normal equations: ``U`` (18C, 18C) of cameras, ``V`` (B, 6, 6) of bodies, ``W`` (B, 18C, 6) between them."""

    U: np.ndarray
    V: np.ndarray
    W: np.ndarray
    by_camera: np.ndarray
    by_body: np.ndarray

    @classmethod
    def at(
        cls, cameras: Cameras, start: Cameras, bodies: Bodies, seen: Sightings, unknowns: Unknowns, scale: float
    ) -> _Equations:
        error, x_cam, R_body, by_point, by_lens = _errors(cameras, bodies, seen)
        good = np.isfinite(error).all(-1) & np.isfinite(by_lens).all((-1, -2))
        square = (np.nan_to_num(error) ** 2).sum(-1) / seen.sigma**2
        weight = np.where(good, 1.0 / (1.0 + square / scale**2), 0.0) / seen.sigma**2
        by_pose = np.concatenate([-by_point @ skew(x_cam), by_point], axis=-1)
        J_camera = np.where(good[:, None, None], np.concatenate([by_pose, by_lens], axis=-1), 0.0)
        in_world = by_point @ cameras.R[seen.camera]
        arm = (R_body @ seen.local[..., None])[..., 0]
        J_body = np.where(good[:, None, None], np.concatenate([-in_world @ skew(arm), in_world], axis=-1), 0.0)
        weighted_body, weighted_camera = J_body * weight[:, None, None], J_camera * weight[:, None, None]
        residual = np.where(good[:, None], error, 0.0)[..., None]
        C, B, P = len(cameras), len(bodies.t), CAMERA_PARAMETERS
        T = np.swapaxes
        U = np.zeros((C, P, C, P))
        U[range(C), :, range(C)] = _sums(T(weighted_camera, 1, 2) @ J_camera, seen.camera, C)
        pair = _sums(T(weighted_camera, 1, 2) @ J_body, seen.body * C + seen.camera, B * C)
        by_camera = _sums((T(weighted_camera, 1, 2) @ residual)[..., 0], seen.camera, C)
        V = _sums(T(weighted_body, 1, 2) @ J_body, seen.body, B)
        by_body = _sums((T(weighted_body, 1, 2) @ residual)[..., 0], seen.body, B)
        if bodies.known is not None:
            told = np.isfinite(bodies.known).all(-1)
            V[told, 3:, 3:] += np.eye(3) / bodies.known_sigma**2
            by_body[told, 3:] += (bodies.t - bodies.known)[told] / bodies.known_sigma**2
        U = U.reshape(C * P, C * P)
        if unknowns.lens_sigma is not None:
            precision = np.zeros((C, P))
            precision[:, 6:] = 1.0 / unknowns.lens_sigma**2
            U[range(C * P), range(C * P)] += precision.ravel()
            by_camera = by_camera + precision * np.pad(_lens_change(start, cameras), ((0, 0), (6, 0)))
        return cls(U, V, pair.reshape(B, C * P, 6), by_camera.ravel(), by_body)

    def solved(self, free: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the damped step of all cameras (18C,) and bodies (B, 6)."""
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
        """Return the inverse of the reduced equations without their ``gauge`` softest directions, (18C, 18C)."""
        _, _, S, _ = self._reduced(free, 0.0)
        if not len(S):
            return np.zeros_like(self.U)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(free.T @ self.U @ free), 1e-12))
        values, vectors = np.linalg.eigh(scale[:, None] * S * scale)
        kept = np.arange(len(values)) >= gauge
        kept &= values > 1e-14
        vectors = scale[:, None] * vectors[:, kept]
        return free @ ((vectors / values[kept]) @ vectors.T) @ free.T


def _errors(cameras: Cameras, bodies: Bodies, seen: Sightings) -> tuple[np.ndarray, ...]:
    R_body = bodies.R[seen.body]
    world = (R_body @ seen.local[..., None])[..., 0] + bodies.t[seen.body]
    x_cam = (cameras.R[seen.camera] @ world[..., None])[..., 0] + cameras.t[seen.camera]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        px, by_point, by_lens = project_local(cameras, seen.camera, x_cam)
    return px - seen.px, x_cam, R_body, by_point, by_lens


def _cost(
    cameras: Cameras, start: Cameras, bodies: Bodies, seen: Sightings, unknowns: Unknowns, scale: float
) -> float:
    error, *_ = _errors(cameras, bodies, seen)
    square = (error**2).sum(-1) / seen.sigma**2
    behind = 1e6 * scale**2
    cost = 0.5 * scale**2 * float(np.log1p(np.where(np.isfinite(square), square, behind) / scale**2).sum())
    if bodies.known is not None:
        cost += 0.5 * float(np.nansum((bodies.t - bodies.known) ** 2)) / bodies.known_sigma**2
    if unknowns.lens_sigma is not None:
        cost += 0.5 * float(((_lens_change(start, cameras) / unknowns.lens_sigma) ** 2).sum())
    return cost


def _lens_change(start: Cameras, now: Cameras) -> np.ndarray:
    """Return (C, 12) how far the lenses moved, in ``PARAMETERS``."""
    focal = [c.K[:, [0, 1], [0, 1]] for c in (start, now)]
    centre = (now.K[:, :2, 2] - start.K[:, :2, 2]) / focal[0]
    return np.concatenate([np.log(focal[1] / focal[0]), centre, now.distortion - start.distortion], axis=1)


def _free_matrix(unknowns: Unknowns) -> np.ndarray:
    """Return (18C, Q): which full step each unknown number stands for."""
    C, P = len(unknowns.poses), CAMERA_PARAMETERS
    columns: list[np.ndarray] = []
    for c in range(C):
        free = np.concatenate([np.full(6, unknowns.poses[c]), unknowns.lens[c]])
        tied = unknowns.one_focal and free[6] and free[7]
        for p in np.flatnonzero(free):
            if tied and p == 7:
                continue
            column = np.zeros(C * P)
            column[c * P + p] = 1.0
            if tied and p == 6:
                column[c * P + 7] = 1.0
            columns.append(column)
    return np.stack(columns, axis=1) if columns else np.zeros((C * P, 0))


def _moved_cameras(cameras: Cameras, step: np.ndarray) -> Cameras:
    by_camera = step.reshape(len(cameras), CAMERA_PARAMETERS)
    turn = exp_so3(by_camera[:, :3])
    posed = replace(cameras, R=turn @ cameras.R, t=(turn @ cameras.t[..., None])[..., 0] + by_camera[:, 3:6])
    return moved(posed, by_camera[:, 6:])


def _moved_bodies(bodies: Bodies, step: np.ndarray) -> Bodies:
    return replace(bodies, R=exp_so3(step[:, :3]) @ bodies.R, t=bodies.t + step[:, 3:])


def _sums(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Return the sums of values (N, ...) by their group: (count, ...)."""
    total = np.zeros((count, *values.shape[1:]))
    order = np.argsort(group, kind="stable")
    firsts = np.flatnonzero(np.diff(group[order], prepend=-1))
    if len(firsts):
        total[group[order][firsts]] = np.add.reduceat(values[order], firsts, axis=0)
    return total
