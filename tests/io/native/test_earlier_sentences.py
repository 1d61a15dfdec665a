"""Capture files of earlier versions: what later steps depend on is known by its code."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.cameras.noise_map import detector_of, is_applied
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.types import Capture
from tests.support.words import codes, words

PERSON = (
    "Triangulated, the person is about 1.71 m tall by the legs; keypoints span 1.60 m upwards from z = -0.02 m; median "
    "residual 2.5 px."
)


@pytest.mark.parametrize(
    ("sentence", "code"),
    [
        ("Confidences stand for variances as measured of toy 1 on 90 keypoints.", "noise_map_applied"),
        (
            "Confidences stand for variances as measured of a 1 on 9 keypoints. These detections are of toy 1.",
            "noise_map_of_another",
        ),
        ("Detector: toy 1; 250 moments at 59.94 a second that all 4 videos show.", "detector_used"),
        (PERSON, "person_triangulated"),
        ("Calibration: 4 cameras.", "earlier_note"),
    ],
)
def test_a_sentence_is_known_by_its_code_and_reads_as_it_did(tmp_path: Path, sentence: str, code: str) -> None:
    notes = read_capture(write_capture(tmp_path / "c.npz", Capture("c", notes=(sentence,)))).notes
    assert codes(notes) == (code,) and words(notes) == (sentence,)
    assert is_applied(notes) == code.startswith("noise_map")
    assert detector_of(notes) == ("toy 1" if code == "detector_used" else None)
