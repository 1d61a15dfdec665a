"""Codes nearer to a pose: the derivative, what a step gains on poses SPoser never saw, blocks and empty batches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.body.rest_skeleton import REST_JOINTS
from solver_backend.exchange.joint_sets import SMPL_PARENTS
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.sposer import TURN_M, SPoser, load_sposer, misfit, nearer_codes
from tests.support.random_poses import poses
from training.data.corpus import build_corpus
from training.data.sources.clips import load_far_clips


@pytest.fixture(scope="module")
def prior() -> SPoser:
    return load_sposer()


def _placed(local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return joints and global rotations, one pose and one joint at a time."""
    joints, turns = np.zeros((len(local), 24, 3)), np.tile(np.eye(3), (len(local), 22, 1, 1))
    for n in range(len(local)):
        for j in range(1, 24):
            p = SMPL_PARENTS[j]
            joints[n, j] = joints[n, p] + turns[n, p] @ (REST_JOINTS[j] - REST_JOINTS[p])
            if j < 22:
                turns[n, j] = turns[n, p] @ local[n, j - 1]
    return joints, turns


def test_misfit_is_what_joints_and_turns_lack(prior: SPoser) -> None:
    truth, decoded = poses(5, seed=1), poses(5, seed=2)
    r, _ = misfit(truth, decoded, np.zeros((5, 21, 3, 2)))
    (p, G), (q, T) = _placed(decoded), _placed(truth)
    turns = TURN_M * log_so3(T[:, 1:] @ np.swapaxes(G[:, 1:], -1, -2))
    np.testing.assert_allclose(r, np.concatenate(((q - p)[:, 1:], turns), axis=1).reshape(5, 132), atol=1e-12)


def test_derivative_against_central_differences(prior: SPoser) -> None:
    z, step = prior.encode(poses(4, seed=3)), 1e-5
    R, by_code = prior.decode_with_jacobian(z)
    _, J = misfit(R, R, by_code)
    for axis in range(z.shape[1]):
        before, after = (prior.decode(z + sign * step * np.eye(z.shape[1])[axis]) for sign in (-1, 1))
        (p, G), (q, T) = _placed(before), _placed(after)
        turns = TURN_M * log_so3(T[:, 1:] @ np.swapaxes(G[:, 1:], -1, -2))
        numeric = np.concatenate(((q - p)[:, 1:], turns), axis=1).reshape(4, 132) / (2 * step)
        np.testing.assert_allclose(J[..., axis], numeric, atol=1e-6 * np.abs(J).max())


def test_a_step_comes_nearer_and_stops_at_poses_the_decoder_holds(prior: SPoser) -> None:
    z = spherical_normalisation(np.random.default_rng(5).standard_normal((300, 32)))
    held = prior.decode(z)
    np.testing.assert_allclose(nearer_codes(prior.decode_with_jacobian, held, z), z, atol=1e-9)
    beside = spherical_normalisation(z + 0.02 * np.random.default_rng(6).standard_normal(z.shape))

    def lacking(code: np.ndarray) -> np.ndarray:
        return np.linalg.norm(misfit(held, *prior.decode_with_jacobian(code))[0], axis=1)

    after = lacking(spherical_normalisation(nearer_codes(prior.decode_with_jacobian, held, beside)))
    assert (after < lacking(beside)).mean() > 0.97 and np.median(after / lacking(beside)) < 0.4


def test_batches_of_any_size_and_torch_say_the_same(prior: SPoser) -> None:
    R = exp_so3(0.2 * np.random.default_rng(7).standard_normal((260, 21, 3)))
    z = prior.encode(R)
    np.testing.assert_allclose(z[250:], prior.encode(R[250:]), atol=1e-9)
    np.testing.assert_allclose(prior.encode(torch.as_tensor(R[:9])).numpy(), z[:9], atol=1e-9)
    single = prior.encode(R[:9].astype(np.float32))
    assert single.dtype == np.float32 and np.abs(single - z[:9]).max() < 2e-3
    assert prior.encode(R[:0]).shape == (0, 32)


@pytest.mark.shared
def test_motions_unlike_the_corpus_are_held(shared_data: Path, prior: SPoser) -> None:
    clips = load_far_clips(shared_data)
    if not clips:
        pytest.skip("The far motions are not here.")
    corpus = build_corpus(clips)
    truth = corpus.rotations[corpus.distinct[::10]].astype(np.float64)
    error = np.sort(
        1000 * np.linalg.norm(_placed(truth)[0] - _placed(prior.reconstruct(truth))[0], axis=-1).mean(axis=1)
    )
    assert error.mean() < 7.0 and error[-len(error) // 20 :].mean() < 12.0
