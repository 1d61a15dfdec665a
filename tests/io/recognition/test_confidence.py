"""Confidences on whatever scale a detector writes them."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic, word
from solver_backend.io.recognition.confidence import from_logarithms, on_unit_scale, placeholder


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def doubts(rng: np.random.Generator) -> np.ndarray:
    """Return confidences as a detector gives them, a fifth of the points unseen."""
    return np.where(rng.uniform(size=(4, 50, 25)) < 0.2, 0.0, rng.beta(5, 2, (4, 50, 25)))


@pytest.mark.parametrize("value", [0.01, 0.1, 0.45])
def test_one_low_value_for_everything_counts_as_certain_and_is_reported(rng, value: float) -> None:
    seen = doubts(rng) > 0
    found, notes, problems = on_unit_scale(np.where(seen, value, 0.0))
    assert found == pytest.approx(seen.astype(float))
    assert (notes, problems) == ((), (diagnostic("confidence_rescaled", how="relative", largest=value),))


def test_confidences_are_relative(rng) -> None:
    given = doubts(rng)
    found, *reported = on_unit_scale(given)
    assert np.array_equal(found, given) and reported == [(), ()]
    low = [on_unit_scale(scale * given) for scale in (0.01, 0.1, 0.2)]
    for rescaled, _, problems in low:
        assert rescaled == pytest.approx(low[0][0]) and rescaled.max() == 1.0
        assert [item.code for item in problems] == ["confidence_rescaled"]


def test_ones_are_no_finding_and_few_points_are_no_evidence(rng) -> None:
    ones = (doubts(rng) > 0).astype(float)
    assert on_unit_scale(ones)[1:] == ((), ()) and np.array_equal(on_unit_scale(ones)[0], ones)
    high = 0.85 * ones
    assert np.array_equal(on_unit_scale(high)[0], high)
    few = np.full((1, 1, 50), 0.3)
    assert np.array_equal(on_unit_scale(few)[0], few)
    assert np.array_equal(on_unit_scale(np.zeros((2, 3, 25)))[0], np.zeros((2, 3, 25)))


def test_per_cent_and_larger_scores(rng) -> None:
    given = doubts(rng)
    found, notes, problems = on_unit_scale(100 * given)
    assert found == pytest.approx(given) and notes == ()
    assert problems == (diagnostic("confidence_rescaled", how="percent", largest=100 * given.max()),)
    found, *reported = on_unit_scale(np.where(given > 0, 500.0, 0.0))
    unknown = diagnostic("confidence_rescaled", how="relative", largest=500.0)
    assert found.max() == 1.0 and reported == [(), (unknown,)] and unknown.severity == "warning"


def test_few_scores_on_an_unknown_scale_are_said_to_be_few() -> None:
    found, _, (problem,) = on_unit_scale(np.arange(1.0, 10.0))
    assert (found == 1.0).sum() == 5 and "the upper half is treated as certain" in word(problem).what


@pytest.mark.parametrize("scale", [7.0, 40.0, 255.0])
def test_scores_of_a_network_keep_their_order(rng, scale: float) -> None:
    given = doubts(rng)
    found, _, (problem,) = on_unit_scale(scale * given)
    assert found == pytest.approx(on_unit_scale(0.1 * given)[0]) and problem.values["how"] == "relative"


def test_flags_and_logarithms(rng) -> None:
    given = doubts(rng)
    for hidden in (0.6, 0.96):
        flags = np.where(given > 0, np.where(given < hidden, 1.0, 2.0), 0.0)
        found, notes, problems = on_unit_scale(flags)
        assert np.array_equal(found, flags / 2) and notes[0].values["how"] == "flags" and problems == ()
    assert (flags == 2).sum() < 0.05 * (flags > 0).sum()
    written = given > 0
    logarithms = np.log(np.where(written, given, 1.0))
    assert from_logarithms(logarithms, written) == pytest.approx(given)
    assert from_logarithms(given, written) is given


def test_marks_of_nobody_are_no_logarithms(rng) -> None:
    given = doubts(rng)
    written = np.ones(given.shape, bool)
    nobody = np.full(given.shape, -1.0)
    assert from_logarithms(nobody, written) is nobody
    few = np.where(np.arange(given.size).reshape(given.shape) % 30 == 0, given, -1.0)
    assert from_logarithms(few, written) is few


def test_one_larger_score_or_nan_leaves_per_cent(rng) -> None:
    given = 100 * doubts(rng)
    given[0, 0, :2] = 250.0, np.nan
    found, _, (problem,) = on_unit_scale(given)
    assert problem.values["how"] == "percent" and found[0, 0, :2].tolist() == [1.0, 0.0]
    assert found[1:] == pytest.approx(given[1:] / 100)


def test_a_position_of_most_keypoints_is_a_placeholder(rng) -> None:
    xy, confidence = rng.uniform(10, 900, (2, 60, 1, 25, 2)).round(), np.ones((2, 60, 1, 25))
    assert placeholder(xy, confidence) is None
    xy[rng.uniform(size=confidence.shape) < 0.1] = -7.0
    found = placeholder(xy, confidence)
    assert found is not None and found.tolist() == [-7.0, -7.0]
    xy[:] = rng.uniform(10, 900, xy.shape)
    xy[..., 3, :] = 5.0  # a keypoint that never moves
    assert placeholder(xy, confidence) is None
