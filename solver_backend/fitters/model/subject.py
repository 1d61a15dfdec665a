"""Define the states of frames and keyframes, the subject, and the normal equations of one posed frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks, PosedLandmarks, pose_landmarks
from solver_backend.body.state_layout import CODE, RESIDUAL, ROOT, TRANSL, UNCOVERED, PoseLayout, StateLayout
from solver_backend.geometry.arrays import Array, Rows, array_namespace, astype, constant, empty, identity, index, zeros
from solver_backend.geometry.interpolation import ZeroMeanSphere, spherical_normalisation
from solver_backend.geometry.parallel import map_blocks
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, quat_from_rotvec, quat_multiply
from solver_backend.geometry.small_matrices import sum_of_rows
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.positions import without_shift
from solver_backend.residuals.terms import PointEvidence, PointTerm, PoseTerm
from solver_backend.types import Motion

CODES = ZeroMeanSphere()
"""Manifold of the codes: unit vectors of zero mean, a sphere of d - 2 dimensions (thesis 6.2.2)."""
ON_THE_MANIFOLD = (CODE, ROOT, TRANSL, UNCOVERED)  # Free blocks of poses that the prior decodes.
OFF_THE_MANIFOLD = (*ON_THE_MANIFOLD, RESIDUAL)  # Every joint may also rotate slightly off the prior's manifold.


def state_layout(prior: PosePrior) -> StateLayout:
    """Return the layout of a state that the prior decodes to a pose."""
    return StateLayout.of(CODES.dimension(prior.latent_dim), len(prior.joints), prior.uncovered)


def decoded(prior: PosePrior, z: Array, residual: Array | None = None) -> Array:
    """Decode codes, and apply residual rotations ρ: ``exp(ρ_j) G_j(z)`` (F, 21, 3, 3) (thesis 6.2.2)."""
    local = prior.decode(z)
    return local if residual is None else array_namespace(z).matmul(exp_so3(residual), local)


def decoded_with_vjp(
    prior: PosePrior, z: Array, residual: Array | None = None
) -> tuple[Array, Callable[[Array], tuple[Array, Array | None]]]:
    """Return ``decoded`` rotations, and a function that propagates derivatives to the inputs.

    The function maps derivatives (F, 21, 3) w.r.t. left tangents to derivatives w.r.t. codes (F, d) and w.r.t.
    residuals (F, 21, 3). The latter are None if there are no residuals.
    """
    xp = array_namespace(z)
    local, decoder_vjp = prior.decode_with_vjp(z)
    if residual is None:
        return local, lambda by_joints: (decoder_vjp(by_joints), None)
    turn, bend = exp_so3(residual), left_jacobian_so3(residual)

    def vjp(by_joints: Array) -> tuple[Array, Array]:
        by_decoded, by_residual = (_transposed(M, by_joints) for M in (turn, bend))
        return decoder_vjp(by_decoded), by_residual

    return xp.matmul(turn, local), vjp


def turned_with_vjp(local: Array, residual: Array) -> tuple[Array, Callable[[Array], tuple[None, Array]]]:
    """Return ``exp(ρ_j) R_j`` for fixed rotations R (F, J, 3, 3), and a function that propagates derivatives to ρ."""
    bend = left_jacobian_so3(residual)
    turned = array_namespace(local).matmul(exp_so3(residual), local)
    return turned, lambda by_joints: (None, _transposed(bend, by_joints))


def _transposed(matrices: Array, vectors: Array) -> Array:
    xp = array_namespace(matrices)
    return xp.matmul(xp.matrix_transpose(matrices), vectors[..., None])[..., 0]


def decoder_jacobian(prior: PosePrior, z: Array, residual: Array | None = None) -> tuple[Array, Array | None]:
    """Return the Jacobians of the joint rotations w.r.t. the code z and w.r.t. the residuals ρ.

    ``dR = [exp(ρ) J_z dz]x R`` and ``dR = [J_l(ρ) dρ]x R``. The derivative only affects steps, so single precision is
    sufficient and halves the time of the most expensive product in a solve.
    """
    xp = array_namespace(z)
    by_code = xp.astype(prior.decode_with_jacobian(xp.astype(z, xp.float32))[1], z.dtype)
    if residual is not None:
        by_code = xp.matmul(exp_so3(residual), by_code)
    by_residual = None if residual is None else left_jacobian_so3(residual)
    return xp.reshape(by_code, (z.shape[0], -1, z.shape[-1])), by_residual


def d_pose_d_key(layout: StateLayout, prior: PosePrior, z: Array, residual: Array | None = None) -> Array:
    """Return the derivatives (F, p, n) of pose tangents w.r.t. the tangents of states or keyframes."""
    if CODE not in layout:
        return d_pose_d_state(layout, None, by_residual=None if residual is None else left_jacobian_so3(residual))
    by_code, by_residual = decoder_jacobian(prior, z, residual)
    by_code = array_namespace(z).matmul(by_code, CODES.tangent_basis(z))
    return d_pose_d_state(layout, by_code, by_residual=by_residual)


def d_pose_d_state(
    layout: StateLayout,
    by_code: Array | None,
    by_root: Array | None = None,
    weight: Array | None = None,
    by_residual: Array | None = None,
) -> Array:
    """Return the derivatives (F, p, n) of pose tangents w.r.t. a weighted state's tangents.

    Args:
        by_code: (F, 3 J, c) derivatives of joints w.r.t. the code, or None if the code is fixed.
        by_root: (F, 6, 6) derivatives of the pose's root motion w.r.t. the state's root motion. None means identity.
        weight: (F,) weights of the state's rotation vectors. None means 1.
        by_residual: (F, J, 3, 3) derivatives of joints w.r.t. their residual rotations. None if there are none.
    """
    like = by_residual if by_code is None else by_code
    assert like is not None
    xp, pose = array_namespace(like), PoseLayout(like.shape[1] if by_code is None else like.shape[1] // 3)
    jacobian = zeros((like.shape[0], pose.dof, layout.dof), like)
    eye = identity(3, like)
    if by_code is not None:
        jacobian[:, pose.joints, layout[CODE]] = by_code
    parts = (pose.root, layout[ROOT], slice(0, 3)), (pose.transl, layout[TRANSL], slice(3, 6))
    for rows, own, i in parts:
        jacobian[:, rows, own] = eye
        if by_root is not None:
            for _, columns, j in parts:
                jacobian[:, rows, columns] = by_root[:, i, j]
    share = (xp.ones_like(jacobian[:, 0, 0]) if weight is None else weight)[:, None, None]
    if by_residual is not None:
        for number, joint in enumerate(layout.turned):
            first = layout.turns.start + 3 * number
            jacobian[:, pose.joint(joint), first : first + 3] = share * by_residual[:, joint]
    return jacobian


@dataclass(frozen=True)
class Keyframes(Rows):
    """Unknowns of K keyframes."""

    z: Array  # (K, 32) unit zero-mean codes.
    quat: Array  # (K, 4) root rotations wxyz, neighbours in one hemisphere.
    transl: Array  # (K, 3) metres.
    residual: Array  # (K, 21, 3) rotations off the manifold, radians.

    def of_windows(self, windows: np.ndarray, free: int = 2) -> Keyframes:
        """Select the n + 1 keyframes of each given window: (W, n + 1), where n is ``free``."""
        return self.select(index(free * windows[:, None] + np.arange(free + 1), self.z))

    def fives(self, windows: np.ndarray) -> Keyframes:
        """Select the three keyframes of each window, and one more keyframe on either side (W, 5)."""
        keys = np.clip(2 * windows[:, None] + np.arange(-1, 4), 0, self.z.shape[0] - 1)
        return self.select(index(keys, self.z))

    def replaced(self, keys: slice, new: Keyframes) -> Keyframes:
        """Replace a range of the keyframes by ``new``."""
        xp = array_namespace(self.z)
        pairs: Any = zip(self.arrays, new.arrays, strict=True)  # no field of keys is None
        return Keyframes(*(xp.concat([old[: keys.start], part, old[keys.stop :]]) for old, part in pairs))

    def retract(self, step: Array, layout: StateLayout) -> Keyframes:
        """Move the keyframes by (K, n) steps in the unknowns of this layout."""
        xp, z, residual = array_namespace(step), self.z, self.residual
        if CODE in layout:
            along = xp.matmul(CODES.tangent_basis(z), step[:, layout[CODE], None])[..., 0]
            z = spherical_normalisation(z + along)
        quat = quat_multiply(quat_from_rotvec(step[:, layout[ROOT]]), self.quat)
        quat = quat / xp.sqrt(xp.sum(quat * quat, axis=-1, keepdims=True))
        if layout.turned:
            residual = residual + rotations_of(step, layout, residual.shape[1])
        return Keyframes(z, quat, self.transl + step[:, layout[TRANSL]], residual)


def rotations_of(step: Array, layout: StateLayout, num_joints: int) -> Array:
    """Return the joint rotation vectors (K, J, 3) in steps (K, n). They are zero for joints that are not unknowns."""
    vectors = array_namespace(step).reshape(step[:, layout.turns], (step.shape[0], -1, 3))
    if layout.turned == tuple(range(num_joints)):
        return vectors
    by_joint = zeros((step.shape[0], num_joints, 3), step)
    by_joint[:, index(np.array(layout.turned, dtype=int), step)] = vectors
    return by_joint


def hemisphere_aligned(keys: Keyframes) -> Keyframes:
    """Flip the signs of root quaternions, so that neighbouring keyframes are in one hemisphere."""
    xp = array_namespace(keys.quat)
    dots = xp.sum(keys.quat[1:] * keys.quat[:-1], axis=-1)
    signs = xp.where(dots < 0, -xp.ones_like(dots), xp.ones_like(dots))
    signs = xp.concat([xp.ones_like(keys.quat[:1, 0]), xp.cumulative_prod(signs)])
    return replace(keys, quat=keys.quat * signs[:, None])


@dataclass(frozen=True)
class FrameStates(Rows):
    """Unknowns of F frames that are solved independently."""

    z: Array  # (F, 32) unit zero-mean codes.
    root: Array  # (F, 3, 3) body to world.
    transl: Array  # (F, 3) metres.
    residual: Array | None = None  # (F, J, 3) rotations off the manifold in radians, None if joints stay on it.

    def retract(self, step: Array, layout: StateLayout) -> FrameStates:
        """Move the states by (F, n) steps in this layout."""
        xp, residual = array_namespace(step), self.residual
        moved = self.z + xp.matmul(CODES.tangent_basis(self.z), step[:, layout[CODE], None])[..., 0]
        root = xp.matmul(exp_so3(step[:, layout[ROOT]]), self.root)
        if residual is not None and layout.turned:
            residual = residual + rotations_of(step, layout, residual.shape[1])
        return FrameStates(spherical_normalisation(moved), root, self.transl + step[:, layout[TRANSL]], residual)


BLOCK_POSES = 500  # Number of frames posed at a time. Affects only time and memory.


@dataclass(frozen=True)
class PosedFrames(Rows):
    """Poses of a body in F frames."""

    root: Array  # (F, 3, 3) body to world.
    local: Array  # (F, J, 3, 3) rotations of the J joints after the root.
    transl: Array  # (F, 3) metres.

    @property
    def layout(self) -> PoseLayout:
        """Layout of the tangent of one frame's pose."""
        return PoseLayout(self.local.shape[1])

    @classmethod
    def of_motion(cls, motion: Motion, like: Array) -> PosedFrames:
        """Return a motion's poses, for the joints that a solve rotates."""
        vectors = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, : motion.body_layout.num_solved]
        root, local = (exp_so3(constant(part, like)) for part in (motion.global_orient, vectors))
        return cls(root, local, constant(motion.transl, like))

    def retract(self, step: Array) -> PosedFrames:
        """Move the poses by (F, p) steps: ``exp([δ]x) R`` and ``t + δ`` (see ``PoseLayout``)."""
        xp, layout = array_namespace(step), self.layout
        turns = exp_so3(xp.reshape(step[:, layout.rotations], (step.shape[0], -1, 3)))
        root, local = xp.matmul(turns[:, 0], self.root), xp.matmul(turns[:, 1:], self.local)
        return PosedFrames(root, local, self.transl + step[:, layout.transl])


@dataclass(frozen=True)
class SkinTerms:
    """Objective terms on S points of the skin, which are not measured."""

    landmarks: Landmarks  # The person's L landmarks, followed by the S points.
    points: tuple[PointTerm, ...]  # On the S points.

    def worn_by(self, subject: Subject) -> Subject:
        """Return the subject with its own landmarks, followed by the skin points."""
        more = zeros((len(self.landmarks) - len(subject.landmarks), 3), subject.offsets)
        offsets = array_namespace(more).concat([subject.offsets, more])
        return replace(subject, landmarks=self.landmarks, offsets=offsets)


@dataclass(frozen=True)
class FrameObjective:
    """Terms of the objective on F frames."""

    points: tuple[PointTerm, ...]  # On landmark positions. At least one.
    poses: tuple[PoseTerm, ...] = ()  # On the joints' rotations.
    relative: tuple[PointTerm, ...] = ()  # On landmark positions, regardless of a common shift.
    skin: SkinTerms | None = None  # On points of the skin.

    def __add__(self, other: FrameObjective) -> FrameObjective:
        relative = self.relative + other.relative
        return FrameObjective(self.points + other.points, self.poses + other.poses, relative, self.skin or other.skin)

    def select(self, frames: Any) -> FrameObjective:
        """Return the terms for frames that are selected by indices or a slice."""
        return self._each(lambda term: term.select(frames))

    def astype(self, precision: Any) -> FrameObjective:
        """Convert the terms to a floating-point precision."""
        return self._each(lambda term: term.astype(precision))

    def _each(self, change: Callable[[Any], Any]) -> FrameObjective:
        skin = self.skin and replace(self.skin, points=tuple(map(change, self.skin.points)))
        points, poses, relative = (tuple(map(change, terms)) for terms in (self.points, self.poses, self.relative))
        return FrameObjective(points, poses, relative, skin)

    def of_points(self, points: Array, scale: float) -> PointEvidence:
        """Return the summed evidence of all point terms at (F, L, 3) positions in metres."""
        return reduce(add, [term(points, scale) for term in self.points])


@dataclass(frozen=True)
class Subject:
    """A person's body model and all quantities that are constant over a take."""

    body: Body
    landmarks: Landmarks
    betas: Array  # (10,) shape.
    offsets: Array  # (L, 3) metres: bias of each landmark in the rest pose.

    @classmethod
    def average(cls, body: Body, landmarks: Landmarks, like: Array) -> Subject:
        """Return the average person without landmark bias. Arrays get the backend and precision of ``like``."""
        return cls(body, landmarks, constant(np.zeros(10), like), constant(np.zeros((len(landmarks), 3)), like))

    def astype(self, precision: Any) -> Subject:
        """Convert the person's arrays to a floating-point precision."""
        return replace(self, betas=astype(self.betas, precision), offsets=astype(self.offsets, precision))


@dataclass(frozen=True)
class FrameEquations:
    """Cost and Gauss-Newton model of each frame's objective around its pose."""

    cost: Array  # (F,).
    gradient: Array  # (F, p).
    _form: Callable[[], Array]

    @cached_property
    def hessian(self) -> Array:
        """(F, p, p) Hessians of the frames that were requested, computed on first use."""
        return self._form()


def pose(subject: Subject, frames: PosedFrames, *, jacobian: bool = False, by_shape: bool = True) -> PosedLandmarks:
    """Return the subject's landmarks in the given poses (see ``pose_landmarks``)."""
    person, poses = (subject.body, subject.landmarks, subject.betas), (frames.root, frames.local, frames.transl)
    return pose_landmarks(*person, *poses, offsets=subject.offsets, jacobian=jacobian, by_shape=by_shape)


def points_of(subject: Subject, frames: PosedFrames) -> Array:
    """Return the subject's landmarks (F, L, 3) in metres, computed in blocks of frames."""
    blocks = [slice(start, start + BLOCK_POSES) for start in range(0, frames.transl.shape[0], BLOCK_POSES)]
    parts = map_blocks(lambda block: pose(subject, frames.select(block)).points, blocks, frames.transl)
    return array_namespace(frames.transl).concat(parts)


def frame_equations(
    subject: Subject,
    frames: PosedFrames,
    objective: FrameObjective,
    scale: float,
    hessian_frames: np.ndarray | slice | None = None,
) -> FrameEquations:
    """Return the gradient ``g = Jᵀ e`` and Hessian ``H = Jᵀ Λ J`` of each frame w.r.t. its pose.

    Args:
        objective: terms on these frames.
        hessian_frames: frames for which Hessians are computed. These are in single precision, because they only affect
          steps. None forms all Hessians in the poses' precision.
    """
    skin = objective.skin
    posed = pose(subject if skin is None else skin.worn_by(subject), frames, jacobian=True, by_shape=False)
    points = posed.points if skin is None else posed.points[:, : len(subject.landmarks)]
    xp = array_namespace(points)
    count = points.shape[0]
    shifted = [term(points, scale) for term in objective.relative]
    data = reduce(add, shifted, objective.of_points(points, scale))
    if skin is not None:
        data = data.beside(reduce(add, [term(posed.points[:, points.shape[1] :], scale) for term in skin.points]))
    poses = [term(frames.local) for term in objective.poses]
    J = posed.by_rotations
    assert J is not None
    J_T = xp.matrix_transpose(xp.reshape(J, (count, -1, J.shape[-1])))
    by_rotations = xp.matmul(J_T, xp.reshape(data.gradient, (count, -1, 1)))[..., 0]
    cost = data.cost
    for term in poses:
        by_rotations[:, frames.layout.joints] += term.gradient
        cost = cost + term.cost
    gradient = xp.concat([by_rotations, sum_of_rows(data.gradient)], axis=-1)
    about = [evidence.information for evidence in shifted]
    parts = [J, data.information, *about, *(term.factors for term in poses)]
    if hessian_frames is not None:
        chosen = hessian_frames if isinstance(hessian_frames, slice) else index(hessian_frames, J)
        parts = [astype(part[chosen], xp.float32) for part in parts]
    return FrameEquations(cost, gradient, lambda: _hessian(objective.poses, len(about), *parts))


def _hessian(
    terms: tuple[PoseTerm, ...], shifted: int, by_rotations: Array, information: Array, *factors: Array
) -> Array:
    xp = array_namespace(by_rotations)
    count, num_landmarks, _, rotations = by_rotations.shape
    weighted = xp.matmul(information, by_rotations)
    tall, layout = (count, 3 * num_landmarks, rotations), PoseLayout(rotations // 3 - 1)
    across, hessian = xp.sum(weighted, axis=1), empty((count, layout.dof, layout.dof), by_rotations)
    hessian[:, layout.rotations, layout.rotations] = xp.matmul(
        xp.matrix_transpose(xp.reshape(by_rotations, tall)), xp.reshape(weighted, tall)
    )
    hessian[:, layout.transl, layout.rotations] = across
    hessian[:, layout.rotations, layout.transl] = xp.matrix_transpose(across)
    hessian[:, layout.transl, layout.transl] = xp.reshape(
        sum_of_rows(xp.reshape(information, (count, num_landmarks, 9))), (count, 3, 3)
    )
    for part in factors[:shifted]:
        total = xp.sum(part, axis=1)
        rows = xp.concat([xp.sum(xp.matmul(part, by_rotations[:, : part.shape[1]]), axis=1), total], axis=-1)
        hessian -= without_shift(rows, total)
    for term, part in zip(terms, factors[shifted:], strict=True):
        hessian[:, layout.joints, layout.joints] += term.hessian(part)
    return hessian
