"""A misbehaving worker of the user's own is named, whatever it answers, and started again when it falls silent."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
import pytest

import solver_backend.videos.detect.detector as module
from solver_backend.videos.detect.detector import (
    DetectorFailed,
    DetectorOutputsUnknown,
    DetectorProcess,
    chosen_detector,
)

PICTURE = np.zeros((8, 16, 3), np.uint8)
READY = {"ready": {"name": "own", "joint_set": "COCO_17"}}
PROGRAM = """
import json, math, os, struct, sys, time
out = sys.stdout.buffer
def say(head, *numbers):
    out.write(json.dumps(head).encode() + b"\\n" + b"".join(struct.pack(f"<{{len(n)}}f", *n) for n in numbers))
    out.flush()
def keypoints(*shape):
    say({{"arrays": {{"keypoints": shape}}}}, [1] * math.prod(shape))
def picture():
    line = sys.stdin.buffer.readline()
    if not line:
        sys.exit()
    sys.stdin.buffer.read(math.prod(json.loads(line)["shape"]))
say({ready})
while True:
    picture()
    {answer}
"""


def worker(folder: Path, answer: str, ready: object = READY) -> DetectorProcess:
    path = folder / "own.py"
    path.write_text(PROGRAM.replace("\\\\", "\\").format(ready=ready, answer=answer))
    return DetectorProcess(chosen_detector(worker=path))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("out.write(b'no json\\n'); out.flush()", "not JSON"),
        ("out.write(b'[1]\\n'); out.flush()", "not a JSON object"),
        ("out.write(b'[' * 100000 + b'\\n'); out.flush()", "not JSON"),
        ("out.write(b'\\xff\\xfe\\n'); out.flush()", "not JSON"),
        ("out.write(b'x' * (1 << 21)); out.flush()", "too long"),
        ("say({})", "no arrays"),
        ("say({'arrays': [1]})", "no arrays"),
        ("say({'arrays': {str(i): [0] for i in range(40)}})", "no arrays"),
        ("say({'arrays': {'keypoints': 'x'}})", "not a shape"),
        ("say({'arrays': {'keypoints': [-1, 17, 3]}})", "not a shape"),
        ("say({'arrays': {'keypoints': [1 << 20, 17, 3]}})", "too large"),
        ("say({'arrays': {'points': [1, 17, 3]}}, [1] * 51)", "no 'keypoints'"),
        ("keypoints(17, 3)", "shape"),
        ("keypoints(1, 17, 2)", "shape"),
        ("keypoints(2, 2, 17, 3)", "shape"),
        ("keypoints(51)", "shape"),
        ("keypoints(1, 5, 3)", "5 keypoints"),
        ("say({'arrays': {'keypoints': [1, 17, 3], 'hands': [1, 21, 3]}}, [1] * 51, [1] * 63)", "'hands'"),
        ("say({'arrays': {'keypoints': [1, 17, 3], 'hands': [2, 2, 21, 3]}}, [1] * 51, [1] * 252)", "'hands'"),
        ("out.write(b'{'); out.flush(); os._exit(3)", "exit code 3"),
        ("say({'arrays': {'keypoints': [1, 17, 3]}}, [1] * 3); os._exit(4)", "exit code 4"),
        ("os._exit(5)", "exit code 5"),
        ("raise OSError('the model is gone')", "the model is gone"),
        ("print('broken', file=sys.stderr); sys.exit(1)", "broken"),
    ],
)
def test_answers_of_another_kind_or_shape_are_named(tmp_path: Path, answer: str, message: str) -> None:
    with pytest.raises(DetectorFailed, match=message), worker(tmp_path, answer) as detector:
        detector.detect(PICTURE, 0.0)


@pytest.mark.parametrize(
    ("ready", "kind"),
    [
        ({}, DetectorFailed), ({"ready": "yes"}, DetectorFailed), ({"ready": {}}, DetectorFailed),
        ({"ready": {"name": 5, "joint_set": "COCO_17"}}, DetectorFailed), ({"error": "no"}, DetectorFailed),
        ({"error": {"code": 5}}, DetectorFailed),
        ({"ready": {"name": "own"}}, DetectorOutputsUnknown),
        ({"ready": {"name": "own", "num_keypoints": "17"}}, DetectorOutputsUnknown),
        ({"ready": {"name": "own", "num_keypoints": 21}}, DetectorOutputsUnknown),
        ({"ready": {"name": "own", "joint_set": [1]}}, DetectorOutputsUnknown),
    ],
)  # fmt: skip
def test_a_worker_that_describes_itself_badly_is_named(tmp_path: Path, ready: object, kind: type[Exception]) -> None:
    with pytest.raises(kind), worker(tmp_path, "keypoints(1, 17, 3)", ready):
        pass


def test_impossible_points_are_missing_and_warn_of_nothing(tmp_path: Path) -> None:
    answer = "say({'arrays': {'keypoints': [1, 17, 3]}}, [math.inf, 1, 1, 1e30, 1, 1, math.nan, 1, 1] + [5, 5, 1] * 14)"
    with warnings.catch_warnings(), worker(tmp_path, answer) as detector:
        warnings.simplefilter("error")
        [person] = detector.detect(PICTURE, 0.0)["keypoints"]
    assert np.isnan(person[:3, :2]).all() and (person[:3, 2] == 0).all() and (person[3:] == (5, 5, 1)).all()


def test_a_nan_of_any_kind_is_read_without_a_warning() -> None:
    signalling = np.array([0x7F800001], "<u4").tobytes()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = module.read_arrays({"arrays": {"keypoints": [1]}}, io.BytesIO(signalling))
    assert np.isnan(found["keypoints"]).all()


def test_a_silent_worker_is_started_again_once_and_then_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ANSWER_S", 1.0)
    told = tmp_path / "told"
    once = f"time.sleep(0 if os.path.exists({str(told)!r}) else 60 * len(open({str(told)!r}, 'w').name)); "
    with worker(tmp_path, once + "keypoints(1, 17, 3)") as detector:
        assert detector.detect(PICTURE, 0.0)["keypoints"].shape == (1, 17, 3)
    with (
        pytest.raises(DetectorFailed, match="did not respond for 1 s"),
        worker(tmp_path, "time.sleep(60)") as detector,
    ):
        detector.detect(PICTURE, 0.0)


def test_a_worker_that_never_gets_ready_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "READY_S", 0.5)
    path = tmp_path / "own.py"
    path.write_text("import time\ntime.sleep(60)\n")
    with (
        pytest.raises(DetectorFailed, match="did not respond for 0.5 s"),
        DetectorProcess(chosen_detector(worker=path)),
    ):
        pass
