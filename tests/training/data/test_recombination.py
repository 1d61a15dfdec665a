"""Limbs turned within anatomical limits, and ankles, toes and wrists brought to their ends."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.body.joint_limits import JOINT_LIMITS, excess_deg, swing_and_twist
from tests.support.random_poses import poses
from training.data.corpus import ENDS, LIMBS, WindowSampler, beyond_reach, build_corpus, ends_reaching, limbs_turned
from training.data.sources.clips import Clip


def _windows(count: int) -> torch.Tensor:
    return torch.as_tensor(poses(4 * count, scale=0.15, seed=8)).unflatten(0, (count, 4)).float()


def test_whole_limbs_turn_and_stay_within_their_limits() -> None:
    windows = _windows(200)
    turned = limbs_turned(windows, torch.Generator().manual_seed(0))
    moved = ~torch.isclose(turned, windows, atol=1e-5).all(-1).all(-1).all(1)
    for limb in LIMBS:
        columns = moved[:, [j - 1 for j in limb]]
        assert torch.equal(columns.any(1), columns.all(1)) and 0.2 < columns.any(1).float().mean() < 0.8
    assert moved.any(1).all()
    beyond = excess_deg(turned.flatten(0, 1).double().numpy()).reshape(200, 4, 21).max(axis=1)
    assert beyond[moved.numpy()].max() < 1e-2
    angles = swing_and_twist(turned[:, 1].double().numpy())
    share = (angles - JOINT_LIMITS[..., 0]) / (JOINT_LIMITS[..., 1] - JOINT_LIMITS[..., 0])
    reached = np.where(moved.numpy()[..., None], share, 0.5)
    assert (reached.min(axis=0) < 0.25).mean() > 0.9 and (reached.max(axis=0) > 0.75).mean() > 0.9


def test_what_moves_in_a_window_goes_on_moving() -> None:
    windows = 0.0 * _windows(30) + torch.eye(3)
    windows[:, 2:, 3] = torch.as_tensor(poses(1, scale=0.1)[0, 3]).float()
    turned = limbs_turned(windows, torch.Generator().manual_seed(1))
    assert torch.equal(turned[:, 0], turned[:, 1]) and torch.equal(turned[:, 2], turned[:, 3])
    assert not torch.isclose(turned[:, 0, 3], turned[:, 2, 3], atol=1e-3).all(-1).all(-1).any()


def test_ends_move_towards_their_ends_and_nothing_else() -> None:
    windows = _windows(300)
    moved = ends_reaching(windows, torch.Generator().manual_seed(0))
    columns = [j - 1 for j in ENDS]
    others = [j for j in range(21) if j not in columns]
    torch.testing.assert_close(moved[:, :, others], windows[:, :, others], rtol=0, atol=0)
    angles = swing_and_twist(moved[:, 1].double().numpy())[:, columns]
    limits = JOINT_LIMITS[columns]
    assert (angles >= limits[..., 0] - 1e-4).all() and (angles <= limits[..., 1] + 1e-4).all()
    share = (angles - limits[..., 0]) / (limits[..., 1] - limits[..., 0])
    assert (share.min(axis=0) < 0.1).all() and (share.max(axis=0) > 0.9).all()
    assert not beyond_reach(moved[:, 1]).any()


def test_draws_repeat_by_their_seed_and_are_off_where_not_asked_for() -> None:
    corpus = build_corpus([Clip("sway", "02", poses(50, scale=0.2, seed=2).astype(np.float32))])
    sampler = WindowSampler.of(corpus, turned_chance=0.5, end_chance=0.5)
    first, again = (sampler.draw(64, torch.Generator().manual_seed(4)).rotations for _ in range(2))
    assert torch.equal(first, again) and torch.isfinite(first).all()
    plain = WindowSampler.of(corpus).draw(64, torch.Generator().manual_seed(4)).rotations
    assert not torch.equal(first, plain)
