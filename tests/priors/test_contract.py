"""What every prior promises: shapes, derivatives, NumPy as torch, seeded samples, and errors by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from research.priors import load_prior, stored_priors, weight_file
from solver_backend.exchange.errors import FileMissing, PoseInvalid, WeightsInvalid
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.base import PosePrior
from tests.support.bad_poses import bad_poses
from tests.support.random_weights import WIDTHS, write_random

LEARNED = ("sposer", "gmm")


@pytest.fixture(scope="module", params=[*LEARNED, *WIDTHS])
def prior(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> PosePrior:
    name = str(request.param)
    if name in LEARNED:
        return load_prior(name)
    return load_prior(name, write_random(tmp_path_factory.mktemp(name) / "weights.npz", name))


def poses(count: int, seed: int = 0) -> np.ndarray:
    return exp_so3(0.3 * np.random.default_rng(seed).standard_normal((count, 21, 3)))


def test_decoded_are_rotations(prior: PosePrior) -> None:
    z = prior.encode(poses(5))
    assert z.shape == (5, prior.latent_dim)
    R, J = prior.decode_with_jacobian(z)
    assert R.shape == (5, 21, 3, 3) and J.shape == (5, 21, 3, prior.latent_dim)
    np.testing.assert_allclose(R, prior.decode(z), atol=1e-12)
    np.testing.assert_allclose(np.swapaxes(R, -1, -2) @ R, np.broadcast_to(np.eye(3), R.shape), atol=1e-10)


def test_jacobian_against_central_differences(prior: PosePrior) -> None:
    z, step = prior.encode(poses(2, seed=1)), 1e-6
    _, J = prior.decode_with_jacobian(z)
    for axis in range(0, prior.latent_dim, 5):
        ahead, behind = (prior.decode(z + s * step * np.eye(prior.latent_dim)[axis]) for s in (1.0, -1.0))
        numeric = log_so3(ahead @ np.swapaxes(behind, -1, -2)) / (2 * step)
        np.testing.assert_allclose(J[..., axis], numeric, atol=2e-6 * max(1.0, float(np.abs(J).max())))


def test_numpy_against_torch(prior: PosePrior) -> None:
    R = poses(4, seed=2)
    z = prior.encode(R)
    np.testing.assert_allclose(prior.encode(torch.as_tensor(R)).numpy(), z, atol=1e-9)
    R_torch, J_torch = prior.decode_with_jacobian(torch.as_tensor(z))
    R_numpy, J_numpy = prior.decode_with_jacobian(z)
    np.testing.assert_allclose(R_torch.numpy(), R_numpy, atol=1e-9)
    np.testing.assert_allclose(J_torch.numpy(), J_numpy, atol=1e-8)
    np.testing.assert_allclose(prior.energy(torch.as_tensor(R)).numpy(), prior.energy(R), rtol=1e-6)


def test_samples_are_seeded(prior: PosePrior) -> None:
    drawn = prior.sample(6, seed=3)
    assert drawn.shape == (6, 21, 3, 3) and (prior.energy(drawn) >= 0).all()
    np.testing.assert_array_equal(drawn, prior.sample(6, seed=3))
    assert np.abs(drawn - prior.sample(6, seed=4)).max() > 1e-3


@pytest.mark.misshapen
def test_bad_poses_are_named(prior: PosePrior) -> None:
    for bad, text in bad_poses(poses(3)):
        for ask in (prior.encode, prior.energy):
            with pytest.raises(PoseInvalid, match=text):
                ask(bad)
    with pytest.raises(PoseInvalid, match=r"shape \(N, \d+\), not \(2, 7\)"):
        prior.decode(np.zeros((2, 7)))
    with pytest.raises(PoseInvalid, match="NaN"):
        prior.decode_with_jacobian(np.full((1, prior.latent_dim), np.nan))


@pytest.mark.parametrize("name", WIDTHS)
def test_weights_of_something_else_are_named(tmp_path: Path, name: str) -> None:
    path = tmp_path / "weights.npz"
    for change, text in (
        ({"version": 9}, "version 9"),
        ({"written_as": "gmm"}, f"for the prior 'gmm', not '{name}'"),
        ({"body_joints": ["tail"]}, "a body with other joints"),
        ({"decoder_hidden": [7, 7]}, "decoder_w0.*shape"),
        ({"decoder_hidden": ["a"]}, "hidden widths of the decoder"),
        ({"decoder_hidden": 1e400}, "hidden widths of the decoder"),
    ):
        with pytest.raises(WeightsInvalid, match=text):
            load_prior(name, write_random(path, name, **change))
    with pytest.raises(FileMissing, match=f"weights of {name}"):
        load_prior(name, tmp_path / "none.npz")


def test_catalogue_knows_what_ships() -> None:
    assert {"sposer", "rvposer", "gmm"} <= set(stored_priors())
    with pytest.raises(WeightsInvalid, match=r"no prior 'poser' \(known: sposer"):
        load_prior("poser")
    for name in stored_priors():
        assert load_prior(name).name == name
        assert weight_file(name).stat().st_size < 4e6 and weight_file(name).with_suffix(".md").is_file()
