"""Footage of another size than the calibration: hands come back in the calibration's pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pytest

import solver_backend.videos.detect.find_hands as find_hands_module
from solver_backend.cameras.projection import project
from solver_backend.types import Cameras
from solver_backend.videos.detect.detector import DetectorChoice
from solver_backend.videos.detect.find_hands import Arms, arms_of, find_hands, footage_scale
from solver_backend.videos.files.video import VideoInfo
from tests.support.handed_take import handed_take

FRAMES = 4


class NoProcess:
    """No detector runs."""

    def __init__(self, choice: Any, threads: int) -> None: ...
    def __enter__(self) -> NoProcess:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None: ...


def filmed(size: tuple[int, int], stored: tuple[int, int] = (0, 0)) -> VideoInfo:
    return VideoInfo(Path("video"), size, np.zeros(1), stored=stored if any(stored) else size)


def test_hands_of_half_size_footage_are_in_the_calibrations_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    take = handed_take(FRAMES, seed=1)
    cameras, keypoints = take.capture.cameras, take.capture.keypoints
    assert cameras is not None and keypoints is not None
    # Half as high, and cut to whole blocks in width.
    sizes, by = {"half": (952, 540), "whole": (1920, 1080)}, np.array([952 / 1920, 0.5])
    whole = arms_of(take.capture)[0]

    def search(pictures: dict[int, int], filmed: Cameras, arms: Arms, look: Callable, *_: Any) -> np.ndarray:
        frame = pictures[0]
        px = project(filmed, take.hands.points)
        own = whole.detected[:, frame, ..., :2]
        np.testing.assert_allclose(arms.detected[0, ..., :2], (own[0] + 0.5) * by - 0.5)
        np.testing.assert_array_equal(arms.detected[1:, ..., :2], own[1:])
        return np.concatenate([px[:, frame], np.ones((4, 2, 21, 1))], axis=-1)

    monkeypatch.setattr(find_hands_module, "DetectorProcess", NoProcess)
    monkeypatch.setattr(find_hands_module, "pictures_of", lambda capture, each: ((f, {0: f}) for f in range(FRAMES)))
    monkeypatch.setattr(find_hands_module, "search_hands", search)
    monkeypatch.setattr(find_hands_module, "probe", lambda path: filmed(sizes[path.name]))
    seen = replace(take.capture, footage=(Path("half"), Path("whole"), None, None))
    found = find_hands(seen, DetectorChoice.__new__(DetectorChoice)).keypoints
    truth = project(cameras, take.hands.points)
    assert found is not None and found.hands is not None
    np.testing.assert_allclose(found.hands[..., :2], truth, atol=1e-6)


def test_pictures_cut_to_blocks_and_of_another_shape_are_left_alone() -> None:
    cameras = handed_take(FRAMES, seed=1).capture.cameras
    assert cameras is not None
    scale = footage_scale(cameras, [filmed((1904, 1080)), filmed((1080, 1920)), None, filmed((3840, 2160))])
    np.testing.assert_allclose(scale, [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0], [2.0, 2.0]])


def test_footage_is_as_wide_as_shown_where_the_calibration_has_stored_pixels() -> None:
    cameras = handed_take(FRAMES, seed=1).capture.cameras
    assert cameras is not None  # of 1920 x 1080 pixels
    scale = footage_scale(cameras, [filmed((2560, 1080), (1920, 1080)), filmed((1920, 1080), (1440, 1080)), None, None])
    np.testing.assert_allclose(scale[:2], [[4 / 3, 1.0], [1.0, 1.0]])
