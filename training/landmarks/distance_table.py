"""Tabulate marker distances of many people in windows of recorded motion: ``marker_distances.npz``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from solver_backend.body.body import load_body
from solver_backend.labelling.tracklets import FLOOR_M, NAME
from solver_backend.priors.weights import PriorWeights, write_weights
from training.landmarks.cloud_stream import PLACES, CloudStream, rodrigues
from training.landmarks.poses import PoseTable

WINDOWS, FRAMES = 2400, 24
LONGEST = 400
"""Largest number of poses in a window. The logarithm of the length is distributed uniformly."""
STRAY = 1.2  # Placement error relative to the network's training, for people who do not know the placement rules.
NOISE_M = 0.003  # Standard deviation of a marker's position in metres. Chosen by hand.
_FAR_M = 0.3  # Smallest distance in metres between two markers that determine a body's size, as in labelling.


def write_distance_table(path: Path, table: PoseTable, *, windows: int = WINDOWS, seed: int = 0) -> Path:
    """Write mean and spread over people of each marker distance, and of the logarithm of its change in a window.

    Distances are divided by the person's size: the median of the person's distances relative to the mean of all people,
    for marker pairs more than 0.3 m apart.

    Args:
        path: file to write.
        table: poses. The poses of one recording are in temporal order.
        windows: number of people. Each has a different window.
        seed: seed of all draws.
    """
    rng, pairs = np.random.default_rng(seed), np.triu_indices(len(PLACES), 1)
    stream, poses = CloudStream(load_body(), "cpu"), torch.as_tensor(table.poses("training"))
    mean, change = (np.zeros((windows, len(pairs[0])), np.float32) for _ in range(2))
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        for row in range(windows):
            points = _window(stream, poses, rng)
            apart = np.linalg.norm(points[:, pairs[0]] - points[:, pairs[1]], axis=-1)
            mean[row], change[row] = apart.mean(0), apart.std(0)
    usual = mean.mean(0)
    size = np.median(mean[:, usual > _FAR_M] / usual[usual > _FAR_M], axis=1, keepdims=True)
    logarithm = np.log(change / size + FLOOR_M)
    arrays = {
        "mean": (mean / size).mean(0),
        "spread": (mean / size).std(0),
        "change": logarithm.mean(0),
        "change_spread": logarithm.std(0),
    }
    halved = {name: array.astype(np.float16) for name, array in arrays.items()}
    write_weights(path, PriorWeights(NAME, halved, {"windows": windows, "seed": seed}))
    return path


def _window(stream: CloudStream, poses: torch.Tensor, rng: np.random.Generator) -> np.ndarray:
    length = int(np.exp(rng.uniform(np.log(2), np.log(min(LONGEST, len(poses) - 1)))))
    rows = rng.integers(len(poses) - length) + rng.integers(length, size=FRAMES)
    rotations = rodrigues(poses[rows])
    betas = 0.7 * torch.randn(1, 10) + (torch.rand(1, 10) < 0.1) * torch.randn(1, 10)
    offsets = STRAY * stream.placement(1)
    places, _ = stream.points(
        rotations[:, 0], rotations[:, 1:], betas.expand(FRAMES, -1), offsets.expand(FRAMES, -1, -1)
    )
    return places.numpy() + NOISE_M * rng.standard_normal(places.shape)
