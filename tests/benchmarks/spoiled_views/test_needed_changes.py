"""An explanation holds no change without which the capture is explained better."""

from __future__ import annotations

import pytest

from tests.benchmarks.bench_agreement import try_case
from tests.benchmarks.spoiled_views.motion_takes import FITTED


@pytest.mark.usefixtures("shared_data")
def test_a_change_that_lowers_the_likelihood_is_not_applied() -> None:
    seed, take = next((n, take) for n, take in enumerate(FITTED) if take.clip == "35_01")
    state, _ = try_case(take, "one of another take", seed)
    assert state == "named"
