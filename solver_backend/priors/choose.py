"""Load a pose prior by name or from a weights file, and map Gaussian codes to a sphere."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np

from solver_backend.exchange.errors import FileMissing, JobInvalid
from solver_backend.exchange.solve_settings import AUTO_PRIOR, PRIORS
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity
from solver_backend.priors.base import AutoencodingPrior, CodeJacobian, Codes, Energies, Poses
from solver_backend.priors.gaussian_vae import GaussianVAE, VaeName, load_vae
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.weights import read_weights

SPHERICAL, ROBUST = "sposer", "rvposer"
NAMES = tuple(prior.value for prior in PRIORS[1:])
LEAST_HEIGHT = 0.05
"""Smallest last coordinate b of a code. It belongs to Gaussian codes 20 times as long as usual. Smaller ones are
clipped."""


class GaussianOnSphere(AutoencodingPrior):
    """Gaussian prior with codes on a sphere: zero-mean unit vectors ``u = B (z, s) / |(z, s)|`` with ``s = √d``.

    B (d + 2, d + 1) spans the vectors of zero mean. The inverse is the central projection ``z = s a / b`` of
    ``(a, b) = Bᵀ u``. It maps great circles to straight lines, so SLERP follows the segment between Gaussian codes.
    """

    def __init__(self, prior: GaussianVAE) -> None:
        self._prior, self.name, self.metadata = prior, prior.name, prior.metadata
        self.residual_sigma = prior.residual_sigma
        count = prior.latent_dim + 2
        self._basis = np.linalg.svd(np.eye(count) - 1.0 / count)[0][:, :-1]
        self._scale = float(np.sqrt(prior.latent_dim))

    @property
    def latent_dim(self) -> int:
        """Number of entries in a code, two more than in a code of the Gaussian prior."""
        return self._prior.latent_dim + 2

    def encode(self, rotations: Poses) -> Codes:
        """Return the posterior means of the codes, mapped to the sphere."""
        z = self._prior.encode(rotations)
        xp = array_namespace(z)
        raised = xp.concat([z, self._scale * xp.ones_like(z[:, :1])], axis=-1)
        unit = raised / xp.sqrt(xp.sum(raised * raised, axis=-1, keepdims=True))
        return xp.matmul(unit, constant(self._basis.T, z))

    def decode(self, z: Codes) -> Poses:
        """Project the codes to Gaussian codes, and decode these to rotations."""
        return self._prior.decode(self._flat(z)[0])

    def decode_with_jacobian(self, z: Codes) -> tuple[Poses, CodeJacobian]:
        """Return decoded poses and their Jacobian ``dω/dz dz/du`` with ``dz/du = s/b (I, -a/b) Bᵀ``."""
        xp, (flat, height) = array_namespace(z), self._flat(z)
        rotations, jacobian = self._prior.decode_with_jacobian(flat)
        eye = identity(flat.shape[-1], flat) * xp.ones_like(flat)[:, :, None]
        by_parts = xp.concat([self._scale * eye, -flat[:, :, None]], axis=-1) / height[:, :, None]
        by_code = xp.matmul(by_parts, constant(self._basis.T, z))
        return rotations, xp.matmul(jacobian, by_code[:, None])

    def energy(self, rotations: Poses) -> Energies:
        """Return the Gaussian prior's energy."""
        return self._prior.energy(rotations)

    def sample(self, count: int, seed: int) -> Poses:
        """Draw ``count`` poses from the Gaussian prior."""
        return self._prior.sample(count, seed)

    def _flat(self, u: Array) -> tuple[Array, Array]:
        """Convert codes u on the sphere to Gaussian codes (N, d). Also return the last column b (N, 1) of ``Bᵀ u``."""
        xp, parts = array_namespace(u), array_namespace(u).matmul(u, constant(self._basis, u))
        height = xp.clip(parts[:, -1:], LEAST_HEIGHT)
        return self._scale * parts[:, :-1] / height, height


def load_prior(choice: str = AUTO_PRIOR) -> AutoencodingPrior:
    """Load a prior by name or file, with zero-mean unit codes. The default is SPoser.

    Raises:
        FileMissing, WeightsInvalid, JobInvalid: the file is missing or invalid, or a solve cannot decode the prior.
    """
    found = _load(SPHERICAL if choice == AUTO_PRIOR else choice)
    return GaussianOnSphere(found) if isinstance(found, GaussianVAE) else found


def load_gaussian(choice: str = AUTO_PRIOR) -> GaussianVAE:
    """Load a prior with Gaussian codes. The default is RVPoser (thesis 4.2.4).

    Raises:
        FileMissing, WeightsInvalid: see ``read_weights``.
        JobInvalid: the prior has no Gaussian codes.
    """
    found = _load(ROBUST if choice == AUTO_PRIOR else choice)
    if not isinstance(found, GaussianVAE):
        hint = "Use the prior rvposer or vposer, or another method."
        raise JobInvalid("The method 'noise-aware' needs a prior with Gaussian codes.", where=choice, hint=hint)
    return found


def _load(choice: str) -> AutoencodingPrior:
    if choice in NAMES:
        return _load_named(choice)
    path = Path(os.path.expanduser(choice))
    if not path.is_file():
        hint = f"Use one of {', '.join(NAMES)}, or specify a weights file written by train."
        raise FileMissing(f"There is no prior or file {choice!r}.", hint=hint)
    name = read_weights(path, None).prior
    if name == SPHERICAL:
        return load_sposer(path)
    if name in get_args(VaeName):
        return load_vae(name, path)  # type: ignore[arg-type]
    hint = f"Use one of {', '.join(NAMES)}, or a file written by train for one of these."
    raise JobInvalid(f"A solve cannot decode the prior {name!r}.", where=path.name, hint=hint)


@cache
def _load_named(choice: str) -> AutoencodingPrior:
    return load_sposer() if choice == SPHERICAL else load_vae(choice)  # type: ignore[arg-type]
