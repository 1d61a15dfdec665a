"""Detectors with a name: a row of the table is all that chooses one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import solver_backend.videos.detect.child.pose_workers as workers
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.video_settings import DETECTORS, NamedDetector
from solver_backend.videos.detect import detector
from solver_backend.videos.detect.detector import DetectorMissing, chosen_detector


@pytest.mark.parametrize("name", DETECTORS)
def test_every_detector_has_a_worker_and_words(name: str) -> None:
    row = DETECTORS[name]
    assert name == name.lower() and (Path(workers.__path__[0]) / f"{row.worker}.py").is_file()
    assert row.label and not row.description.endswith(".")


def test_a_row_is_all_that_a_name_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DETECTORS, "fixed", NamedDetector("Fixed", "The same points in every picture", "fixed_pose"))
    choice = chosen_detector("Fixed", people=2, hands=True, environment={})
    assert (choice.program, choice.python) == (["-m", "pose_workers.fixed_pose"], Path(sys.executable))
    assert choice.options == {"people": 2, "hands": True}
    with pytest.raises(CommandLineInvalid, match="not a known detector") as caught:
        chosen_detector("openpose")
    assert "--detector mediapipe or fixed, or the path" in caught.value.hint


def test_the_included_models_are_run_in_our_own_python_unless_another_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detector, "INCLUDED", tmp_path)
    monkeypatch.setattr(detector, "find_spec", lambda name: object())
    with pytest.raises(DetectorMissing, match="No detector is installed"):
        chosen_detector(environment={})
    (tmp_path / detector.POSE_MODEL).write_bytes(b"model")
    choice = chosen_detector(hands=True, environment={})
    assert (choice.program, choice.python) == (["-m", "pose_workers.litert_pose"], Path(sys.executable))
    assert choice.options == {"people": 1, "model": str(tmp_path / detector.POSE_MODEL)}
    assert chosen_detector(python=Path(sys.executable)).program == ["-m", "pose_workers.mediapipe_pose"]
    monkeypatch.setattr(detector, "find_spec", lambda name: None)
    with pytest.raises(DetectorMissing):
        chosen_detector(environment={})
