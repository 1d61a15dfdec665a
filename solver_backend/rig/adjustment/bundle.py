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
from solver_backend.rig.adjustment.problem import CAMERA_PARAMETERS, Adjusted, Bodies, Sightings, Unknowns
from solver_backend.types import Cameras
from solver_backend.types.shapes import Float

_LENS, _DELAY = slice(6, 6 + PARAMETERS), 6 + PARAMETERS
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e9


def adjust(
    cameras: Cameras,
    bodies: Bodies,
    seen: Sightings,
    unknowns: Unknowns,
    *,
    delays: Float[np.ndarray, " cameras"] | None = None,
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
        delays: (C,) seconds at a start, see ``Adjusted``; zero if left out.
        robust_scale: c, in standard deviations.
        steps: at most.
        gauge: directions that change nothing (6, or 7 where the scale is free), left out of the covariance.
        tolerance: relative gain of a step below which it ends.
        watch: called with the step and the cost.

    Reference: Triggs et al. 2000; Levenberg 1944, Marquardt 1963; Black and Rangarajan 1996 (the penalty).
    """
    free = _free_matrix(unknowns)
    now = _State(cameras, bodies, np.zeros(len(cameras)) if delays is None else delays)
    task = _Task(cameras, seen, unknowns, robust_scale)
    damping, best = 1e-4, task.cost(now)
    step = 0
    for step in range(1, steps + 1):
        equations = _Equations.at(now, task)
        accepted = False
        gain = 0.0
        while damping < _MOST_DAMPING and not accepted:
            trial = now.moved(*equations.solved(free, damping))
            cost = task.cost(trial)
            accepted = cost < best
            if accepted:
                gain = (best - cost) / max(best, 1e-30)
                now, best = trial, cost
                damping = max(damping / 10.0, _LEAST_DAMPING)
            else:
                damping *= 10.0
        watch(step, best)
        if not accepted or gain < tolerance:
            break
    covariance = _Equations.at(now, task).covariance(free, gauge)
    return Adjusted(now.cameras, now.bodies, task.errors(now)[0], covariance, step, now.delays)


@dataclass(frozen=True)
class _State:
    """Cameras, bodies and delays (C,) at one step."""

    cameras: Cameras
    bodies: Bodies
    delays: np.ndarray

    def moved(self, by_cameras: np.ndarray, by_bodies: np.ndarray) -> _State:
        """Return the state after a step of all cameras (19C,) and bodies (B, 6)."""
        step = by_cameras.reshape(len(self.cameras), CAMERA_PARAMETERS)
        turn = exp_so3(step[:, :3])
        t = (turn @ self.cameras.t[..., None])[..., 0] + step[:, 3:6]
        cameras = moved(replace(self.cameras, R=turn @ self.cameras.R, t=t), step[:, _LENS])
        bodies = replace(
            self.bodies, R=exp_so3(by_bodies[:, :3]) @ self.bodies.R, t=self.bodies.t + by_bodies[:, 3:]
        )
        return _State(cameras, bodies, self.delays + step[:, _DELAY])


@dataclass(frozen=True)
class _Task:
    """What stays the same over all steps."""

    start: Cameras
    seen: Sightings
    unknowns: Unknowns
    scale: float

    def errors(self, now: _State) -> tuple[np.ndarray, ...]:
        """Return error (N, 2), points in camera axes (N, 3), (N, 3, 3) turns of bodies, derivatives by point and lens."""
        seen, bodies, cameras = self.seen, now.bodies, now.cameras
        R_body = bodies.R[seen.body]
        world = (R_body @ seen.local[..., None])[..., 0] + bodies.t[seen.body]
        x_cam = (cameras.R[seen.camera] @ world[..., None])[..., 0] + cameras.t[seen.camera]
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            px, by_point, by_lens = project_local(cameras, seen.camera, x_cam)
        target = seen.px
        if seen.velocity is not None:
            target = target - seen.velocity * now.delays[seen.camera, None]
        return px - target, x_cam, R_body, by_point, by_lens

    def lens_change(self, cameras: Cameras) -> np.ndarray:
        """Return (C, 12) how far the lenses moved, in ``PARAMETERS``."""
        before, after = (c.K[:, [0, 1], [0, 1]] for c in (self.start, cameras))
        centre = (cameras.K[:, :2, 2] - self.start.K[:, :2, 2]) / before
        bent = cameras.distortion - self.start.distortion
        return np.concatenate([np.log(after / before), centre, bent], axis=1)

    def cost(self, now: _State) -> float:
        """Return the robust cost; a point behind a camera costs as much as a very large error."""
        square = (self.errors(now)[0] ** 2).sum(-1) / self.seen.sigma**2 / self.scale**2
        cost = 0.5 * self.scale**2 * float(np.log1p(np.where(np.isfinite(square), square, 1e6)).sum())
        bodies = now.bodies
        if bodies.known is not None:
            cost += 0.5 * float(np.nansum((bodies.t - bodies.known) ** 2)) / bodies.known_sigma**2
        if self.unknowns.lens_sigma is not None:
            cost += 0.5 * float(((self.lens_change(now.cameras) / self.unknowns.lens_sigma) ** 2).sum())
        return cost


@dataclass(frozen=True)
class _Equations:
    """Normal equations: ``U`` (19C, 19C) of cameras, ``V`` (B, 6, 6) of bodies, ``W`` (B, 19C, 6) between them."""

    U: np.ndarray
    V: np.ndarray
    W: np.ndarray
    by_camera: np.ndarray
    by_body: np.ndarray

    @classmethod
    def at(cls, now: _State, task: _Task) -> _Equations:
        cameras, bodies, seen, unknowns = now.cameras, now.bodies, task.seen, task.unknowns
        error, x_cam, R_body, by_point, by_lens = task.errors(now)
        good = np.isfinite(error).all(-1) & np.isfinite(by_lens).all((-1, -2))
        square = (np.nan_to_num(error) ** 2).sum(-1) / seen.sigma**2
        weight = np.where(good, 1.0 / (1.0 + square / task.scale**2), 0.0) / seen.sigma**2
        by_pose = np.concatenate([-by_point @ skew(x_cam), by_point], axis=-1)
        by_delay = np.zeros((len(error), 2, 1)) if seen.velocity is None else seen.velocity[..., None]
        J_camera = np.where(good[:, None, None], np.concatenate([by_pose, by_lens, by_delay], axis=-1), 0.0)
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
            precision[:, _LENS] = 1.0 / unknowns.lens_sigma**2
            U[range(C * P), range(C * P)] += precision.ravel()
            by_camera = by_camera + precision * np.pad(task.lens_change(cameras), ((0, 0), (6, 1)))
        return cls(U, V, pair.reshape(B, C * P, 6), by_camera.ravel(), by_body)

    def solved(self, free: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the damped step of all cameras (19C,) and bodies (B, 6)."""
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
        """Return the inverse of the reduced equations without their ``gauge`` softest directions, (19C, 19C)."""
        _, _, S, _ = self._reduced(free, 0.0)
        if not len(S):
            return np.zeros_like(self.U)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(free.T @ self.U @ free), 1e-12))
        values, vectors = np.linalg.eigh(scale[:, None] * S * scale)
        kept = np.arange(len(values)) >= gauge
        kept &= values > 1e-14
        vectors = scale[:, None] * vectors[:, kept]
        return free @ ((vectors / values[kept]) @ vectors.T) @ free.T


def _free_matrix(unknowns: Unknowns) -> np.ndarray:
    """Return (19C, Q): which full step each unknown number stands for."""
    C, P = len(unknowns.poses), CAMERA_PARAMETERS
    columns: list[np.ndarray] = []
    for c in range(C):
        late = unknowns.delays is not None and bool(unknowns.delays[c])
        free = np.concatenate([np.full(6, unknowns.poses[c]), unknowns.lens[c], [late]])
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


def _sums(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Return the sums of values (N, ...) by their group: (count, ...)."""
    total = np.zeros((count, *values.shape[1:]))
    order = np.argsort(group, kind="stable")
    firsts = np.flatnonzero(np.diff(group[order], prepend=-1))
    if len(firsts):
        total[group[order][firsts]] = np.add.reduceat(values[order], firsts, axis=0)
    return total
