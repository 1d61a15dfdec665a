"""Random weights of Pose-NDF, for tests that need a field but not a good one."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.priors.pose_ndf import PoseNDF, load_pose_ndf
from solver_backend.priors.weights import PriorWeights, write_weights

FEATURES, ENCODER_HIDDEN, HIDDEN = 3, 5, (24, 16)
SIZE: dict[str, Any] = {"features": FEATURES, "encoder_hidden": ENCODER_HIDDEN, "field_hidden": HIDDEN}


def arrays(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    out = {
        "encoder_w0": rng.standard_normal((21, ENCODER_HIDDEN, 4 + FEATURES)) / np.sqrt(4 + FEATURES),
        "encoder_b0": 0.1 * rng.standard_normal((21, ENCODER_HIDDEN)),
        "encoder_w1": rng.standard_normal((21, FEATURES, ENCODER_HIDDEN)) / np.sqrt(ENCODER_HIDDEN),
        "encoder_b1": 0.1 * rng.standard_normal((21, FEATURES)),
    }
    out |= {"joint_mean": np.full((21, 3), 0.1), "joint_factor": np.tile(0.3 * np.eye(3), (21, 1, 1))}
    for i, (a, b) in enumerate(pairwise((21 * FEATURES, *HIDDEN, 1))):
        out[f"field_w{i}"] = rng.standard_normal((b, a)) / np.sqrt(a)
        out[f"field_b{i}"] = 0.1 * rng.standard_normal(b)
    return out


def random_prior(folder: Path, seed: int = 0) -> PoseNDF:
    path = folder / "pose_ndf.npz"
    write_weights(path, PriorWeights("pose_ndf", arrays(seed), {"field_size": SIZE}))
    return load_pose_ndf(path)
