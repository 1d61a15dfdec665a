"""Use Pose-NDF to complete, denoise, interpolate and fit poses (Tiwari et al. 2022)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.joint_sets import NUM_BETAS
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, zeros
from solver_backend.geometry.rotations import exp_so3, left_jacobian_inverse_so3, log_so3
from solver_backend.priors.pose_ndf import RECORDED_RAD, TURN_METRIC, PoseNDF, ProjectionSettings
from solver_backend.priors.weights import BODY_JOINTS
from solver_backend.residuals.terms import PointTerm, graduated_scales
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.solver.levenberg_marquardt import Arrowhead, LMSettings, levenberg_marquardt

BENDS: tuple[tuple[int, int, float], ...] = ((3, 0, -1.0), (4, 0, -1.0), (17, 1, 1.0), (18, 1, -1.0))
"""Column of each knee and elbow, axis of its rotation vector, and sign of the direction in which it cannot bend."""


@dataclass(frozen=True)
class KeypointSettings:
    """Weights in Pose-NDF's keypoint objective (eq. 10), for errors divided by the detector's standard deviation."""

    manifold: float = 50.0  # w, 1/rad²: ``λ_θ = w f(θ)``, so that the term ``w f² / 2`` vanishes near the manifold.
    adaptive: bool = True  # False uses a constant ``λ_θ = w``, 1/rad, for comparison.
    shape: float = 1.0  # λ_β, for ``|β|² / 2``.
    bending: float = 1.0  # λ_α, for ``exp(2 α) / 2`` over knees and elbows. α is the angle bent the wrong way.
    robust_scale: float = 3.0  # Geman-McClure scale in standard deviations, reached from four times in three steps.
    iterations: int = 20  # Largest number of linearisations per robust scale.


@dataclass(frozen=True)
class KeypointFit:
    """Poses and body shape after fitting keypoints."""

    frames: PosedFrames
    betas: Array  # (10,) one shape for all frames.
    cost: float
    status: str  # Reason why the search stopped.


@dataclass(frozen=True)
class KeypointObjective:
    """Pose-NDF's keypoint objective ``L_J + λ_θ L_θ + λ_β L_β + λ_α L_α`` (eqs. 10 and 11)."""

    subject: Subject
    prior: PoseNDF
    term: PointTerm  # Robust distance of landmarks from keypoints in one or more views, such as ``ReprojectionTerm``.
    settings: KeypointSettings
    scale: float

    def linearise(self, state: tuple[PosedFrames, Array]) -> tuple[Array, Arrowhead]:
        """Return the cost (1,), and the normal equations for the poses and the shared shape."""
        frames, betas = state
        posed = pose(replace(self.subject, betas=betas), frames, jacobian=True)
        xp = array_namespace(posed.points)
        evidence = self.term(posed.points, self.scale)
        count, num_landmarks = posed.points.shape[:2]
        eye = xp.broadcast_to(identity(3, betas), (count, num_landmarks, 3, 3))
        J = xp.concat([posed.by_rotations, eye, posed.by_betas], axis=-1)
        weighted = xp.reshape(xp.matmul(evidence.information, J), (count, 3 * num_landmarks, -1))
        J_T = xp.permute_dims(xp.reshape(J, (count, 3 * num_landmarks, -1)), (0, 2, 1))
        H = xp.matmul(J_T, weighted)
        g = xp.matmul(J_T, xp.reshape(evidence.gradient, (count, -1, 1)))[..., 0]
        prior_cost, prior_g, prior_H = self._pose_terms(frames)
        s, dof = self.settings, frames.layout.dof
        cost = xp.sum(evidence.cost) + prior_cost + 0.5 * s.shape * xp.sum(betas * betas)
        return xp.reshape(cost, (1,)), Arrowhead(
            H[:, :dof, :dof] + prior_H,
            H[:, :dof, dof:],
            xp.sum(H[:, dof:, dof:], axis=0) + s.shape * identity(NUM_BETAS, betas),
            g[:, :dof] + prior_g,
            xp.sum(g[:, dof:], axis=0) + s.shape * betas,
        )

    def retract(self, state: tuple[PosedFrames, Array], step: Array) -> tuple[PosedFrames, Array]:
        """Move poses and shape by a (1, 10 + p F) step, with the shape first."""
        xp = array_namespace(step)
        frames, betas = state
        moves = xp.reshape(step[0, NUM_BETAS:], (-1, frames.layout.dof))
        return frames.retract(moves), betas + step[0, :NUM_BETAS]

    def _pose_terms(self, frames: PosedFrames) -> tuple[Array, Array, Array]:
        """Return cost, gradient (F, p) and curvature (F, p, p) of the manifold and bending terms."""
        xp = array_namespace(frames.local)
        bend_cost, bend_g, bend_curvature = bending(frames.local, self.settings.bending)
        distance, by_joints = self.prior.distance_with_tangents(frames.local)
        w, by_joints = self.settings.manifold, xp.reshape(by_joints, (len(distance), -1))
        if self.settings.adaptive:
            cost, own_g, stiff = 0.5 * w * xp.sum(distance**2), w * distance[:, None] * by_joints, w + 0.0 * distance
        else:
            cost, own_g, stiff = w * xp.sum(distance), w * by_joints, w / xp.clip(distance, 1e-3, None)
        metric = constant(np.diag(np.repeat(TURN_METRIC, 3)), distance)
        curvature = bend_curvature + stiff[:, None, None] * metric
        g = zeros((len(distance), frames.layout.dof), distance)
        H = xp.zeros_like(g)[:, :, None] * g[:, None, :]
        joints = frames.layout.joints
        g[:, joints], H[:, joints, joints] = bend_g + own_g, curvature
        return cost + bend_cost, g, H


def bending(local: Array, weight: float) -> tuple[Array, Array, Array]:
    """Penalise knees and elbows that bend the wrong way by angles α: ``λ_α/2 Σ exp(2 α)``.

    Return the cost (F,), its gradient (F, 63) and its curvature w.r.t. left tangents. ``weight`` is λ_α.
    """
    xp = array_namespace(local)
    vectors = log_so3(local)
    inverse, count = left_jacobian_inverse_so3(vectors), local.shape[0]
    penalties, slopes = [], []
    for joint, axis, sign in BENDS:
        penalty = xp.exp(sign * vectors[:, joint, axis])
        one = constant(np.eye(vectors.shape[1])[joint], penalty)[None, :, None]
        slope = (sign * penalty)[:, None] * inverse[:, joint, axis, :]
        penalties.append(penalty)
        slopes.append(xp.reshape(one * slope[:, None, :], (count, -1)))
    r, J = xp.stack(penalties, axis=1), xp.stack(slopes, axis=1)
    J_T = xp.permute_dims(J, (0, 2, 1))
    return 0.5 * weight * xp.sum(r * r), weight * xp.matmul(J_T, r[..., None])[..., 0], weight * xp.matmul(J_T, J)


def fit_keypoints(
    subject: Subject,
    prior: PoseNDF,
    term: PointTerm,
    start: PosedFrames,
    settings: KeypointSettings = KeypointSettings(),
) -> KeypointFit:
    """Fit poses and one body shape to keypoints by minimising eq. 10.

    The initial poses must face in roughly the right direction.

    Args:
        subject: body and keypoint landmarks. Its shape is the initial shape.
        prior: the distance from its manifold is ``L_θ``.
        term: the keypoints' data term on the landmarks.
        start: F initial poses, placed roughly in front of the cameras.

    Raises:
        PoseInvalid: initial poses are NaN or not in SO(3).
    """
    state, result = (start, subject.betas), None
    stopping = LMSettings(max_iterations=settings.iterations, tolerance=1e-5)
    for scale in graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3):
        objective = KeypointObjective(subject, prior, term, settings, scale)
        result = levenberg_marquardt(state, objective.linearise, objective.retract, stopping)
        state = result.state
    assert result is not None
    return KeypointFit(*state, cost=float(result.cost[0]), status=result.status)


@dataclass(frozen=True)
class ManifoldWeights:
    """Weights of data, manifold and smoothness. Terms on points are means over landmarks."""

    data: float  # λ_v, 1/m²: weight of the observed points.
    manifold: float  # w, 1/rad²: ``λ_θ = w f`` makes the prior's term ``w f²``, weak near the manifold (sec. 4.3).
    smoothness: float  # λ_t, 1/m²: weight of the distances between a frame's points and the previous frame's.
    level: float = 0.0  # rad. Poses this close to the manifold, such as recorded ones, are not pulled.


@dataclass(frozen=True)
class PoseSequence:
    """Denoising objective for F consecutive frames."""

    subject: Subject  # Body whose landmarks replace the mesh.
    prior: PoseNDF
    weights: ManifoldWeights
    observed: Array  # (F, L, 3) metres.
    seen: Array  # (F, L) one where a point is observed, zero elsewhere (its position may be any finite number).
    free: tuple[int, ...]  # Columns of a frame's ``PoseLayout`` that may move.
    before: Array | None = None  # (L, 3) points in the frame before the first, None at the start of a take.

    def linearise(self, frames: PosedFrames) -> tuple[Array, BlockTridiagonal]:
        """Return the cost (1,) and its Gauss-Newton equations w.r.t. the free tangents.

        ``E = 1/2 Σ_t [λ_v/L Σ_l s |y - o|² + w e² + λ_t/L Σ_l |y_t - y_{t-1}|²]`` with ``e = max(f - level, 0)``. y are
        the landmarks and o the observed landmarks. s is 1 where a landmark is observed, otherwise 0. f is the distance
        from the manifold, and w its weight. The terms are L_v, L_θ and L_t in Pose-NDF's eqs. 7 and 8, with landmarks
        instead of the mesh and all frames at once. The prior's residual is the vector to the manifold rather than its
        length, so that ``e²/2`` has the metric's curvature.
        """
        posed = pose(self.subject, frames, jacobian=True)
        xp = array_namespace(posed.points)
        count, num_landmarks = posed.points.shape[:2]
        eye = xp.broadcast_to(identity(3, posed.points), (count, num_landmarks, 3, 3))
        J = xp.reshape(xp.concat([posed.by_rotations, eye], axis=-1), (count, 3 * num_landmarks, -1))
        J = J[..., list(self.free)]
        J_T = xp.permute_dims(J, (0, 2, 1))
        data, smooth = self.weights.data / num_landmarks, self.weights.smoothness / num_landmarks
        error = self.seen[..., None] * (posed.points - self.observed)
        step = posed.points[1:] - posed.points[:-1]
        first = posed.points[:1] * 0.0 if self.before is None else posed.points[:1] - self.before
        arriving, leaving = xp.concat([first, step]), xp.concat([step, posed.points[:1] * 0.0])
        distance, by_joints = self.prior.distance_with_tangents(frames.local)
        distance = xp.clip(distance - self.weights.level, 0.0, None)
        by_free = zeros((count, frames.layout.dof), by_joints)
        by_free[:, frames.layout.joints] = xp.reshape(by_joints, (count, -1))
        by_free = by_free[:, list(self.free)]

        by_points = xp.reshape(data * error + smooth * (arriving - leaving), (count, -1, 1))
        w = self.weights.manifold
        g = xp.matmul(J_T, by_points)[..., 0] + w * distance[:, None] * by_free
        ties = np.full(count, 2.0)  # number of frames that each frame is tied to
        ties[0] -= self.before is None
        ties[-1] -= 1.0
        stiff = data * self.seen + smooth * constant(ties, posed.points)[:, None]
        stiff = xp.reshape(xp.broadcast_to(stiff[..., None], posed.points.shape), (count, -1, 1))
        bend = np.zeros(frames.layout.dof)
        bend[frames.layout.joints] = np.repeat(TURN_METRIC, 3)
        diagonal = xp.matmul(J_T, stiff * J) + constant(w * np.diag(bend[list(self.free)]), stiff)
        cost = 0.5 * (data * xp.sum(error * error) + smooth * xp.sum(arriving**2) + w * xp.sum(distance**2))
        upper = -smooth * xp.matmul(J_T[:-1], J[1:])
        return xp.reshape(cost, (1,)), BlockTridiagonal(diagonal, upper, g)

    def retract(self, frames: PosedFrames, step: Array) -> PosedFrames:
        """Move the frames by a (1, F n) step in the free tangents."""
        xp = array_namespace(step)
        count = frames.root.shape[0]
        whole = zeros((count, frames.layout.dof), step)
        whole[:, list(self.free)] = xp.reshape(step, (count, -1))
        return frames.retract(whole)


CHUNK_FRAMES = 240  # Number of frames solved at once, like the longest sequences in the paper.


def solve_sequence(
    sequence: PoseSequence, start: PosedFrames, iterations: int, stage: str = "Fitting", progress: Progress = silent
) -> tuple[PosedFrames, Array]:
    """Minimise the sequence's cost, and return the poses and the cost (1,).

    ``iterations`` is the largest number of linearisations per chunk. ``progress`` receives the name ``stage``.
    """
    count = start.transl.shape[0]
    parts, stopping = list[PosedFrames](), LMSettings(max_iterations=iterations, tolerance=1e-5)
    total, before = 0.0, sequence.before
    for first in range(0, count, CHUNK_FRAMES):
        frames = slice(first, min(first + CHUNK_FRAMES, count))
        part = replace(sequence, observed=sequence.observed[frames], seen=sequence.seen[frames], before=before)
        found = levenberg_marquardt(start.select(frames), part.linearise, part.retract, stopping)
        parts.append(found.state)
        total = total + found.cost
        before = pose(sequence.subject, found.state.select(slice(-1, None))).points[0]
        progress(stage, frames.stop, count)
    return PosedFrames.concatenate(parts), total


_SIDED = {
    "arm": ("shoulder", "elbow", "wrist"),
    "shoulder_and_arm": ("collar", "shoulder", "elbow", "wrist"),
    "leg": ("hip", "knee", "ankle", "foot"),
}
LIMBS: dict[str, tuple[str, ...]] = {
    **{f"{s}_{limb}": tuple(f"{s}_{j}" for j in joints) for limb, joints in _SIDED.items() for s in ("left", "right")},
    "trunk": ("spine1", "spine2", "spine3"),
    "head_and_neck": ("neck", "head"),
}  # Groups of joints that can be named as missing.
_LOOKED_AT = 12  # Number of frames on which candidates are tried.


@dataclass(frozen=True)
class CompleteSettings:
    """Weights in eq. 7 for completing poses. Only the missing joints move, and they have no data term."""

    manifold: float = 1.0  # w, 1/rad².
    smoothness: float = 2.0  # λ_t, 1/m², at 30 frames per second. Chosen on takes of training subjects.
    iterations: int = 30  # Largest number of linearisations per chunk of frames.
    candidates: int = 64  # Number of samples from the prior whose limbs are tried.
    starts: int = 3  # Number of best candidates that are optimised. The cheapest result is kept.
    seed: int = 0


def missing_joints(names: Sequence[str]) -> tuple[int, ...]:
    """Return the joint columns of named joints or limbs. Raise ``JobInvalid`` for unknown names."""
    known = BODY_JOINTS
    unknown = [name for name in names if name not in LIMBS and name not in known]
    if unknown or not names:
        message = f"There is no joint or limb {', '.join(unknown)}." if unknown else "No missing joint was specified."
        raise JobInvalid(message, where="missing", hint=f"Limbs: {', '.join(LIMBS)}. Joints: {', '.join(known)}.")
    joints = {joint for name in names for joint in LIMBS.get(name, (name,))}
    return tuple(column for column, joint in enumerate(known) if joint in joints)


def complete(
    subject: Subject,
    prior: PoseNDF,
    frames: PosedFrames,
    missing: tuple[int, ...],
    fps: float,
    settings: CompleteSettings = CompleteSettings(),
    progress: Progress = silent,
) -> PosedFrames:
    """Fill in the missing joints of poses close to the manifold.

    In the paper, the result depends on an initial pose near rest. This function tries several initial limbs from
    sampled poses, and returns the result with the lowest cost.

    Args:
        subject: its landmarks measure smoothness.
        frames: F poses, with arbitrary values at the missing joints.
        missing: columns of the missing joints, see ``missing_joints``.

    Raises:
        PoseInvalid: known joints are NaN or not in SO(3).
    """
    best, least, layout = None, float("inf"), frames.layout
    for number, limb in enumerate(_starts(prior, frames, missing, settings)):
        start = _with_limb(frames, missing, limb)
        observed = pose(subject, start).points
        weights = ManifoldWeights(0.0, settings.manifold, settings.smoothness * (fps / 30.0) ** 2)
        free = tuple(column for joint in missing for column in range(layout.dof)[layout.joint(joint)])
        sequence = PoseSequence(subject, prior, weights, observed, observed[..., 0] * 0.0, free)
        name = f"Completing {number + 1}/{settings.starts}"
        found, cost = solve_sequence(sequence, start, settings.iterations, name, progress)
        if best is None or float(cost[0]) < least:
            best, least = found, float(cost[0])
    assert best is not None
    return best


def _starts(prior: PoseNDF, frames: PosedFrames, missing: tuple[int, ...], settings: CompleteSettings) -> Array:
    """Return the best initial rotations (starts, n, 3, 3) of n missing joints among samples near the manifold."""
    xp = array_namespace(frames.local)
    limbs = constant(prior.sample(settings.candidates, settings.seed)[:, list(missing)], frames.local)
    some = frames.select(slice(0, None, max(1, len(frames.local) // _LOOKED_AT)))
    cost = [xp.sum(prior.energy(_with_limb(some, missing, limb).local) ** 2) for limb in limbs]
    return limbs[xp.argsort(xp.stack(cost))[: settings.starts]]


def _with_limb(frames: PosedFrames, missing: tuple[int, ...], limb: Array) -> PosedFrames:
    xp = array_namespace(frames.local)
    columns = [frames.local[:, j] for j in range(frames.local.shape[1])]
    for number, joint in enumerate(missing):
        columns[joint] = xp.broadcast_to(limb[number], columns[joint].shape)
    return PosedFrames(frames.root, xp.stack(columns, axis=1), frames.transl)


WEIGHTS = ManifoldWeights(data=1.0, manifold=0.03, smoothness=2.0, level=0.5)
"""Weights chosen on takes of training subjects, both clean and with noise of 6.5 degrees, at 30 frames per second."""


@dataclass(frozen=True)
class DenoiseSettings:
    """Settings for denoising: weights in eq. 7 at 30 frames per second, and number of iterations."""

    weights: ManifoldWeights = WEIGHTS
    iterations: int = 20  # Largest number of linearisations per chunk of frames.
    move_root: bool = True  # Let the root move as well, constrained only by smoothness and data.


def denoise(
    subject: Subject,
    prior: PoseNDF,
    frames: PosedFrames,
    fps: float,
    settings: DenoiseSettings = DenoiseSettings(),
    progress: Progress = silent,
) -> PosedFrames:
    """Denoise poses by minimising ``λ_v L_v + λ_θ L_θ + λ_t L_t`` (eq. 7).

    ``L_v`` and ``L_t`` are computed from the subject's landmarks instead of the mesh. ``L_θ`` is
    ``max(f - level, 0)²``, where f is the prior's distance. ``λ_t`` is proportional to the square of ``fps``, so that
    the penalty of a speed does not depend on the frame rate.

    Raises:
        PoseInvalid: poses are NaN or not in SO(3).
    """
    xp = array_namespace(frames.local)
    observed, w = pose(subject, frames).points, settings.weights
    weights = replace(w, smoothness=w.smoothness * (fps / 30.0) ** 2)
    columns = range(frames.layout.dof)
    free = columns if settings.move_root else columns[frames.layout.joints]
    sequence = PoseSequence(subject, prior, weights, observed, xp.ones_like(observed[..., 0]), tuple(free))
    return solve_sequence(sequence, frames, settings.iterations, "Denoising", progress)[0]


ALONG = ProjectionSettings(level=RECORDED_RAD)  # Recorded poses stay. Further steps would lead to the mean pose.


def interpolate_poses(
    prior: PoseNDF,
    start: Array,
    end: Array,
    count: int,
    settings: ProjectionSettings = ALONG,
    progress: Progress = silent,
) -> Array:
    """Interpolate ``count`` plausible poses between the two poses of each of N pairs.

    Return the interpolated poses (N, count, J, 3, 3) without the two given poses.

    For frame t of T, ``θ_t = θ'_{t-1} + τ (θ'_T - θ'_{t-1})`` along geodesics with ``τ = 1/(T - t + 1)``, where θ' are
    poses after projection onto the manifold (Pose-NDF, eq. 6).

    Raises:
        PoseInvalid: poses are NaN or not in SO(3).
    """
    xp = array_namespace(start, end)
    here, target = prior.project(start, settings), prior.project(end, settings)
    found = []
    for step in range(count):
        share = 1.0 / (count + 1 - step)
        way = log_so3(xp.matmul(target, xp.matrix_transpose(here)))
        here = prior.project(xp.matmul(exp_so3(share * way), here), settings)
        found.append(here)
        progress("Interpolating", step + 1, count)
    return xp.stack(found, axis=1)
