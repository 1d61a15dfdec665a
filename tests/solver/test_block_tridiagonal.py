"""Block-tridiagonal systems against a dense solve and the dense inverse of the same matrix."""

import numpy as np
import pytest

from solver_backend.solver.block_tridiagonal import BlockTridiagonal

SIZES = [(1, 4, 4), (2, 4, 4), (5, 4, 4), (2, 7, 4), (6, 7, 4), (37, 5, 3)]
"""Blocks, unknowns of each, and how many of them meet the block before."""


def random_system(blocks, size, met):
    """Return a system and its matrix, dense: positive definite, inner unknowns met by their own and the next."""
    rng, dense = np.random.default_rng(0), 0.1 * np.eye(blocks * size)
    for i in range(blocks):
        seen = np.arange(i * size, min((i + 1) * size + met, blocks * size))
        a = rng.normal(size=(len(seen), len(seen) + 3))
        dense[np.ix_(seen, seen)] += a @ a.T
    cut = dense.reshape(blocks, size, blocks, size)
    diagonal = np.stack([cut[i, :, i] for i in range(blocks)])
    upper = np.array([cut[i, :, i + 1, :met] for i in range(blocks - 1)]).reshape(-1, size, met)
    return BlockTridiagonal(diagonal, upper, rng.normal(size=(blocks, size))), dense


def as_torch(system, dtype=None):
    torch = pytest.importorskip("torch")
    parts = (torch.as_tensor(part) for part in (system.diagonal, system.upper))
    return BlockTridiagonal(*(part if dtype is None else part.to(dtype) for part in parts), torch.as_tensor(system.g))


def torch_array(values):
    return pytest.importorskip("torch").as_tensor(np.asarray(values))


@pytest.mark.parametrize("backend", ["numpy", "torch"])
@pytest.mark.parametrize("damping", [0.0, 0.7])
@pytest.mark.parametrize("sizes", SIZES)
def test_steps_are_those_of_the_dense_matrix(sizes, damping, backend):
    system, dense = random_system(*sizes)
    expected = -np.linalg.solve(dense + np.diag(damping * np.diag(dense) + 1e-9), system.g.reshape(-1))
    system = system if backend == "numpy" else as_torch(system)
    found = system.solve(np.array([damping]) if backend == "numpy" else torch_array([damping]))
    np.testing.assert_allclose(np.asarray(found)[0], expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("backend", ["numpy", "torch"])
@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("missing", [0, 1])
def test_every_block_is_damped_by_its_own(sizes, missing, backend):
    system, dense = random_system(*sizes)
    shares = np.geomspace(1e-3, 10.0, max(1, sizes[0] - missing))
    each = np.repeat(np.append(shares, shares[-1:])[: sizes[0]], sizes[1])
    expected = -np.linalg.solve(dense + np.diag(each * np.diag(dense) + 1e-9), system.g.reshape(-1))
    system = system if backend == "numpy" else as_torch(system)
    like = shares[None] if backend == "numpy" else torch_array(shares[None])
    np.testing.assert_allclose(np.asarray(system.solve(like))[0], expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("backend", ["numpy", "torch"])
@pytest.mark.parametrize("sizes", SIZES)
def test_marginals_are_the_blocks_of_the_inverse(sizes, backend):
    system, dense = random_system(*sizes)
    blocks, size, met = sizes
    inverse = np.linalg.inv(dense).reshape(blocks, size, blocks, size)
    diagonal, upper = (system if backend == "numpy" else as_torch(system)).marginals()
    assert tuple(upper.shape) == (blocks - 1, size, met)
    for i in range(blocks):
        np.testing.assert_allclose(np.asarray(diagonal)[i], inverse[i, :, i], rtol=1e-6, atol=1e-8)
        if i + 1 < blocks:
            np.testing.assert_allclose(np.asarray(upper)[i], inverse[i, :, i + 1, :met], rtol=1e-6, atol=1e-8)


def test_blocks_in_single_precision_steer_nearly_as_well():
    system, dense = random_system(37, 5, 3)
    single = BlockTridiagonal(*(a.astype(np.float32) for a in (system.diagonal, system.upper)), system.g)
    expected = -np.linalg.solve(dense, system.g.reshape(-1))
    assert np.linalg.norm(single.solve(np.zeros(1))[0] - expected) < 1e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize("backend", ["numpy", "torch"])
@pytest.mark.parametrize("seed", range(5))
def test_no_variance_is_negative_where_rounding_is_larger_than_what_is_known(seed, backend):
    """Fifteen precise measurements of 24 unknowns: what they leave open is known to 1e-2, and their rounding is 1e2."""
    rng, count, size = np.random.default_rng(seed), 4, 6
    dense = np.zeros((count * size, count * size))
    for i in range(count - 1):
        seen = np.arange(i * size, (i + 2) * size)
        a = 1e4 * rng.normal(size=(len(seen), 5))
        dense[np.ix_(seen, seen)] += a @ a.T
    cut = dense.astype(np.float32).reshape(count, size, count, size)
    diagonal = np.stack([cut[i, :, i] for i in range(count)]) + np.float32(1e-2) * np.eye(size, dtype=np.float32)
    system = BlockTridiagonal(diagonal, np.stack([cut[i, :, i + 1] for i in range(count - 1)]), np.zeros((count, size)))
    variances = (system if backend == "numpy" else as_torch(system)).marginals()[0]
    assert (np.diagonal(np.asarray(variances), axis1=1, axis2=2) > 0).all()
