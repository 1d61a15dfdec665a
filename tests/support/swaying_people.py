"""Two people who sway, a small Pose-NDF, and the order to train it on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from solver_backend.exchange.progress import silent
from solver_backend.geometry.rotations import exp_so3, quat_from_rotvec
from tests.support.swaying_corpus import CARD_DATA
from training.data.corpus import Corpus, build_corpus
from training.data.sources.clips import Clip
from training.engine.loop import TrainingSettings
from training.engine.publish import TrainingJob
from training.pose_ndf.network import (
    PoseNdfSettings,
)

SMALL = PoseNdfSettings(
    features=3,
    encoder_hidden=4,
    field_hidden=(16, 16),
    pool=120,
    validation=200,
    samples=20,
)


def swaying(seed: int, frames: int = 60) -> Corpus:
    rng = np.random.default_rng(seed)
    phase, amplitude = rng.uniform(0, 6, (21, 3)), 0.15 * rng.standard_normal((21, 3))
    time = np.arange(frames)[:, None, None] / 30.0
    sways = [exp_so3(k * amplitude * np.sin(4 * time + phase)).astype(np.float32) for k in (1.0, 1.1)]
    return build_corpus([Clip(f"test/{who}", who, R) for who, R in zip(("01", "02"), sways, strict=True)])


def job(folder: Path, steps: int, checkpoint_s: float = 60.0) -> TrainingJob:
    settings = TrainingSettings(steps=steps, batch=32, evaluate_every=3, checkpoint_s=checkpoint_s, learning_rate=3e-3)
    return TrainingJob(swaying(0), swaying(1), settings, folder, folder / "run", "train", CARD_DATA, silent)


def random_quats(count: int, seed: int, scale: float = 0.5) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.as_tensor(quat_from_rotvec(scale * rng.standard_normal((count, 21, 3))), dtype=torch.float32)
