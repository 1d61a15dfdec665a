"""Define VPoser and RVPoser: variational autoencoders of poses with Gaussian codes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import array_namespace
from solver_backend.priors.autoencoder import PoseAutoencoder
from solver_backend.priors.base import Codes, Energies, Poses
from solver_backend.priors.weights import ASSETS, read_stack, read_weights

LATENT_DIM = 32
VaeName = Literal["vposer", "vposer_worded", "rvposer", "rvposer_second_norm"]
"""``vposer`` follows its public code (Pavlakos et al. 2019), and ``vposer_worded`` its description in the thesis.
``rvposer`` is robust (thesis 4.2.4), and ``rvposer_second_norm`` adds the public code's second normalisation."""


class GaussianVAE(PoseAutoencoder):
    """Pose autoencoder with codes in R^32 that are standard normal over the training poses."""

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self.name = self.metadata["prior"]

    def posterior(self, rotations: Poses) -> tuple[Codes, Codes]:
        """Return the (N, 32) means and standard deviations of the codes of poses (N, 21, 3, 3)."""
        out = self._encoded_rotvecs(rotations)
        return out[:, :LATENT_DIM], array_namespace(out).exp(0.5 * out[:, LATENT_DIM:])

    def encode(self, rotations: Poses) -> Codes:
        """Return the posterior means (N, 32) of the codes."""
        return self.posterior(rotations)[0]

    def energy(self, rotations: Poses) -> Energies:
        """Return half the codes' squared length (N,), their negative log density up to a constant."""
        z = self.encode(rotations)
        return 0.5 * array_namespace(z).sum(z * z, axis=-1)

    def sample(self, count: int, seed: int) -> Poses:
        """Decode ``count`` random codes from the standard normal distribution."""
        return self.decode(np.random.default_rng(seed).standard_normal((count, LATENT_DIM)))


def load_vae(name: VaeName, path: Path | str | None = None) -> GaussianVAE:
    """Load the weights of VPoser, RVPoser or one of their variants.

    Raises:
        FileMissing, WeightsInvalid: see ``read_weights``.
    """
    weights = read_weights(Path(path) if path else ASSETS / f"{name}.npz", name)
    encoder = read_stack(weights, "encoder", 3 * NUM_BODY_JOINTS, 2 * LATENT_DIM)
    active = weights.metadata.get("activate_last")
    if not isinstance(active, bool):
        raise WeightsInvalid(f"The weights of {name} do not state whether the decoder's last layer has an activation.")
    decoder = read_stack(weights, "decoder", LATENT_DIM, 6 * NUM_BODY_JOINTS, activate_last=active)
    sigma = weights.array("residual_sigma", (NUM_BODY_JOINTS, 3))
    return GaussianVAE(encoder, decoder, sigma, {**weights.metadata, "sha256": weights.sha256})
