"""A focal length without a calibration: what was given counts before what the file says, and that before a guess."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.camera_calibration.intrinsics.known_lenses import EQUIVALENT_SIGMA, GUESSED_SIGMA, find_focal_length
from solver_backend.exchange.errors import CommandLineInvalid
from tests.support.phone_video import phone_video

SIZE = (1920, 1080)


def test_given_then_recorded_then_guessed(tmp_path: Path) -> None:
    video = phone_video(tmp_path / "a.mov", 1, b"26")
    given = find_focal_length("1450px", video, SIZE)
    assert (given.px, given.sigma) == (1450.0, 0.0)
    equivalent, recorded = (find_focal_length(text, video, SIZE) for text in ("26 mm", ""))
    assert recorded.px == equivalent.px == pytest.approx(26 / 43.27 * (1920**2 + 1080**2) ** 0.5)
    assert recorded.sigma == equivalent.sigma == EQUIVALENT_SIGMA and "26 mm" in recorded.source
    guessed = find_focal_length("", tmp_path / "none.mp4", SIZE)
    assert guessed.px == 0.9 * 1920 and guessed.sigma == GUESSED_SIGMA and "guess" in guessed.source
    lens = recorded.lens(SIZE)
    assert lens.K[0, 0] == lens.K[1, 1] == pytest.approx(recorded.px) and lens.K[0, 2] == 959.5


@pytest.mark.parametrize("text", ["26", "wide", "-3mm", "2mm", "90000px", "10px", "1e3px"])
def test_what_is_no_focal_length_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(CommandLineInvalid, match="26mm"):
        find_focal_length(text, tmp_path / "none.mp4", SIZE)
