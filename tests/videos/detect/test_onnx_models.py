from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.videos.detect.detector import (
    PYTHON_VARIABLE,
    DetectorFailed,
    DetectorMissing,
    DetectorOutputsUnknown,
    DetectorProcess,
    chosen_detector,
)
from tests.support.pose_models import KEYPOINTS, write_constant, write_movenet, write_rtmpose
from tests.support.videos import dots

pytest.importorskip("onnxruntime")
PLACES = np.array([[60.0, 40.0], [240.0, 90.0], [150.0, 180.0]])
SIZE = (320, 220)


@contextmanager
def running(model: Path, people: int = 1) -> Iterator[DetectorProcess]:
    with DetectorProcess(chosen_detector(str(model), people=people)) as process:
        yield process


def test_rtmpose_finds_the_points_and_looks_closer_the_second_time(tmp_path: Path) -> None:
    with running(write_rtmpose(tmp_path / "rtm.onnx")) as process:
        assert process.about["num_keypoints"] == KEYPOINTS
        found = [process.detect(dots(PLACES + move, SIZE), 0.0)["keypoints"] for move in (0.0, 3.0)]
    for move, people in zip((0.0, 3.0), found, strict=True):
        assert people.shape == (1, KEYPOINTS, 3) and (people[..., 2] > 0.9).all()
        # A step of the row of scores: the box of 180 x 140, padded and widened, over 96 columns.
        np.testing.assert_allclose(people[0, :3, :2], PLACES + move, atol=4.0)


def test_movenet_undoes_the_letterbox(tmp_path: Path) -> None:
    with running(write_movenet(tmp_path / "movenet.onnx", side=160)) as process:
        [person] = process.detect(dots(PLACES, SIZE, radius=3), 0.0)["keypoints"]
    np.testing.assert_allclose(person[:3, :2], PLACES, atol=4.0)
    np.testing.assert_allclose(person[:, 2], 0.9, atol=1e-6)


def candidates(finished: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return YOLO's output for a model of 96 x 128 and the keypoints of its two people in it."""
    points = np.zeros((4, KEYPOINTS, 3))
    points[..., 2] = 0.8
    points[0, :, :2] = np.linspace([20, 40], [40, 80], KEYPOINTS)
    points[1, :, :2] = points[0, :, :2] + 1.0  # the same person, less sure
    points[2, :, :2] = np.linspace([60, 45], [80, 85], KEYPOINTS)
    points[3, :, :2] = 5.0  # nobody
    score = np.array([0.9, 0.7, 0.8, 0.1])
    low, high = points[..., :2].min(1), points[..., :2].max(1)
    if finished:
        rows = np.column_stack([low, high, score, np.zeros(4), points.reshape(4, -1)])
        return rows[None], points[[0, 2]]
    rows = np.column_stack([0.5 * (low + high), high - low, score, points.reshape(4, -1)])
    return rows.T[None], points[[0, 2]]


@pytest.mark.parametrize("finished", [False, True])
@pytest.mark.parametrize("people", [1, 5])
def test_yolo_suppresses_the_same_person_and_scales_back(tmp_path: Path, finished: bool, people: int) -> None:
    output, expected = candidates(finished)
    with running(write_constant(tmp_path / "yolo.onnx", {"output0": output}), people) as process:
        assert process.about["num_keypoints"] == KEYPOINTS
        found = process.detect(np.zeros((256, 192, 3), np.uint8), 0.0)["keypoints"]  # twice the model's 96 x 128
    assert len(found) == min(people, 2)
    np.testing.assert_allclose(found[..., :2], 2.0 * (expected[: len(found), :, :2] + 0.5) - 0.5, atol=1e-4)


def test_a_wide_picture_is_letterboxed_in_the_middle(tmp_path: Path) -> None:
    output, expected = candidates(False)
    with running(write_constant(tmp_path / "yolo.onnx", {"output0": output})) as process:
        [person] = process.detect(np.zeros((96, 192, 3), np.uint8), 0.0)["keypoints"]
    # 192 x 96 becomes 96 x 48 in 96 x 128: 40 rows of grey above.
    np.testing.assert_allclose(person[:, :2], 2.0 * (expected[0, :, :2] - [0, 40] + 0.5) - 0.5, atol=1e-4)


def test_rtmo_reads_boxes_and_points(tmp_path: Path) -> None:
    points = candidates(False)[1]
    boxes = np.column_stack([points[..., :2].min(1), points[..., :2].max(1), [0.9, 0.2]])
    model = write_constant(tmp_path / "rtmo.onnx", {"dets": boxes[None], "keypoints": points[None]})
    with running(model, 3) as process:
        found = process.detect(np.zeros((128, 96, 3), np.uint8), 0.0)["keypoints"]
    np.testing.assert_allclose(found, points[:1], atol=1e-4)


@pytest.mark.parametrize(
    "outputs",
    [
        {"logits": np.zeros((1, 1000))},
        {"heat": np.zeros((1, 17, 32, 24))},
        {"a": np.zeros((1, 17, 96)), "b": np.zeros((1, 18, 128))},
    ],
)
def test_other_models_are_refused_with_their_outputs(tmp_path: Path, outputs: dict[str, np.ndarray]) -> None:
    model = write_constant(tmp_path / "other.onnx", outputs)
    with pytest.raises(DetectorOutputsUnknown, match=str(next(iter(outputs)))) as caught, running(model):
        pass
    assert caught.value.where == str(model)


def test_what_is_no_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "broken.onnx").write_bytes(b"no model")
    with pytest.raises(DetectorMissing, match="cannot be loaded"), running(tmp_path / "broken.onnx"):
        pass
    with pytest.raises(DetectorMissing, match="no such model"):
        chosen_detector(str(tmp_path / "none.onnx"))
    with pytest.raises(CommandLineInvalid, match="not a known detector"):
        chosen_detector("openpose")


def test_no_detector_installed(tmp_path: Path) -> None:
    with pytest.raises(DetectorMissing, match="is not the path of a Python"):
        chosen_detector(environment={PYTHON_VARIABLE: str(tmp_path / "python")})
    with pytest.raises(DetectorMissing, match="no such Python"):
        chosen_detector(python=tmp_path / "python")
    bare = tmp_path / "bare"
    bare.write_text("#!/bin/sh\necho 'something broke here' >&2\nexit 3\n", encoding="utf-8")
    bare.chmod(0o755)
    with pytest.raises(DetectorFailed, match="something broke here"), DetectorProcess(chosen_detector(python=bare)):
        pass
