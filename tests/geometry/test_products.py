"""Products of matrices are the same by every way they are computed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from solver_backend.geometry import arrays
from solver_backend.geometry.arrays import has_fast_blas, times_transposed
from solver_backend.priors.sposer import load_sposer


@pytest.fixture
def built_with(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return a function that makes NumPy state another library."""

    def state(name: str | None) -> None:
        blas = {} if name is None else {"name": name}
        monkeypatch.setattr(arrays.np, "show_config", lambda mode: {"Build Dependencies": {"blas": blas}})
        has_fast_blas.cache_clear()

    yield state
    has_fast_blas.cache_clear()


@pytest.mark.parametrize(
    ("name", "fast"),
    [("scipy-openblas", True), ("accelerate", True), ("mkl-sdl", True), ("blas", False), (None, False)],
)
def test_the_library_is_known_by_numpys_record(built_with: Any, name: str | None, fast: bool) -> None:
    built_with(name)
    assert has_fast_blas() is fast


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_both_ways_agree(built_with: Any, precision: type) -> None:
    rng = np.random.default_rng(0)
    x, weight = (rng.normal(size=(count, 40)).astype(precision) for count in (300, 17))
    results = []
    for name in ("openblas", "blas"):
        built_with(name)
        results.append(times_transposed(x, weight))
    assert results[0].dtype == results[1].dtype == precision
    np.testing.assert_allclose(*results, rtol=1e-4, atol=1e-4)


def test_a_prior_decodes_alike_with_derivatives(built_with: Any) -> None:
    codes = np.random.default_rng(1).normal(size=(20, 32))
    decoded = []
    for name in ("openblas", "blas"):
        built_with(name)
        decoded.append(load_sposer().decode_with_jacobian(codes / np.linalg.norm(codes, axis=1, keepdims=True)))
    for one, other in zip(*decoded, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)
