"""The codes' tangent space, and the decoder's derivative forwards and in reverse."""

import numpy as np
import pytest

from solver_backend.body.state_layout import RESIDUAL, ROOT, TRANSL
from solver_backend.fitters.model.subject import CODES, d_pose_d_key, decoded, decoded_with_vjp, decoder_jacobian
from solver_backend.geometry.interpolation import spherical_normalisation
from tests.support.layouts import POSE, WHOLE
from tests.support.random_keys import random_keys
from tests.support.toy_prior import ToyPrior


def test_latent_tangents_are_an_orthonormal_basis_of_the_constraint():
    z = spherical_normalisation(np.random.default_rng(0).normal(size=(50, 32)))
    basis = CODES.tangent_basis(z)
    np.testing.assert_allclose(np.swapaxes(basis, 1, 2) @ basis, np.tile(np.eye(30), (50, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(basis.sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("fi,fij->fj", z, basis), 0, atol=1e-12)


@pytest.mark.parametrize("residuals", [False, True])
def test_vjp_is_the_transposed_jacobian(residuals):
    keys, prior = random_keys(5), ToyPrior()
    residual = keys.residual if residuals else None
    local, vjp = decoded_with_vjp(prior, keys.z, residual)
    np.testing.assert_allclose(local, decoded(prior, keys.z, residual), atol=1e-14)
    cotangent = np.random.default_rng(1).normal(size=(5, 21, 3))
    by_code, by_residual = decoder_jacobian(prior, keys.z, residual)
    by_z, by_rho = vjp(cotangent)
    # The Jacobian is in single precision.
    np.testing.assert_allclose(by_z, np.einsum("fij,fi->fj", by_code, cotangent.reshape(5, -1)), atol=1e-4)
    assert (by_rho is None) == (by_residual is None) == (not residuals)
    if residuals:
        np.testing.assert_allclose(by_rho, np.einsum("fjab,fja->fjb", by_residual, cotangent), atol=1e-12)


def test_root_and_translation_of_a_state_are_those_of_its_pose():
    keys = random_keys(4)
    P = d_pose_d_key(WHOLE, ToyPrior(), keys.z, keys.residual)
    assert P.shape == (4, POSE.dof, WHOLE.dof)
    for rows, columns in ((POSE.root, WHOLE[ROOT]), (POSE.transl, WHOLE[TRANSL])):
        np.testing.assert_array_equal(P[:, rows, columns], np.tile(np.eye(3), (4, 1, 1)))
        alone = P[:, rows].copy()
        alone[:, :, columns] = 0
        assert not alone.any()
    coupled = P[:, POSE.joint(7), WHOLE[RESIDUAL]].copy()
    coupled[:, :, 21:24] = 0
    assert not coupled.any()
