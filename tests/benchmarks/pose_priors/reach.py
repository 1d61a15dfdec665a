"""Poses that an autoencoder can represent: errors of encoded poses and of the nearest codes, overall and by joint."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.priors.sposer import SPoser
from tests.benchmarks.pose_priors.prior_tables import Table
from training.data.points import rotation_points
from training.engine.accuracy import joint_distances, residual_rotvecs

_STEPS = 150
_RATE = 0.003
"""Adam's initial learning rate for codes of length one. Doubling the steps changes the mean error by 0.01 mm."""


def nearest_codes(prior: SPoser, truth: np.ndarray) -> np.ndarray:
    """Return (N, 32) codes with decoded points nearest to (N, 21, 3, 3) poses, starting from the encoder's codes."""
    points = rotation_points(torch.as_tensor(truth, dtype=torch.float32))
    free = torch.as_tensor(prior.encode(truth), dtype=torch.float32).requires_grad_(True)
    optimizer = torch.optim.Adam([free], lr=_RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, _STEPS)
    for _ in range(_STEPS):
        decoded = rotation_points(prior.decode(spherical_normalisation(free)))
        loss = (decoded - points).square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return spherical_normalisation(free.detach()).numpy().astype(np.float64)


def pose_errors(truth: np.ndarray, decoded: np.ndarray) -> dict[str, float]:
    """Return mean, median, and mean of the worst 5 % of the poses' mean joint distances in mm."""
    per_pose = np.sort(1000.0 * joint_distances(truth, decoded).mean(axis=1))
    worst = per_pose[-max(1, len(per_pose) // 20) :]
    figures = {"mean mm": per_pose.mean(), "median mm": np.median(per_pose), "worst 5 % mm": worst.mean()}
    return {name: float(value) for name, value in figures.items()}


def joint_errors(truth: np.ndarray, decoded: np.ndarray) -> Table:
    """Return each joint's mean distance, its mean in the worst 5 % of the poses, and its rotation error."""
    distance = 1000.0 * joint_distances(truth, decoded)
    worst = np.argsort(distance.mean(axis=1))[-max(1, len(distance) // 20) :]
    angle = np.degrees(np.linalg.norm(residual_rotvecs(truth, decoded), axis=-1)).mean(axis=0)
    rows: Table = {}
    for joint, name in enumerate(SMPL_JOINTS):
        rows[name] = {"mean mm": float(distance[:, joint].mean()), "worst 5 % mm": float(distance[worst, joint].mean())}
        if 1 <= joint <= len(angle):
            rows[name]["angle °"] = float(angle[joint - 1])
    return rows
