"""SPoser's loss: zero at the truth, and what it counts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from solver_backend.geometry.rotations import exp_so3
from training.engine.accuracy import pose_loss


def test_loss_is_zero_at_the_truth_and_counts_distance() -> None:
    R = torch.as_tensor(exp_so3(0.3 * np.random.default_rng(0).standard_normal((3, 21, 3))))
    one = torch.ones(3, dtype=R.dtype)
    assert float(pose_loss(R, R, one, 0.5)) == pytest.approx(0.0, abs=1e-12)
    turned = R.clone()
    turned[:, 20] = R[:, 20] @ torch.as_tensor(exp_so3(np.array([0.0, 0.0, 0.2])))
    small = pose_loss(R, turned, one, 0.0)
    assert float(small) > 0
    assert float(pose_loss(R, turned, one, 1.0) - small) == pytest.approx(2 * (1 - np.cos(0.2)) / 21, rel=1e-9)
    assert float(pose_loss(R, turned, 2 * one, 0.0)) == pytest.approx(2 * float(small))
