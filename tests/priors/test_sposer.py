"""SPoser: codes on the sphere, Jacobians, NumPy against torch, and errors by name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.exchange.errors import FileMissing, PoseInvalid, WeightsInvalid
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.sposer import DEFAULT_WEIGHTS, LATENT_DIM, SPoser, load_sposer
from solver_backend.priors.weights import PriorWeights, read_weights, write_weights
from tests.support.bad_poses import bad_poses


@pytest.fixture(scope="module")
def prior() -> SPoser:
    return load_sposer()


def codes(count: int, seed: int = 0) -> np.ndarray:
    return spherical_normalisation(np.random.default_rng(seed).standard_normal((count, LATENT_DIM)))


def poses(count: int, seed: int = 0) -> np.ndarray:
    return exp_so3(0.3 * np.random.default_rng(seed).standard_normal((count, 21, 3)))


def test_codes_are_unit_and_centred(prior: SPoser) -> None:
    z = prior.encode(poses(7))
    assert z.shape == (7, LATENT_DIM)
    np.testing.assert_allclose(np.linalg.norm(z, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(z.sum(axis=1), 0.0, atol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 5, 65, 130])
def test_decoded_are_rotations(prior: SPoser, count: int) -> None:
    z = codes(count)
    R, J = prior.decode_with_jacobian(z)
    assert R.shape == (count, 21, 3, 3) and J.shape == (count, 21, 3, LATENT_DIM)
    np.testing.assert_array_equal(R.shape, prior.decode(z).shape)
    np.testing.assert_allclose(R, prior.decode(z), atol=1e-12)
    np.testing.assert_allclose(np.swapaxes(R, -1, -2) @ R, np.broadcast_to(np.eye(3), R.shape), atol=1e-12)


def test_jacobian_against_central_differences(prior: SPoser) -> None:
    z, step = codes(6, seed=1), 1e-4
    R, J = prior.decode_with_jacobian(z)
    numeric = np.zeros_like(J)
    for i in range(LATENT_DIM):

        def turn(scale: float, axis: int = i) -> np.ndarray:
            moved = prior.decode(z + scale * step * np.eye(LATENT_DIM)[axis])
            return log_so3(moved @ np.swapaxes(R, -1, -2))

        numeric[..., i] = (8 * (turn(1) - turn(-1)) - (turn(2) - turn(-2))) / (12 * step)
    assert np.abs(J - numeric).max() < 1e-6 * np.abs(numeric).max()


def test_vjp_is_the_transposed_jacobian(prior: SPoser) -> None:
    z, cotangent = codes(9, seed=2), np.random.default_rng(3).normal(size=(9, 21, 3))
    R, J = prior.decode_with_jacobian(z)
    rotations, vjp = prior.decode_with_vjp(z)
    np.testing.assert_allclose(rotations, R, atol=1e-12)
    np.testing.assert_allclose(vjp(cotangent), np.einsum("njad,nja->nd", J, cotangent), atol=1e-10)


def test_numpy_against_torch(prior: SPoser) -> None:
    z, R = codes(70, seed=2), poses(70, seed=3)
    R_np, J_np = prior.decode_with_jacobian(z)
    R_t, J_t = prior.decode_with_jacobian(torch.as_tensor(z))
    np.testing.assert_allclose(R_t.numpy(), R_np, atol=1e-10)
    np.testing.assert_allclose(J_t.numpy(), J_np, atol=1e-9)
    np.testing.assert_allclose(prior.encode(torch.as_tensor(R)).numpy(), prior.encode(R), atol=1e-10)
    np.testing.assert_allclose(prior.energy(torch.as_tensor(R)).numpy(), prior.energy(R), rtol=1e-6)


def test_single_precision_stays_single(prior: SPoser) -> None:
    z = codes(4).astype(np.float32)
    R, J = prior.decode_with_jacobian(z)
    assert R.dtype == np.float32 and J.dtype == np.float32
    np.testing.assert_allclose(J, prior.decode_with_jacobian(z.astype(np.float64))[1], atol=2e-3)


def test_energy_tells_plausible_from_broken(prior: SPoser) -> None:
    sampled = prior.sample(50, seed=4)
    broken = exp_so3(1.5 * np.random.default_rng(5).standard_normal((50, 21, 3)))
    assert (prior.energy(sampled) >= 0).all()
    assert np.median(prior.energy(broken)) > 10 * np.median(prior.energy(sampled))
    np.testing.assert_array_equal(sampled, prior.sample(50, seed=4))


def test_reconstruction_spread_is_stored(prior: SPoser) -> None:
    assert prior.residual_sigma.shape == (21, 3)
    assert (prior.residual_sigma > 0).all() and (prior.residual_sigma < np.radians(45)).all()


@pytest.mark.misshapen
def test_bad_poses_are_named(prior: SPoser) -> None:
    for bad, text in bad_poses(poses(3)):
        with pytest.raises(PoseInvalid, match=text):
            prior.encode(bad)
    with pytest.raises(PoseInvalid, match=r"shape \(N, 32\), not \(2, 31\)"):
        prior.decode(np.zeros((2, 31)))
    with pytest.raises(PoseInvalid, match="NaN"):
        prior.decode_with_jacobian(np.full((1, 32), np.nan))


def rewritten(path: Path, change: dict[str, object], arrays: dict[str, np.ndarray] | None = None) -> Path:
    stored = read_weights(DEFAULT_WEIGHTS, "sposer")
    header = {
        k: v for k, v in stored.metadata.items() if k not in ("format", "version", "prior", "body_joints", "sha256")
    }
    write_weights(path, PriorWeights("sposer", stored.arrays | (arrays or {}), header | change))
    return path


def test_bad_weights_are_named(tmp_path: Path) -> None:
    path = tmp_path / "sposer.npz"
    for change, text in (
        ({"version": 2}, "version 2, but 1 is needed"),
        ({"prior": "gmm"}, "for the prior 'gmm', not 'sposer'"),
        ({"body_joints": ["tail"]}, "a body with other joints"),
        ({"activation": "sine"}, "Unknown activation 'sine'"),
        ({"decoder_hidden": [7, 7]}, "decoder_w0.*shape"),
        ({"format": "other"}, "not a weight file"),
    ):
        with pytest.raises(WeightsInvalid, match=text):
            load_sposer(rewritten(path, change))
    with pytest.raises(WeightsInvalid, match="residual_sigma"):
        load_sposer(rewritten(path, {}, {"residual_sigma": np.ones((20, 3), np.float32)}))
    with pytest.raises(WeightsInvalid, match="not numbers"):
        load_sposer(rewritten(path, {}, {"residual_sigma": np.full((21, 3), np.nan, np.float32)}))
    with pytest.raises(FileMissing, match="weights of sposer"):
        load_sposer(tmp_path / "none.npz")


def test_damaged_weights_are_named(tmp_path: Path) -> None:
    path = tmp_path / "sposer.npz"
    path.write_bytes(DEFAULT_WEIGHTS.read_bytes()[:5000])
    with pytest.raises(WeightsInvalid, match="not a weight file"):
        load_sposer(path)
    with np.load(DEFAULT_WEIGHTS, allow_pickle=False) as data:
        arrays = {key: data[key] for key in data.files}
    arrays["decoder_b0"] = arrays["decoder_b0"] + 1
    np.savez(path, **arrays)
    with pytest.raises(WeightsInvalid, match="hash"):
        load_sposer(path)


def test_shipped_weights_are_small_and_described() -> None:
    assert DEFAULT_WEIGHTS.stat().st_size <= 4_000_000
    with np.load(DEFAULT_WEIGHTS, allow_pickle=False) as data:
        header = json.loads(str(data["header"]))
    card = DEFAULT_WEIGHTS.with_suffix(".md").read_text(encoding="utf-8")
    options = header["command"].partition(" --")[2]  # the verb has another group now
    assert header["sha256"] in card and f"--{options}" in card and "EIA-0196217" in card
    assert header["metrics"]["mpjpe_mm"] <= 12.0 and header["metrics"]["pck3_percent"] >= 95.0
