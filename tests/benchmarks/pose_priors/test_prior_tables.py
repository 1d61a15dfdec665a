"""Test the figures of priors on cases with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from research.priors import GaussianMixture, load_prior, weight_file
from solver_backend.geometry.rotations import exp_so3, log_so3
from tests.benchmarks.bench_autoencoders import of_one_corpus
from tests.benchmarks.pose_priors.neighbour_embedding import neighbours_on_a_plane
from tests.benchmarks.pose_priors.prior_pictures import embedding
from tests.benchmarks.pose_priors.prior_tables import (
    SCHEMES,
    code_synthesis,
    draw_keys,
    interpolation,
    noisy,
    synthesis,
    text_table,
)
from training.data.corpus import build_corpus
from training.data.sources.clips import Clip


def test_samples_of_one_pose_have_no_diversity() -> None:
    one = np.broadcast_to(np.eye(3), (50, 21, 3, 3))
    real = np.random.default_rng(0).standard_normal((200, 69))
    found = synthesis(one, real, 0)
    assert found["DIV"] == 0.0 and found["APD mm"] == 0.0 and found["outside %"] == 0.0


def test_codes_of_the_real_poses_themselves_have_no_distance() -> None:
    encoder = load_prior("vposer")
    poses = exp_so3(0.3 * np.random.default_rng(5).standard_normal((100, 21, 3)))
    codes = np.asarray(encoder.encode(poses))
    same = code_synthesis(poses, codes, encoder, 0)
    assert same["FID codes"] == pytest.approx(0.0, abs=1e-5) and same["DIV codes"] > 1.0
    apart = code_synthesis(poses[:50], codes + 1.0, encoder, 0)
    assert apart["FID codes"] > 32.0
    assert apart["FID / DIV codes"] == pytest.approx(apart["FID codes"] / apart["DIV codes"])


def test_noise_spares_one_joint() -> None:
    truth = np.broadcast_to(np.eye(3), (400, 21, 3, 3)).copy()
    turn = np.degrees(log_so3(noisy(truth, 5.0, 0)))
    assert ((np.abs(turn).max(-1) > 1e-9).sum(axis=1) == 20).all()
    assert turn[np.abs(turn) > 1e-9].std() == pytest.approx(5.0, rel=0.02)


def test_schemes_find_the_middle_of_a_steady_turn() -> None:
    rate = 0.3 * np.random.default_rng(1).standard_normal((21, 3))
    turning = exp_so3(np.arange(60)[:, None, None] / 30.0 * rate)
    corpus = build_corpus([Clip("x/turning", "02", turning.astype(np.float32))])
    keys = draw_keys(corpus, 6, 20, 0)
    assert keys.poses.shape == (20, 4, 21, 3, 3)
    assert set(SCHEMES) == set(errors := interpolation(None, keys))
    assert max(errors.values()) < 0.05
    crooked = exp_so3(0.5 * np.random.default_rng(2).standard_normal((60, 21, 3)))
    jumps = draw_keys(build_corpus([Clip("x/crooked", "02", crooked.astype(np.float32))]), 6, 20, 0)
    assert min(interpolation(None, jumps).values()) > 50.0


def test_mixture_moves_noisy_poses_towards_its_mean() -> None:
    mean = 0.2 * np.random.default_rng(3).standard_normal((2, 63))
    prior = GaussianMixture(np.array([0.5, 0.5]), mean, np.tile(0.1 * np.eye(63), (2, 1, 1)), {})
    y = exp_so3((mean[0] + 0.3 * np.random.default_rng(4).standard_normal((5, 63))).reshape(5, 21, 3))
    moved = log_so3(prior.posterior_mean(y, 0.2)).reshape(5, 63)
    share = 0.1**2 / (0.1**2 + 0.2**2)
    np.testing.assert_allclose(moved, mean[0] + share * (log_so3(y).reshape(5, 63) - mean[0]), atol=1e-6)


def test_tables_leave_out_what_was_not_measured() -> None:
    text = text_table("T", {"a": {"x": 1.0}, "b": {"x": 2.0, "y": 3.5}})
    assert text.splitlines()[2:] == ["| | x | y |", "|---|---|---|", "| a | 1.00 | – |", "| b | 2.00 | 3.50 |"]


def test_on_the_plane_neighbours_stay_neighbours() -> None:
    rng = np.random.default_rng(6)
    turn = np.linspace(0.0, 1.5 * np.pi, 120)
    # A ring that principal axes fold: its third and fourth dimensions tell the halves apart.
    ring = np.stack([np.cos(turn), np.sin(turn), 3 * np.cos(2 * turn), 3 * np.sin(2 * turn)], axis=1)
    places = neighbours_on_a_plane(ring + 0.01 * rng.standard_normal(ring.shape), perplexity=8)
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    nearest = np.abs(np.argmin(apart, axis=1) - np.arange(120))
    assert places.shape == (120, 2) and np.mean(nearest <= 2) > 0.9
    far = np.concatenate([rng.standard_normal((40, 8)), rng.standard_normal((40, 8)) + 8.0])
    one, other = np.split(neighbours_on_a_plane(far), 2)
    gap = np.linalg.norm(one[:, None] - other[None], axis=-1).min()
    within = np.linalg.norm(one[:, None] - one[None], axis=-1)
    assert gap > np.median(within)


def test_the_plane_is_drawn_with_both_kinds(tmp_path) -> None:
    rng = np.random.default_rng(7)
    embedding(tmp_path / "plane.png", rng.standard_normal((40, 6)), {"prior": rng.standard_normal((40, 6)) + 6.0})
    picture = np.asarray(Image.open(tmp_path / "plane.png")).reshape(-1, 3)
    assert all((np.abs(picture.astype(int) - colour).sum(axis=1) == 0).sum() > 60 for colour in
               ((170, 170, 170), (200, 60, 40)))  # fmt: skip


def test_weights_of_different_corpora_are_not_pooled() -> None:
    old, new, like_old = (weight_file(name) for name in ("sposer", "vposer", "rvposer"))
    assert of_one_corpus([old, new, like_old]) == [old, like_old] and of_one_corpus([new, old]) == [new]
