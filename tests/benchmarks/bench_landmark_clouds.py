"""The shipped landmark network on clouds of 53 markers: the thesis' (only 4.20 to 4.27), ours, and any layout.

Poses of CMU's held-out subjects: 400 of the thesis' tail groups and 400 others. The figures are RMSE (4.28) and PCK of
53 markers and 24 joints, and MPJPE of the joints, as in chapter 4's tables for one network. `train model landmarks
--row` compares rows. Needs the validation motions (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.geometry.rotations import log_so3
from solver_backend.labelling.outputs import MARKERS
from solver_backend.labelling.point_network import load_network
from solver_backend.metrics import mpjpe_mm, pck_percent, rmse_mm
from tests.benchmarks.comparison.validation_takes import clip_paths, read_take
from tests.benchmarks.metric import BenchmarkSkipped, Metric

COUNT = 400  # Number of poses per set.
AT_A_TIME = 100


def run() -> list[Metric]:
    """Draw clouds of every kind and compare the network's output with the truth."""
    try:
        import torch
    except ImportError as error:
        raise BenchmarkSkipped("Clouds are drawn by torch, which is not installed.") from error
    from training.landmarks.cloud_stream import CloudStream, Variety
    from training.landmarks.rows import CLOUDS

    network, body, metrics = load_network(), load_body(), []
    for kind, variety in {**CLOUDS, "any": Variety()}.items():
        stream = CloudStream(body, "cpu", variety)
        for name, poses in judged_poses().items():
            torch.manual_seed(1234)
            found, truth = [], []
            for part in torch.as_tensor(poses).split(AT_A_TIME):
                clouds = stream.draw(part)
                found.append(network(clouds.points.numpy().astype(np.float64), clouds.seen.numpy()).positions)
                truth.append(clouds.targets.numpy().astype(np.float64))
            metrics += _measured(f"{kind}_{name}", np.concatenate(found), np.concatenate(truth))
    return metrics


def judged_poses() -> dict[str, np.ndarray]:
    """Return (N, 22, 3) float32 rotation vectors by set, the pelvis first, Y up."""
    from training.landmarks.poses import groups_of

    rotations = np.concatenate([read_take(path).rotations[:, :22] for path in clip_paths()])
    tail, rng = groups_of(rotations).any(axis=1), np.random.default_rng(0)
    sets = {"ordinary": np.flatnonzero(~tail), "tail": np.flatnonzero(tail)}
    return {
        name: log_so3(rotations[rng.choice(rows, COUNT, replace=False)]).astype(np.float32)
        for name, rows in sets.items()
    }


def _measured(name: str, found: np.ndarray, truth: np.ndarray) -> list[Metric]:
    joints = slice(len(MARKERS), None)
    shares = [
        Metric(f"{name}_pck{cm}_percent", pck_percent(found, truth, 0.01 * cm), "%", "higher", abs_tol=1.0)
        for cm in (1, 3, 7)
    ]
    return [
        Metric(f"{name}_rmse_mm", rmse_mm(found, truth), "mm"),
        Metric(f"{name}_mpjpe_mm", mpjpe_mm(found[:, joints], truth[:, joints]), "mm"),
        *shares,
    ]
