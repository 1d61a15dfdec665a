"""Priors by name and by file, and Gaussian codes on a sphere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.exchange.errors import FileMissing, JobInvalid, WeightsInvalid
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.choose import GaussianOnSphere, load_gaussian, load_prior
from solver_backend.priors.gaussian_vae import load_vae
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.weights import ASSETS


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    return exp_so3(0.3 * np.random.default_rng(0).normal(size=(5, 21, 3)))


def test_codes_are_unit_vectors_of_zero_mean_that_decode_like_the_gaussian_ones(poses: np.ndarray) -> None:
    vae = load_vae("rvposer")
    prior = GaussianOnSphere(vae)
    u = prior.encode(poses)
    assert u.shape == (5, prior.latent_dim)
    np.testing.assert_allclose((u * u).sum(-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(u.sum(-1), 0.0, atol=1e-12)
    np.testing.assert_allclose(prior.decode(u), vae.decode(vae.encode(poses)), atol=1e-9)


def test_the_jacobian_is_that_of_central_differences(poses: np.ndarray) -> None:
    prior, h = GaussianOnSphere(load_vae("vposer")), 1e-6
    u = prior.encode(poses[:2])
    rotations, jacobian = prior.decode_with_jacobian(u)
    for d in (0, 7, prior.latent_dim - 1):
        step = h * np.eye(prior.latent_dim)[d]
        turned = [log_so3(prior.decode(u + s * step) @ np.swapaxes(rotations, -1, -2)) for s in (1, -1)]
        np.testing.assert_allclose(jacobian[..., d], (turned[0] - turned[1]) / (2 * h), atol=2e-6)


def test_great_circles_are_straight_lines_of_gaussian_codes(poses: np.ndarray) -> None:
    vae = load_vae("rvposer")
    prior, z = GaussianOnSphere(vae), vae.encode(poses[:2])
    u = prior.encode(poses[:2])
    middle = prior._flat(slerp(u[:1], u[1:], np.array([0.4])))[0][0] - z[0]
    along = z[1] - z[0]
    cosine = middle @ along / (np.linalg.norm(middle) * np.linalg.norm(along))
    assert cosine == pytest.approx(1.0, abs=1e-9)
    assert 0.0 < np.linalg.norm(middle) < np.linalg.norm(along)


def test_torch_equals_numpy(poses: np.ndarray) -> None:
    prior = load_prior("rvposer")
    u = prior.encode(poses[:1])
    for one, two in zip(prior.decode_with_jacobian(u), prior.decode_with_jacobian(torch.as_tensor(u)), strict=True):
        np.testing.assert_allclose(np.asarray(two), one, atol=1e-10)


def test_a_prior_is_chosen_by_name_or_by_its_file() -> None:
    assert load_prior().name == load_prior("sposer").name == load_sposer().name
    assert load_gaussian().name == "rvposer"
    of_file, named = load_prior(str(ASSETS / "vposer.npz")), load_prior("vposer")
    assert of_file.metadata["sha256"] == named.metadata["sha256"]
    with pytest.raises(JobInvalid, match="Gaussian codes"):
        load_gaussian("sposer")
    with pytest.raises(JobInvalid, match="'pose_ndf'"):
        load_prior(str(ASSETS / "pose_ndf.npz"))


def test_a_file_that_is_no_prior_is_refused(tmp_path: Path) -> None:
    for choice in (str(tmp_path / "none.npz"), "spozer", "~no-such-user/a.npz"):
        with pytest.raises(FileMissing, match=f"no prior or file '{choice}'") as caught:
            load_prior(choice)
        assert "sposer, rvposer, vposer" in caught.value.hint
    wrong = tmp_path / "wrong.npz"
    np.savez(wrong, a=np.zeros(3))
    with pytest.raises(WeightsInvalid, match="not a weight file"):
        load_prior(str(wrong))
