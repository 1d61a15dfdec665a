"""A smooth made-up decoder, so that the solver's equations can be tested without trained weights."""

import numpy as np

from solver_backend.geometry.arrays import array_namespace, constant
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3
from solver_backend.priors.base import PosePrior


class ToyPrior(PosePrior):
    """``R_j = exp(A_j z)``."""

    name = "toy"
    residual_sigma = np.full((21, 3), 0.1)

    def __init__(self, seed: int = 3) -> None:
        self.A = 0.4 * np.random.default_rng(seed).normal(size=(21, 3, 32))

    @property
    def latent_dim(self) -> int:
        return 32

    def decode(self, z):
        xp = array_namespace(z)
        return exp_so3(xp.matmul(constant(self.A, z), z[:, None, :, None])[..., 0])

    def decode_with_jacobian(self, z):
        xp = array_namespace(z)
        A = constant(self.A, z)
        vector = xp.matmul(A, z[:, None, :, None])[..., 0]
        return exp_so3(vector), xp.matmul(left_jacobian_so3(vector), xp.broadcast_to(A, (z.shape[0], *A.shape)))

    def encode(self, rotations):
        raise NotImplementedError

    def energy(self, rotations):
        raise NotImplementedError

    def sample(self, count, seed):
        raise NotImplementedError
