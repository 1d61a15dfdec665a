"""VPoser and RVPoser: variational autoencoders of poses with a Gaussian code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from array_api_compat import array_namespace

from solver_backend.errors import WeightsInvalid
from solver_backend.geometry.arrays import Array
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.base import PosePrior, check_codes, check_rotations
from solver_backend.priors.decoder import (
    decoded_rotations,
    decoded_rotations_with_jacobian,
    decoded_rotations_with_pullback,
)
from solver_backend.priors.dense import DenseStack
from solver_backend.priors.weights import ASSETS, read_stack, read_weights
from solver_backend.types.joint_sets import NUM_BODY_JOINTS

LATENT_DIM = 32
VaeName = Literal["vposer", "rvposer"]
"""``vposer`` as published (Pavlakos et al. 2019); ``rvposer`` its robust variant (thesis 4.2.4)."""


class GaussianVAE(PosePrior):
    """Poses as codes in R^32 that are standard normal over the training poses."""

    def __init__(self, name: VaeName, encoder: DenseStack, decoder: DenseStack, metadata: dict[str, Any]) -> None:
        self._name, self._encoder, self._decoder = name, encoder, decoder
        self.metadata = metadata

    @property
    def name(self) -> str:
        """``"vposer"`` or ``"rvposer"``."""
        return self._name

    @property
    def latent_dim(self) -> int:
        """32."""
        return LATENT_DIM

    def posterior(self, rotations: Array) -> tuple[Array, Array]:
        """Return the mean and the standard deviation (N, 32) of the codes of (N, 21, 3, 3) poses.

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        check_rotations(rotations)
        xp = array_namespace(rotations)
        features = xp.reshape(log_so3(rotations), (rotations.shape[0], 3 * NUM_BODY_JOINTS))
        out = self._encoder.like(rotations)(features)
        return out[:, :LATENT_DIM], xp.exp(0.5 * out[:, LATENT_DIM:])

    def encode(self, rotations: Array) -> Array:
        """Return the posterior means (N, 32)."""
        return self.posterior(rotations)[0]

    def decode(self, z: Array) -> Array:
        """Return (N, 21, 3, 3) local rotations of (N, 32) codes.

        Raises:
            PoseInvalid: NaN or another code length.
        """
        check_codes(z, LATENT_DIM)
        return decoded_rotations(self._decoder.like(z), z)

    def decode_with_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Return ``decode(z)`` and its left tangents by the code, (N, 21, 3, 32)."""
        check_codes(z, LATENT_DIM)
        return decoded_rotations_with_jacobian(self._decoder.like(z), z)

    def decode_with_pullback(self, z: Array) -> tuple[Array, Callable[[Array], Array]]:
        """Return ``decode(z)`` and ``v -> J_zᵀ v`` in reverse mode."""
        check_codes(z, LATENT_DIM)
        return decoded_rotations_with_pullback(self._decoder.like(z), z)

    def energy(self, rotations: Array) -> Array:
        """Return half the squared length of the code, minus the log density of the standard normal: (N,)."""
        z = self.encode(rotations)
        return 0.5 * array_namespace(z).sum(z * z, axis=-1)

    def sample(self, count: int, seed: int) -> np.ndarray:
        """Return ``count`` poses of standard normal codes."""
        return self.decode(np.random.default_rng(seed).standard_normal((count, LATENT_DIM)))


def load_vae(name: VaeName, path: Path | str | None = None) -> GaussianVAE:
    """Load the weights of VPoser or RVPoser.

    Raises:
        FileMissing: there is no such file.
        WeightsInvalid: wrong prior, body, version or shapes, or a damaged file.
    """
    weights = read_weights(Path(path) if path else ASSETS / f"{name}.npz", name)
    encoder = read_stack(weights, "encoder", 3 * NUM_BODY_JOINTS, 2 * LATENT_DIM)
    active = weights.metadata.get("activate_last")
    if not isinstance(active, bool):
        raise WeightsInvalid(f"The weights of {name} do not say whether the decoder's last layer has an activation.")
    decoder = read_stack(weights, "decoder", LATENT_DIM, 6 * NUM_BODY_JOINTS, activate_last=active)
    return GaussianVAE(name, encoder, decoder, {**weights.metadata, "sha256": weights.sha256})
