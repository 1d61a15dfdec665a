"""What a capture's numbers can be: the impossible is refused, the odd is told, whichever reader read it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.errors import CalibrationInvalid, CaptureInvalid
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import Capture, JointSet, Keypoints2D
from tests.support.scenes import detected, ring_of_cameras, walker
from tests.support.trial_files import write_trial
from tests.support.words import words


def good_capture() -> Capture:
    cameras = ring_of_cameras(4)
    points = walker(JointSet.COCO_17, 20, (-0.5, 0.0), (0.4, 0.1))
    xy, confidence = detected(cameras, points, np.random.default_rng(0))
    return Capture("walk", cameras=cameras, keypoints=Keypoints2D(xy, confidence, JointSet.COCO_17, 30.0))


def with_camera(**changes: Any) -> Capture:
    capture = good_capture()
    assert capture.cameras is not None
    arrays = {name: np.array(getattr(capture.cameras, name)) for name in ("K", "distortion", "R", "t", "image_size")}
    for name, change in changes.items():
        change(arrays[name])
    return replace(capture, cameras=replace(capture.cameras, **arrays))


def with_keypoints(**changes: Any) -> Capture:
    capture = good_capture()
    assert capture.keypoints is not None
    return replace(capture, keypoints=replace(capture.keypoints, **changes))


def spread(sigma: float, others: float = 1.0) -> np.ndarray:
    """Return noisy detections, those of half the views multiplied."""
    found = good_capture().keypoints
    assert found is not None
    xy = found.xy + np.random.default_rng(0).normal(0, sigma, found.xy.shape)
    xy[2:] *= others
    return xy


def put(index: Any, value: Any) -> Any:
    return lambda array: array.__setitem__(index, value)


def read_back(tmp_path: Path, capture: Capture) -> Capture:
    return load_capture(write_capture(tmp_path / "c.npz", capture))


def test_a_good_capture_has_no_problems(tmp_path: Path) -> None:
    assert read_back(tmp_path, good_capture()).problems == ()


@pytest.mark.parametrize(
    ("capture", "error", "message"),
    [
        (with_camera(K=put((1, 2), [0, 0, 2])), CalibrationInvalid, r"cam_b .*\(0, 0, 2\), but must be .*\(0, 0, 1\)"),
        (with_camera(K=put((1, 1, 0), 5.0)), CalibrationInvalid, r"\(5, 1410, 539\.5\)"),
        (with_camera(K=put((2, 0, 0), 1.4)), CalibrationInvalid, "cam_c, 1.4 and 1410 pixels, .*1920 x 1080"),
        (with_camera(K=put((2, 0, 0), 1e7)), CalibrationInvalid, "cam_c, 1e[+]07"),
        (with_camera(t=put(0, 1e9)), CalibrationInvalid, "cam_a would be 1.73e[+]06 km"),
        (with_keypoints(fps=1e-9), CaptureInvalid, "1e-09 fps is outside the plausible range of 0.01 to 30000"),
        (with_keypoints(fps=1e9), CaptureInvalid, "1e[+]09 fps"),
        (with_keypoints(xy=np.full((4, 20, 17, 2), 1e7)), CaptureInvalid, "100 % of the detections are far outside"),
    ],
)
def test_what_cannot_be_is_an_error(tmp_path: Path, capture: Capture, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        read_back(tmp_path, capture)


ODD = [
    (with_camera(K=put((2, 0, 0), 35.0)), "The focal lengths of cam_c, 35 and 1410 pixels, are implausible"),
    (with_camera(K=put((0, 0, 2), 5000.0)), "The principal point of cam_a, (5000, 539.5), is outside"),
    (
        with_camera(distortion=put((1, slice(0, 2)), [-5.0, 0.0])),
        "The lens distortion of cam_b is impossible",
    ),
    (with_camera(t=put(3, [0.0, 0.0, 500.0])), "These cameras are more than 100 m from the others: cam_d (49"),
    (with_camera(R=lambda R: R.__setitem__(1, R[0]), t=lambda t: t.__setitem__(1, t[0])), "are only 0.0 mm apart"),
    (with_keypoints(fps=0.5), "A frame rate of 0.5 fps is outside"),
    (with_keypoints(fps=5000.0), "A frame rate of 5000 fps is outside"),
    (with_keypoints(xy=spread(0.0) * 4), "% of the detections are far outside their images"),
    (with_keypoints(xy=spread(100.0)), "The cameras see the person at different positions, 9"),
    (with_keypoints(xy=spread(1.0, others=1000.0)), "The cameras see the person at different positions, 4"),
    (with_keypoints(xy=np.random.default_rng(0).uniform(0, 1900, (4, 20, 17, 2))), "No keypoint could be triangulated"),
    (with_keypoints(confidence=np.full((4, 20, 17), 85.0)), "The highest confidence is 85. The values look like"),
    (
        with_keypoints(confidence=np.full((4, 20, 17), 255.0)),
        "The highest confidence is 255. The scale is unknown",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("capture", "sentence"), ODD, ids=[sentence[:30] for _, sentence in ODD])
def test_what_is_odd_is_told(tmp_path: Path, capture: Capture, sentence: str) -> None:
    found = read_back(tmp_path, capture)
    assert sentence in "\n".join(words(found.problems))
    again = load_capture(write_capture(tmp_path / "again.npz", found))
    assert again.problems == found.problems


def test_per_cent_become_shares_and_a_few_above_one_are_cut(tmp_path: Path) -> None:
    found = read_back(tmp_path, with_keypoints(confidence=np.full((4, 20, 17), 85.0)))
    assert found.keypoints is not None
    np.testing.assert_allclose(found.keypoints.confidence, 0.85, rtol=1e-6)
    found = read_back(tmp_path / "b", with_keypoints(confidence=np.full((4, 20, 17), 1.25)))
    assert found.keypoints is not None
    assert set(np.unique(found.keypoints.confidence)) == {1.0}
    assert words(found.notes)[0].startswith("The highest confidence is 1.25. Values above 1 are treated as 1.")


def test_per_cent_in_folders_of_detections(tmp_path: Path) -> None:
    write_trial(tmp_path / "trial")
    for path in (tmp_path / "trial" / "pose").rglob("*.json"):
        content = json.loads(path.read_text())
        for person in content["people"]:
            person["pose_keypoints_2d"][2::3] = [100 * c for c in person["pose_keypoints_2d"][2::3]]
        path.write_text(json.dumps(content))
    found = load_capture(tmp_path / "trial")
    assert found.keypoints is not None
    assert 0.3 < found.keypoints.confidence.max() <= 1.0
    assert sum("percent" in problem for problem in words(found.problems)) == 1


def test_info_shows_problems_also_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_capture(tmp_path / "c.npz", with_keypoints(fps=5000.0))
    assert main(["info", str(path)]) == 0
    assert "problem     A frame rate of 5000 fps is outside" in capsys.readouterr().out
    assert main(["info", str(path), "--json"]) == 0
    assert "A frame rate of 5000 fps" in json.loads(capsys.readouterr().out.splitlines()[-1])["problems"][0]
