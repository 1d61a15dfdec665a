"""A prior without reconstruction error: SPoser, corrected to reproduce every true pose of a take exactly."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, log_so3
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.sposer import SPoser

SHARPNESS = 2000.0  # A true pose corrects codes within about 2 degrees.


class TruthPrior(AutoencodingPrior):
    """``R_j(z) = exp(ρ_j(z)) G_j(z)`` with ``ρ(z) = Σ_i softmax_i(κ z·z_i) ρ_i`` over the take's poses i.

    G is SPoser's decoder, z_i the code of the i-th true pose and ``ρ_i = log(R_i G(z_i)ᵀ)`` its reconstruction error.
    Close to z_i the result is the true pose, and frames between true poses are mixtures.
    """

    def __init__(self, prior: SPoser, rotations: np.ndarray) -> None:
        self._prior, self.metadata = prior, {}
        self._codes = prior.encode(rotations)
        self._bends = log_so3(rotations @ np.swapaxes(prior.decode(self._codes), -1, -2)).reshape(len(rotations), -1)
        self.residual_sigma = np.full((rotations.shape[1], 3), 1e-3)  # leaves nothing for rotations off the manifold

    name = "truth"

    @property
    def latent_dim(self) -> int:
        """Length of a code, 32."""
        return self._prior.latent_dim

    def encode(self, rotations: Array) -> Array:
        """Return SPoser's codes."""
        return self._prior.encode(rotations)

    def decode(self, z: Array) -> Array:
        """Return SPoser's poses, corrected."""
        xp = array_namespace(z)
        return xp.matmul(exp_so3(self._bend(z)[0]), self._prior.decode(z))

    def decode_with_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Return poses and ``J = J_l(ρ) dρ/dz + exp(ρ) J_G`` with ``dρ/dz = κ Σ_i w_i ρ_i (z_i - Σ_k w_k z_k)ᵀ``."""
        xp = array_namespace(z)
        bend, by_code = self._bend(z)
        turn, (decoded, jacobian) = exp_so3(bend), self._prior.decode_with_jacobian(z)
        return xp.matmul(turn, decoded), xp.matmul(left_jacobian_so3(bend), by_code) + xp.matmul(turn, jacobian)

    def energy(self, rotations: Array) -> Array:
        """Return SPoser's energy."""
        return self._prior.energy(rotations)

    def sample(self, count: int, seed: int) -> Any:
        """Return corrected poses of codes drawn as in SPoser."""
        return self.decode(self.encode(self._prior.sample(count, seed)))

    def _bend(self, z: Array) -> tuple[Array, Array]:
        """Return ρ (N, 21, 3) and its derivative by the code (N, 21, 3, 32)."""
        xp = array_namespace(z)
        codes, bends = constant(self._codes, z), constant(self._bends, z)
        closeness = SHARPNESS * xp.matmul(z, codes.T)
        share = xp.exp(closeness - xp.max(closeness, axis=-1, keepdims=True))
        share = share / xp.sum(share, axis=-1, keepdims=True)
        bend, mean = xp.matmul(share, bends), xp.matmul(share, codes)
        spread = xp.matmul(xp.matrix_transpose(share[..., None] * bends), codes) - bend[..., None] * mean[:, None]
        return xp.reshape(bend, (-1, 21, 3)), SHARPNESS * xp.reshape(spread, (-1, 21, 3, z.shape[-1]))
