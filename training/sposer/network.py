"""SPoser's network in torch (thesis 6.2.2)."""

from __future__ import annotations

import torch
from torch import nn

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.rotations import matrix_from_6d, matrix_to_6d
from solver_backend.geometry.sphere import spherical_normalisation
from solver_backend.priors.sposer import LATENT_DIM
from training.engine.dense_layers import dense_stack, linear_layers


class SphericalAutoencoder(nn.Module):
    """Poses to unit zero-mean codes and back."""

    def __init__(self, encoder_hidden: tuple[int, ...], decoder_hidden: tuple[int, ...], activation: str) -> None:
        super().__init__()
        self.encoder = dense_stack((126, *encoder_hidden, LATENT_DIM), activation)
        self.decoder = dense_stack((LATENT_DIM, *decoder_hidden, 126), activation)

    def start_from(self, mean_6d: torch.Tensor) -> None:
        """Centre the encoder's input and the decoder's output on the mean pose, and the code's scale on one."""
        with torch.no_grad():
            first, last = linear_layers(self.encoder)[0], linear_layers(self.decoder)[-1]
            first.weight.mul_(3.0)
            first.bias.sub_(first.weight @ mean_6d)
            linear_layers(self.decoder)[0].weight.mul_(LATENT_DIM**0.5)
            last.weight.mul_(0.5)
            last.bias.copy_(mean_6d)

    def encode(self, rotations: torch.Tensor) -> torch.Tensor:
        """(N, 21, 3, 3) -> (N, 32)."""
        return spherical_normalisation(self.encoder(matrix_to_6d(rotations).flatten(-2)))

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """(N, 32) -> (N, 21, 3, 3)."""
        return matrix_from_6d(self.decoder(z).unflatten(-1, (NUM_BODY_JOINTS, 6)))
