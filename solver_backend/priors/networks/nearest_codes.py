"""Codes moved towards the poses they stand for: what an encoder guesses, a decoder's derivative mends."""

from __future__ import annotations

from collections.abc import Callable

from solver_backend.body.rest_skeleton import REST_JOINTS
from solver_backend.exchange.joint_sets import NUM_JOINTS, SMPL_PARENTS
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity
from solver_backend.geometry.rotations import log_so3, skew
from solver_backend.priors.base import CodeJacobian, Codes, Poses

TURN_M = 0.07
"""A joint's turn counts like the way of a point so far from it: what skin and keypoints about a joint move."""
DAMPING = 0.1
"""Against the mean curvature over the code's directions: those that hardly move the body keep the encoder's value."""
_BLOCK = 256  # Poses whose equations are formed at a time.


def nearer_codes(decode: Callable[[Codes], tuple[Poses, CodeJacobian]], rotations: Poses, z: Codes) -> Codes:
    """Return codes one damped Gauss-Newton step nearer to poses: ``z + (JᵀJ + λ tr(JᵀJ)/d I)⁻¹ Jᵀ r``.

    ``r`` holds, for an unturned pelvis, what joints lack to those of the pose, ``p*_j - p_j``, and 7 cm times the turn
    that each joint's global rotation lacks, ``ℓ log(G*_j G_jᵀ)``.

    Args:
        decode: rotations (N, 21, 3, 3) of codes and their left tangents by the code, (N, 21, 3, d).
        rotations: (N, 21, 3, 3) local rotations.
        z: (N, d) codes to begin at.

    Reference: Levenberg 1944, Marquardt 1963.
    """
    xp = array_namespace(z)
    parts = [slice(first, first + _BLOCK) for first in range(0, max(1, z.shape[0]), _BLOCK)]
    return xp.concat([z[part] + _step(rotations[part], *decode(z[part])) for part in parts], axis=0)


def _step(truth: Poses, decoded: Poses, by_code: CodeJacobian) -> Codes:
    xp = array_namespace(decoded)
    r, J = misfit(truth, decoded, by_code)
    H = xp.matmul(xp.permute_dims(J, (0, 2, 1)), J)
    g = xp.matmul(xp.permute_dims(J, (0, 2, 1)), r[..., None])
    mean = xp.sum(J * J, axis=(1, 2)) / J.shape[2]
    return xp.linalg.solve(H + DAMPING * mean[:, None, None] * identity(J.shape[2], J), g)[..., 0]


def misfit(truth: Poses, decoded: Poses, by_code: CodeJacobian) -> tuple[Array, Array]:
    """Return what decoded poses lack to the truth, and its negative derivative by the code.

    Joints' velocities come down the tree: ``ω_j = ω_p + G_p J_j`` and ``v_j = v_p + ω_p x (p_j - p_p)``.

    Args:
        truth: (N, 21, 3, 3).
        decoded: (N, 21, 3, 3).
        by_code: (N, 21, 3, d) left tangents of the decoded rotations.

    Returns:
        r (N, 132) metres: joints 1..23, then turns of joints 1..21; J (N, 132, d).
    """
    xp = array_namespace(decoded)
    eye, rest = xp.zeros_like(decoded[:, 0]) + identity(3, decoded), constant(REST_JOINTS, decoded)
    G, wanted, gaps = [eye], [eye], [xp.zeros_like(decoded[:, 0, 0])]
    omega, velocity = [xp.zeros_like(by_code[:, 0])], [xp.zeros_like(by_code[:, 0])]
    for j in range(1, NUM_JOINTS):
        p, bone = SMPL_PARENTS[j], rest[j] - rest[SMPL_PARENTS[j]]
        arm = xp.matmul(G[p], bone)
        gaps.append(gaps[p] + xp.matmul(wanted[p], bone) - arm)
        velocity.append(velocity[p] - xp.matmul(skew(arm), omega[p]))
        if j <= decoded.shape[1]:
            omega.append(omega[p] + xp.matmul(G[p], by_code[:, j - 1]))
            G.append(xp.matmul(G[p], decoded[:, j - 1]))
            wanted.append(xp.matmul(wanted[p], truth[:, j - 1]))
    turns = log_so3(xp.matmul(xp.stack(wanted[1:], axis=1), xp.permute_dims(xp.stack(G[1:], axis=1), (0, 1, 3, 2))))
    r = xp.concat((xp.stack(gaps[1:], axis=1), TURN_M * turns), axis=1)
    J = xp.concat((xp.stack(velocity[1:], axis=1), TURN_M * xp.stack(omega[1:], axis=1)), axis=1)
    count, rows, _, width = J.shape
    return xp.reshape(r, (count, 3 * rows)), xp.reshape(J, (count, 3 * rows, width))
