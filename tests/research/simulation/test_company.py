"""Two people who cross: the truth is consistent, and who hides whom is not seen."""

from __future__ import annotations

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings
from research.simulation.company import PASSING_M, crossing
from solver_backend.agreement.person_selection import select_people
from solver_backend.exchange.errors import TakeTooShort
from solver_backend.synthesis.simulation.cast import Take
from tests.support.walking_take import walk


@pytest.fixture(scope="module")
def filmed():
    take = _striding(walk())
    return crossing((take, take), BenchmarkSettings(seed=3))


def _striding(take: Take, frames: int = 40, metres: float = 2.0) -> Take:
    """Return the first frames, carried forward."""
    root = take.root[:frames] + np.linspace(0.0, metres, frames)[:, None] * [0.0, 0.0, 1.0]
    return Take(take.name, take.rotations[:frames], root, take.fps)


def test_they_pass_each_other_in_the_middle(filmed) -> None:
    apart = np.linalg.norm((filmed.joints[0] - filmed.joints[1])[:, 0, :2], axis=-1)
    assert PASSING_M[0] - 0.1 < apart.min() < PASSING_M[1] + 0.1 and apart[[0, -1]].min() > apart.min() + 0.3
    assert abs(int(apart.argmin()) - len(apart) // 2) <= 4


def test_each_detection_is_whose_it_says(filmed) -> None:
    views, frames, slots = np.nonzero(filmed.who >= 0)
    for number, alone in enumerate(filmed.alone):
        mine = filmed.who[views, frames, slots] == number
        said = filmed.detections.xy[views[mine], frames[mine], slots[mine]]
        offset = np.linalg.norm(said - alone.xy[views[mine], frames[mine]], axis=-1)
        assert np.nanmedian(offset) < 1e-3  # the same noise, but where the other stands before
    assert len(set(filmed.who[0, :, 0].tolist())) > 1  # listed in any order


def test_both_are_found_and_nobody_is_mixed_in(filmed) -> None:
    found = select_people(filmed.cameras, filmed.detections, filmed.fps)
    views, frames = np.indices(found[0].detection.shape)
    whose = [np.unique(filmed.who[views, frames, p.detection][p.detection >= 0]).tolist() for p in found]
    assert sorted(whose) == [[0], [1]]


def test_three_frames_are_no_crossing() -> None:
    with pytest.raises(TakeTooShort):
        crossing((_striding(walk(), 3), walk()))
