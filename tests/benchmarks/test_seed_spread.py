"""Test the error of a ratio of medians over seeds with random values of a known spread."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.seed_spread import ratio_spread


def test_what_seeds_share_does_not_count_and_the_rest_is_the_medians_error():
    rng = np.random.default_rng(0)
    shared = rng.normal(0.0, 0.3, 5)
    base = np.exp(shared)
    rows = {f"row{i}": 0.9 * base * np.exp(rng.normal(0.0, 0.02, 5)) for i in range(400)}
    found = ratio_spread({"base": base, **rows}, [(name, "base") for name in rows])
    medians = np.median(np.array([row / base for row in rows.values()]), axis=1)
    assert found == pytest.approx(2 * np.std(np.log(medians)), rel=0.1)


def test_one_seed_has_no_spread():
    assert ratio_spread({"base": [1.0], "row": [0.9]}, [("row", "base")]) is None
    found = ratio_spread(
        {"base": [1.0, 1.0], "row": [0.9, 1.0], "single": [2.0]}, [("row", "base"), ("single", "base")]
    )
    assert found is not None and found > 0.1
