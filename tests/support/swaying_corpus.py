"""A corpus of somebody who sways, and the order to train on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.progress import silent
from solver_backend.geometry.rotations import exp_so3
from training.data.corpus import Corpus, build_corpus
from training.data.sources.clips import Clip
from training.engine.loop import TrainingSettings
from training.engine.publish import TrainingJob

CARD_DATA = {
    "sources": {"training/sway": {"clips": 1, "frames": 40, "distinct": 40}}, "keyed_repeats": 4,
    "simplified_every": 4, "near_repeat_mm": 12.0, "held_out": "08",
}  # fmt: skip


def swaying(seed: int, frames: int = 40) -> Corpus:
    rng = np.random.default_rng(seed)
    phase, amplitude = rng.uniform(0, 6, (21, 3)), 0.3 * rng.standard_normal((21, 3))
    time = np.arange(frames)[:, None, None] / 30.0
    return build_corpus([Clip("sway", "02", exp_so3(amplitude * np.sin(4 * time + phase)).astype(np.float32))])


def turning(seed: int, frames: int = 60) -> Corpus:
    """Return somebody who sways and turns about, and a clip that did not keep the pelvis' turn."""
    rng = np.random.default_rng(seed)
    phase, amplitude = rng.uniform(0, 6, (21, 3)), 0.3 * rng.standard_normal((21, 3))
    time = np.arange(frames)[:, None, None] / 30.0
    turn = exp_so3(np.stack([0.1 * np.sin(time[:, 0, 0]), time[:, 0, 0], 0 * time[:, 0, 0]], axis=1))
    local = exp_so3(amplitude * np.sin(4 * time + phase)).astype(np.float32)
    return build_corpus([Clip(f"a/sway{seed}", "02", local, turn.astype(np.float32)),
                         Clip("a/rootless", "05", local[:9])])  # fmt: skip


def job(folder: Path, steps: int) -> TrainingJob:
    settings = TrainingSettings(steps=steps, batch=16, evaluate_every=steps)
    return TrainingJob(swaying(0), swaying(0), settings, folder, folder / "run", "train", CARD_DATA, silent)
