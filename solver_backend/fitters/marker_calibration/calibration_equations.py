"""The normal equations of a calibration: each frame's pose is a block, shape and places are shared.

``E = Σ_f [ Σ_l ρ(|y_l(x_f, β, o) - m_fl| / σ) + w (E_pose(x_f) + ½ ρ_fᵀ R ρ_f) ] + ½ |β|² + ½ Σ_l o_lᵀ P_l o_l``

Poses are eliminated frame by frame (Triggs et al. 2000, "Bundle adjustment: a modern synthesis"); shape
and places were first found together with poses by Loper, Mahmood and Black 2014, "MoSh".
"""

from __future__ import annotations

from dataclasses import dataclass

from array_api_compat import array_namespace

from solver_backend.fitters.marker_calibration.calibration_state import CalibrationState
from solver_backend.fitters.model.codes import d_pose_d_key
from solver_backend.fitters.model.keyframe_curve import turns_of
from solver_backend.fitters.model.subject import pose
from solver_backend.fitters.objective import FrameObjective
from solver_backend.geometry.arrays import Array, constant, identity, zeros
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.residuals.point_term import PointEvidence
from solver_backend.solver.normal_equations import Arrowhead

FLOOR = 1e-2
"""Precision that every unknown of a pose has."""


@dataclass(frozen=True)
class PlacementPrior:
    """What is known of a person before the calibration."""

    shape: Array
    """(10,) precision of the shape around the mean person's, or around a known one."""
    shape_mean: Array
    """(10,)."""
    places: Array
    """(L, 3, 3) precision of each marker's offset from its rule in the rest frame, 1/m²."""


def calibration_equations(
    prior: AutoencodingPrior, objective: FrameObjective, placement: PlacementPrior, state: CalibrationState,
    scale: float, pose_weight: float = 1.0,
) -> tuple[Array, Arrowhead]:  # fmt: skip
    """Return the cost (1,) and the Gauss-Newton equations at a state.

    Args:
        prior: decoder of the codes.
        objective: of the frames.
        placement: what is known of shape and places.
        state: where.
        scale: of Geman-McClure's penalty.
        pose_weight: w, of what is known of poses.
    """
    xp = array_namespace(state.residual)
    frames, turns = state.poses(prior), state.layout.turns
    by_state = d_pose_d_key(state.layout, prior, state.frames.z, state.residual)
    posed = pose(state.subject, frames, jacobian=True)
    count, num = posed.points.shape[:2]
    eye = xp.broadcast_to(identity(3, posed.points), (count, num, 3, 3))
    by_pose = xp.matmul(xp.concat([posed.by_rotations, eye], axis=-1), by_state[:, None])
    evidence = objective.of_points(posed.points, scale)
    shared, g_shared, coupling = _shared(evidence, by_pose, posed.by_betas, posed.by_offsets)
    weighted = xp.matmul(evidence.information, by_pose)
    tall = (count, 3 * num, by_pose.shape[-1])
    flat_T = xp.matrix_transpose(xp.reshape(by_pose, tall))
    blocks = xp.matmul(flat_T, xp.reshape(weighted, tall)) + FLOOR * identity(tall[-1], by_pose)
    g_blocks = xp.matmul(flat_T, xp.reshape(evidence.gradient, (count, -1, 1)))[..., 0]
    cost = xp.sum(evidence.cost)
    by_joints = by_state[:, frames.layout.joints]
    by_joints_T = xp.matrix_transpose(by_joints)
    for term in objective.poses:
        found = term(frames.local)
        blocks = blocks + pose_weight * xp.matmul(by_joints_T, xp.matmul(term.hessian(found.factors), by_joints))
        g_blocks = g_blocks + pose_weight * xp.matmul(by_joints_T, found.gradient[..., None])[..., 0]
        cost = cost + pose_weight * xp.sum(found.cost)
    off = turns_of(xp.reshape(state.residual, (count, -1)), state.layout)
    sigma = prior.residual_sigma[list(state.layout.turned)]
    stiff = constant(pose_weight * sigma.reshape(-1) ** -2.0, off)
    blocks[:, turns, turns] += stiff * identity(off.shape[1], off)
    g_blocks[:, turns] += stiff * off
    known, system = _with_placement(placement, state, Arrowhead(blocks, coupling, shared, g_blocks, g_shared))
    return (cost + 0.5 * xp.sum(stiff * off * off) + known)[None], system


def _shared(
    evidence: PointEvidence, by_pose: Array, by_betas: Array, by_offsets: Array
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return what the frames contribute to shape and places: (m, m), (m,), and how poses meet them, (F, n, m)."""
    xp = array_namespace(by_pose)
    count, num = by_pose.shape[:2]
    size = 10 + 3 * num
    weighted_betas = xp.matmul(evidence.information, by_betas)
    weighted_offsets = xp.matmul(evidence.information, by_offsets)
    flat = (count * num * 3, 10)
    shared = zeros((size, size), by_pose)
    shared[:10, :10] = xp.matmul(xp.reshape(by_betas, flat).T, xp.reshape(weighted_betas, flat))
    crossed = xp.sum(xp.matmul(xp.matrix_transpose(by_betas), weighted_offsets), axis=0)
    shared[:10, 10:] = xp.reshape(xp.permute_dims(crossed, (1, 0, 2)), (10, -1))
    shared[10:, :10] = shared[:10, 10:].T
    own = xp.sum(xp.matmul(xp.matrix_transpose(by_offsets), weighted_offsets), axis=0)
    for i in range(num):
        shared[10 + 3 * i : 13 + 3 * i, 10 + 3 * i : 13 + 3 * i] = own[i]
    gradient = evidence.gradient[..., None]
    by_place = xp.sum(xp.matmul(xp.matrix_transpose(by_offsets), gradient), axis=0)
    by_shape = xp.sum(xp.matmul(xp.matrix_transpose(by_betas), gradient), axis=(0, 1))
    g_shared = xp.concat([by_shape[:, 0], xp.reshape(by_place, (-1,))])
    by_pose_T = xp.matrix_transpose(by_pose)
    with_betas = xp.sum(xp.matmul(by_pose_T, weighted_betas), axis=1)
    with_places = xp.permute_dims(xp.matmul(by_pose_T, weighted_offsets), (0, 2, 1, 3))
    coupling = xp.concat([with_betas, xp.reshape(with_places, (count, by_pose.shape[-1], -1))], axis=-1)
    return shared, g_shared, coupling


def _with_placement(
    placement: PlacementPrior, state: CalibrationState, system: Arrowhead
) -> tuple[Array, Arrowhead]:  # fmt: skip
    """Return the cost of shape and places, and the equations with what was known of them added in place."""
    xp = array_namespace(system.shared)
    shape = state.subject.betas - placement.shape_mean
    places = state.subject.offsets
    pulled = xp.matmul(placement.places, places[..., None])[..., 0]
    system.shared[:10, :10] += placement.shape * identity(10, shape)
    for i in range(len(places)):
        part = slice(10 + 3 * i, 13 + 3 * i)
        system.shared[part, part] += placement.places[i]
    system.g_shared[:10] += placement.shape * shape
    system.g_shared[10:] += xp.reshape(pulled, (-1,))
    return 0.5 * (xp.sum(placement.shape * shape * shape) + xp.sum(pulled * places)), system
