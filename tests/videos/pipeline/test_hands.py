"""Hands on the way from videos: found where the body has its wrists, reported, and made of their model."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.progress import silent
from solver_backend.types import Capture
from solver_backend.videos.detect.detector import DetectorChoice
from solver_backend.videos.detect.find_hands import find_hands
from solver_backend.videos.pipeline.run import hands_found, made_of_hands
from tests.support.handed_take import handed_take
from tests.support.videos import write_dots

FRAMES = 4
WORKER = """
import sys
import numpy as np
from pose_workers.serve import serve

class Hands:
    def __init__(self, options):
        self.about = {"name": "drawn", "licence": "none", "num_keypoints": 21, "people": 1}

    def detect(self, rgb, time_s):
        assert rgb.shape == (224, 224, 3)
        points = np.full((21, 2), 112.0) + 40.0 * np.random.default_rng(0).standard_normal((21, 2))
        return {"points": points, "presence": np.array([0.9]), "right": np.array([1.0])}

if __name__ == "__main__":
    sys.exit(serve(Hands))
"""


@pytest.fixture
def detector(tmp_path: Path) -> DetectorChoice:
    """Return a detector that finds a hand in every crop."""
    worker, model = tmp_path / "drawn.py", tmp_path / "hand.tflite"
    worker.write_text(WORKER)
    model.write_bytes(b"model")
    return DetectorChoice(str(worker), Path(sys.executable), {"model": str(model)}, one_hand=True)


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    """Return a take of two cameras whose detections have no hands, with footage."""
    pytest.importorskip("av")
    take = handed_take(FRAMES, seed=1).capture
    assert take.cameras is not None and take.keypoints is not None
    size = tuple(int(pixels) for pixels in take.cameras.image_size[0])
    dots = np.tile([[[30.0, 25.0], [60.0, 25.0], [90.0, 25.0]]], (FRAMES, 1, 1))
    footage = tuple(
        write_dots(tmp_path / f"{name}.mp4", dots, np.arange(FRAMES) / 30.0, size) for name in take.cameras.names
    )
    return replace(take, keypoints=replace(take.keypoints, hands=None), footage=footage)


def test_hands_are_found_and_reported(capture: Capture, detector: DetectorChoice) -> None:
    found = find_hands(capture, detector, silent)
    assert found.keypoints is not None and found.keypoints.hands is not None
    seen = (found.keypoints.hands[..., 2] > 0).all(-1)
    assert seen.mean() > 0.9
    [item] = hands_found(found, detector)
    assert item.code == "hands_found" and item.values["left"] == 100.0


def test_hands_of_a_single_video_are_found_at_lifted_arms(capture: Capture, detector: DetectorChoice) -> None:
    assert hands_found(capture, None) == []
    assert capture.keypoints is not None and capture.cameras is not None
    keypoints = replace(capture.keypoints, xy=capture.keypoints.xy[:1], confidence=capture.keypoints.confidence[:1])
    one = replace(
        capture, cameras=capture.cameras.subset([0]), keypoints=keypoints, footage=capture.footage[:1]
    )  # fmt: skip
    found = find_hands(one, detector, silent)
    assert found.keypoints is not None and found.keypoints.hands is not None
    assert (found.keypoints.hands[..., 2] > 0).all(-1).mean() > 0.9
    [item] = hands_found(found, detector)
    assert item.code == "hands_found" and item.values["right"] == 100.0


def test_another_model_makes_the_capture_anew(detector: DetectorChoice) -> None:
    before = made_of_hands(detector)
    Path(detector.options["model"]).write_bytes(b"another model")
    assert made_of_hands(detector) != before and made_of_hands(None) == []


def test_the_verb_names_a_model_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "cam1.mp4").touch()
    model = tmp_path / "model.onnx"
    model.touch()
    arguments = ["from-videos", str(tmp_path), "--detector", str(model), "--hand-model", str(tmp_path / "gone.tflite")]
    assert main(arguments) != 0
    assert "There is no such model" in capsys.readouterr().err
