"""Pairs of few cameras are all compared, those of many grow with their number, and nobody is left alone."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from solver_backend.agreement.synchronisation import STAGE, estimate_delays
from solver_backend.cameras.camera_corrections import COMPARED, compared_pairs
from tests.support.many_views import ring, seen_by


@pytest.mark.parametrize("count", [1, 2, 4, COMPARED])
def test_all_pairs_of_few_cameras_are_compared(count: int) -> None:
    assert compared_pairs(count) == list(combinations(range(count), 2))


@pytest.mark.parametrize("count", [COMPARED + 1, 60, 200])
def test_pairs_of_many_cameras_grow_with_their_number_and_hang_together(count: int) -> None:
    pairs = compared_pairs(count)
    assert len(pairs) <= count * (COMPARED - 1) and len(set(pairs)) == len(pairs)
    degree = np.bincount(np.ravel(pairs), minlength=count)
    assert degree.min() >= COMPARED - 1


@pytest.mark.slow
def test_a_late_camera_of_forty_is_found_and_progress_is_shown() -> None:
    capture = seen_by(ring(40), 60)
    cameras, keypoints = capture.require_multiview()
    xy = keypoints.xy.copy()
    xy[7, 4:] = keypoints.xy[7, :-4]
    late = replace(keypoints, xy=xy)
    told: list[tuple[int, int]] = []

    def progress(stage: str, done: int, total: int) -> None:
        assert stage == STAGE
        told.append((done, total))

    found = estimate_delays(cameras, late.xy, 20, progress=progress)
    assert found.frames[7] == pytest.approx(4.0, abs=0.3)
    assert np.abs(np.delete(found.frames, 7)).max() < 0.3
    assert len(told) > 1 and told[-1][0] == told[-1][1]
