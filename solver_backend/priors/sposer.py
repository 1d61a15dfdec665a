"""Define SPoser, an autoencoder of poses with codes on a sphere (thesis 6.2.2)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from solver_backend.body.rest_skeleton import REST_JOINTS
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, NUM_JOINTS, SMPL_PARENTS
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import log_so3, matrix_to_6d, skew
from solver_backend.priors.autoencoder import PoseAutoencoder
from solver_backend.priors.base import CodeJacobian, Codes, Energies, Poses, check_rotations
from solver_backend.priors.weights import ASSETS, read_stack, read_weights

TURN_M = 0.07  # Arm length in metres that converts rotations to distances, roughly from bone to skin.
DAMPING = 0.1  # Relative to the mean curvature over the code's directions. Flat directions keep the encoder's value.
_BLOCK = 256  # Number of poses whose equations are formed at a time.


def nearer_codes(decode: Callable[[Codes], tuple[Poses, CodeJacobian]], rotations: Poses, z: Codes) -> Codes:
    """Move codes closer to poses by one damped Gauss-Newton step: ``z + (JᵀJ + λ tr(JᵀJ)/d I)⁻¹ Jᵀ r``.

    The residual r compares the given pose (*) with the decoded pose, both with the pelvis at rest. It contains the
    offsets of the joint positions, ``p*_j - p_j``, and of the global rotations, ``ℓ log(G*_j G_jᵀ)`` with ℓ = 7 cm
    (Levenberg 1944, Marquardt 1963).

    Args:
        decode: maps codes to (N, 21, 3, 3) rotations and (N, 21, 3, d) derivatives of their left tangents.
        rotations: (N, 21, 3, 3) local rotations.
        z: (N, d) initial codes.
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
    """Return the errors r (N, 132) of decoded poses in metres, and J (N, 132, d), which is ``-dr/dz``.

    Positions of joints 1..23 come first, then rotations of joints 1..21. Velocities propagate down the tree:
    ``ω_j = ω_p + G_p J_j`` and ``v_j = v_p + ω_p x (p_j - p_p)``. Poses are (N, 21, 3, 3), and ``by_code`` is (N, 21,
    3, d).
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


LATENT_DIM = 32  # Length of a code, as in VPoser (Pavlakos et al. 2019).
DEFAULT_WEIGHTS: Path = ASSETS / "sposer.npz"


class SPoser(PoseAutoencoder):
    """Pose autoencoder with zero-mean unit vectors in R^32 as codes, a sphere of 30 dimensions."""

    name = "sposer"

    def encode(self, rotations: Poses) -> Codes:
        """Encode rotations (N, 21, 3, 3) as codes (N, 32), unit vectors of zero mean.

        One step with the decoder's derivatives improves the encoder's estimate (``nearer_codes``).
        """
        guess = self.guess(rotations)
        return spherical_normalisation(nearer_codes(self.decode_with_jacobian, rotations, guess))

    def guess(self, rotations: Poses) -> Codes:
        """Return the encoder's estimate of the codes, which ``encode`` improves."""
        check_rotations(rotations)
        xp = array_namespace(rotations)
        features = xp.reshape(matrix_to_6d(rotations), (rotations.shape[0], 6 * NUM_BODY_JOINTS))
        return spherical_normalisation(self._encoded(features))

    def energy(self, rotations: Poses) -> Energies:
        """Return the (N,) mean squared rotation from reconstructions to poses, in units of ``residual_sigma``."""
        return self._distance_to_reconstruction(rotations)

    def sample(self, count: int, seed: int) -> Poses:
        """Decode ``count`` random codes, drawn uniformly from the sphere."""
        return self.decode(spherical_normalisation(np.random.default_rng(seed).standard_normal((count, LATENT_DIM))))


def load_sposer(path: Path | str = DEFAULT_WEIGHTS) -> SPoser:
    """Load the weights of SPoser, the default pose prior.

    Raises:
        FileMissing, WeightsInvalid: see ``read_weights``.
    """
    weights = read_weights(Path(path), "sposer")
    features = 6 * NUM_BODY_JOINTS
    encoder = read_stack(weights, "encoder", features, LATENT_DIM)
    decoder = read_stack(weights, "decoder", LATENT_DIM, features)
    sigma = weights.array("residual_sigma", (NUM_BODY_JOINTS, 3))
    return SPoser(encoder, decoder, sigma, {**weights.metadata, "sha256": weights.sha256})
