"""Footage and detections in time: hands show by how many pictures one is late of the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import Any

import numpy as np
import pytest

import solver_backend.videos.detect.find_hands as find_hands_module
from solver_backend.exchange.diagnostics import Remedy
from solver_backend.types import Capture
from solver_backend.videos.detect.detector import DetectorChoice
from solver_backend.videos.detect.find_hands import arms_of, find_hands, footage_shift, in_time
from tests.support.handed_take import handed_take


@pytest.fixture(scope="module")
def capture() -> Capture:
    """Return a take of 60 frames whose hands are detected in every view."""
    return handed_take(60, seed=1).capture


def hands_and_wrists(capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    assert capture.keypoints is not None and capture.keypoints.hands is not None
    return capture.keypoints.hands, arms_of(capture)[0].detected[:, :, 1]


@pytest.mark.parametrize("late", [-3, -1, 0, 1, 4])
def test_footage_that_is_late_or_early_is_moved_in_time(capture: Capture, late: int) -> None:
    hands, wrists = hands_and_wrists(capture)
    filmed = in_time(hands, -late)
    shift = footage_shift(filmed, wrists)
    assert shift == late
    back = in_time(filmed, shift)
    inside = slice(abs(late), 60 - abs(late))
    np.testing.assert_array_equal(back[:, inside], hands[:, inside])
    assert not back[:, : max(-late, 0), ..., 2].any() and not back[:, 60 - max(late, 0) :, ..., 2].any()


def test_hands_that_rest_or_disagree_show_nothing(capture: Capture) -> None:
    hands, wrists = hands_and_wrists(capture)
    still = np.broadcast_to(hands[:, :1], hands.shape)
    assert footage_shift(still, wrists) == 0 and footage_shift(hands[:, :15], wrists[:, :15]) == 0
    apart = np.stack([in_time(hand[None], late)[0] for hand, late in zip(hands, (3, -3, 1, -1), strict=True)])
    assert footage_shift(apart, wrists) == 0


def test_what_is_found_in_late_footage_belongs_to_earlier_frames(
    capture: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    hands, _ = hands_and_wrists(capture)
    filmed = in_time(hands, -2)

    class NoProcess:
        def __init__(self, choice: Any, threads: int) -> None: ...
        def __enter__(self) -> NoProcess:
            return self

        def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None: ...

    def search(pictures: Any, cameras: Any, arms: Any, look: Callable, *_: Any) -> np.ndarray:
        return filmed[:, pictures[0]]

    monkeypatch.setattr(find_hands_module, "DetectorProcess", NoProcess)
    monkeypatch.setattr(find_hands_module, "pictures_of", lambda capture, each: ((f, {0: f}) for f in range(60)))
    monkeypatch.setattr(find_hands_module, "search_hands", search)
    monkeypatch.setattr(
        find_hands_module, "probe", lambda path: SimpleNamespace(size=(1920, 1080), stored=(1920, 1080))
    )
    seen = replace(capture, footage=(Path("a"), None, None, None), footage_first=(5, 0, 0, 0))
    found = find_hands(seen, DetectorChoice.__new__(DetectorChoice))
    assert found.keypoints is not None and found.keypoints.hands is not None
    np.testing.assert_array_equal(found.keypoints.hands[:, 2:58], hands[:, 2:58])
    assert found.footage_first == (7, 2, 2, 2)
    named = [note for note in found.notes if note.code == "footage_late"]
    assert [(note.values["size"], note.remedy) for note in named] == [(2, Remedy.REPAIRED)]
