"""Numbers that stand for "not seen" are found in any unit, and measured positions are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.io.interpretation import without_sentinels
from tests.support.words import facts
from tests.support.worn_markers import worn_markers

LABELS = ("LASI", "RASI", "LPSI", "RPSI", "C7", "LKNE", "RKNE", "LANK", "RANK", "LSHO", "RSHO", "LHEE")


@pytest.fixture(scope="module")
def walk() -> np.ndarray:
    return worn_markers(LABELS, 40).cloud.positions


@pytest.mark.parametrize("unit", [1.0, 100.0, 1000.0])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.6])
@pytest.mark.parametrize("value", [0.0, -9999.0, 9999999.0, 1e6, 99999.99, 1e12, 500.0])
def test_one_number_on_all_axes_is_not_seen(walk, unit, share, value):
    positions = unit * (walk + [0.3, -0.2, 0.0])
    gone = np.random.default_rng(3).random(positions.shape[:2]) < share
    positions[gone] = value
    found, zeros, sentinels = without_sentinels(positions, LABELS)
    np.testing.assert_array_equal(np.isnan(found[..., 0]), gone)
    assert bool(zeros) == (value == 0.0) and bool(sentinels) == (value != 0.0)


def test_nines_on_one_axis_and_what_is_absurdly_far_are_not_seen(walk):
    positions = 1000.0 * walk
    positions[3, 2, 0], positions[5, 7, 1] = -9999.0, 1e9
    found, _, sentinels = without_sentinels(positions, LABELS)
    assert np.argwhere(np.isnan(found[..., 0])).tolist() == [[3, 2], [5, 7]]
    [problem] = sentinels
    assert (problem.code, problem.values["count"], problem.values["positions"]) == ("markers_at_sentinel", 2, 2)
    assert "LPSI" in problem.where.markers
    [text] = facts(sentinels)
    assert "2 markers are at [-9999.0, " in text and "LPSI" in text and "(2 positions)" in text


def test_a_clean_recording_is_left_alone(walk):
    far = np.concatenate([walk, walk + [8.0, 3.0, 0.0]], axis=1)  # another person
    found, zeros, sentinels = without_sentinels(far, LABELS * 2)
    np.testing.assert_array_equal(found, far)
    assert not zeros and not sentinels
