"""Measure how accurately an autoencoder reproduces poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Protocol

import numpy as np
import torch
from torch import nn

from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.geometry.rotations import log_so3
from training.data.corpus import Corpus
from training.data.points import rotation_points
from training.engine.dense_layers import stack_arrays

VALIDATION_POSES = 4000  # Number of distinct poses used for validation during training.


class Autoencoder(Protocol):
    """A network that encodes and decodes poses."""

    def eval(self) -> object:
        """Switch to evaluation mode (no dropout)."""
        ...

    def encode(self, rotations: torch.Tensor) -> torch.Tensor:
        """Encode poses (N, 21, 3, 3) to codes (N, d)."""
        ...

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """Decode codes (N, d) to poses (N, 21, 3, 3)."""
        ...


@dataclass(frozen=True)
class Accuracy:
    """Reconstruction errors of poses, for 24 joints with a fixed pelvis (see ``rotation_points``)."""

    mpjpe_mm: float  # Mean distance between joints.
    worst5_mpjpe_mm: float  # Mean distance between joints in the worst 5 % of the poses.
    pck3_percent: float  # Percentage of joints within 3 cm.
    angle_deg: float  # Mean angle between local rotations.

    def as_dict(self) -> dict[str, float]:
        """Return the errors as a dict by name."""
        return {key: float(value) for key, value in asdict(self).items()}


def reconstructed(model: Autoencoder, rotations: np.ndarray) -> np.ndarray:
    """Encode and decode poses (N, 21, 3, 3) without noise or dropout."""
    model.eval()
    with torch.no_grad():
        return model.decode(model.encode(torch.as_tensor(rotations, dtype=torch.float32))).numpy().astype(np.float64)


def reconstruction_accuracy(truth: np.ndarray, decoded: np.ndarray) -> Accuracy:
    """Compare poses (N, 21, 3, 3) with their reconstructions."""
    distance = joint_distances(truth, decoded)
    per_pose = np.sort(distance.mean(axis=1))
    worst = per_pose[-max(1, len(per_pose) // 20) :]
    angle = np.linalg.norm(residual_rotvecs(truth, decoded), axis=-1)
    return Accuracy(
        1000 * float(per_pose.mean()),
        1000 * float(worst.mean()),
        100 * float((distance < 0.03).mean()),
        float(np.degrees(angle.mean())),
    )


def accuracy_by_source(corpus: Corpus, reconstruct: Callable[[np.ndarray], np.ndarray]) -> dict[str, dict[str, float]]:
    """Return the reconstruction errors for the distinct poses of each source."""
    distinct = np.unique(corpus.distinct)
    sources = corpus.sources[distinct]
    figures = {}
    for source in sorted(set(sources.tolist())):
        truth = corpus.rotations[distinct[sources == source]].astype(np.float64)
        figures[source] = reconstruction_accuracy(truth, reconstruct(truth)).as_dict() | {"poses": float(len(truth))}
    return figures


def joint_distances(truth: np.ndarray, decoded: np.ndarray) -> np.ndarray:
    """Return the distances (N, 24) between joints in metres."""
    difference = rotation_points(truth)[:, :NUM_JOINTS] - rotation_points(decoded)[:, :NUM_JOINTS]
    return np.linalg.norm(difference, axis=-1)


def residual_rotvecs(truth: np.ndarray, decoded: np.ndarray) -> np.ndarray:
    """Return rotation vectors r (N, 21, 3) from the reconstruction to the truth: ``exp(r) R_decoded = R_true``."""
    return log_so3(truth @ np.swapaxes(decoded, -1, -2))


def reconstruction_statistics(truth: np.ndarray, decoded: np.ndarray) -> np.ndarray:
    """Return standard deviations (21, 3) in radians of true rotations about a prior's reconstruction.

    They are the 68.3rd percentile of the absolute components of ``residual_rotvecs``. For a Gaussian, this is the
    standard deviation, and a few takes with a wrongly tracked head or hand do not affect it.
    """
    return np.percentile(np.abs(residual_rotvecs(truth, decoded)), 68.27, axis=0)


def autoencoder_arrays(
    model: Autoencoder, encoder: nn.Sequential, decoder: nn.Sequential, truth: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the arrays of an autoencoder's weight file: both stacks, and its errors on poses (N, 21, 3, 3)."""
    sigma = reconstruction_statistics(truth, reconstructed(model, truth)).astype(np.float32)
    return stack_arrays(encoder, "encoder") | stack_arrays(decoder, "decoder") | {"residual_sigma": sigma}


def pose_loss(truth: torch.Tensor, decoded: torch.Tensor, weight: torch.Tensor, orthogonality: float) -> torch.Tensor:
    """Return the reconstruction loss of poses: ``2 mean w (mean_p |p - p̂|² + λ mean_j (1 - cos angle_j))``.

    Distances are in dm. The points p are the joints, and three tips on the axes of each joint's frame. They replace the
    mesh vertices in the thesis' loss L_rec. For L_orth, the thesis prints ``cos = (Tr - 1) / 2``, which decreases with
    the difference, so 1 minus this is minimised. The factor 2 converts the mean over keys and intermediate frames into
    the sum of two means.

    Args:
        truth: (N, 21, 3, 3) true local rotations.
        decoded: (N, 21, 3, 3) reconstructed local rotations.
        weight: (N,) weights w.
        orthogonality: λ.

    Reference: thesis eqs. 6.1, 6.3, 6.4 (eqs. 4.18 and 4.19 of the variational autoencoders).
    """
    distance = (10.0 * (rotation_points(truth) - rotation_points(decoded))).square().sum(-1).mean(-1)
    trace = (truth * decoded).sum((-2, -1))
    misaligned = (1.0 - 0.5 * (trace - 1.0)).mean(-1)
    return 2.0 * (weight * (distance + orthogonality * misaligned)).mean()
