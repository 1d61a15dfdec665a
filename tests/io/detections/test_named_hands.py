"""Hands by the names of their points, as DeepLabCut, SLEAP and people's own tables have them."""

from __future__ import annotations

import csv
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.joint_sets import FINGERS, HAND_POINTS
from solver_backend.io.detections.named_keypoints import hand_point
from solver_backend.io.load import load_capture
from solver_backend.types import Cameras, Keypoints2D
from tests.support.calibration_files import toml_text
from tests.support.handed_take import handed_take
from tests.support.words import codes

FRAMES = 6
BODY = ("nose", *(f"{side}_{part}" for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
                  for side in ("left", "right")))  # fmt: skip


@cache
def take() -> tuple[Cameras, Keypoints2D]:
    return handed_take(FRAMES, seed=2).capture.require_multiview()


def whole(side: str, point: str) -> str:
    return f"{side}_{point}"


def wholebody(side: str, point: str) -> str:
    """Name a point as COCO-WholeBody's annotations do."""
    finger, place = point.split("_")
    names = {"index": "forefinger", "middle": "middle_finger", "ring": "ring_finger", "pinky": "pinky_finger"}
    along = ("cmc", "mcp", "ip", "tip") if finger == "thumb" else ("mcp", "pip", "dip", "tip")
    return f"{side}_{names.get(finger, finger)}{along.index(place) + 1}"


def camel(side: str, point: str) -> str:
    finger, place = point.split("_")
    return f"{finger}{place.title()}_{side[0].upper()}"


def mediapipe(side: str, point: str) -> str:
    finger, place = point.split("_")
    return f"{side.title()}Hand{'' if finger == 'thumb' else 'Finger'}_{finger.upper()}_{place.upper()}"


def write(root: Path, names: dict[tuple[int, int], str]) -> Path:
    """Write bodies and hands as DeepLabCut's tables, a camera each."""
    root.mkdir(exist_ok=True)
    (root / "calibration").mkdir()
    cameras, keypoints = take()
    (root / "calibration" / "Calib.toml").write_text(toml_text(cameras))
    joints = keypoints.joint_set.keypoints
    assert keypoints.hands is not None
    columns = [*BODY, *names.values()]
    for c, camera in enumerate(cameras.names):
        body = [joints.index(name) for name in BODY]
        found = np.concatenate([keypoints.xy[c][:, body], keypoints.confidence[c][:, body, None]], axis=-1)
        own = np.stack([keypoints.hands[c][:, side, point] for side, point in names], axis=1)
        with (root / f"{camera}DLC_resnet50_dance.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["scorer", *["me"] * 3 * len(columns)])
            table.writerow(["bodyparts", *[name for name in columns for _ in range(3)]])
            table.writerow(["coords", *["x", "y", "likelihood"] * len(columns)])
            for f, row in enumerate(np.concatenate([found, own], axis=1).reshape(FRAMES, -1)):
                table.writerow([f, *("" if np.isnan(value) else f"{value:.6f}" for value in row)])
    return root


def read(root: Path) -> Keypoints2D:
    keypoints = load_capture(root, fps=30.0, as_calibrated=True).keypoints
    assert keypoints is not None
    return keypoints


@pytest.mark.slow
@pytest.mark.parametrize("style", [whole, wholebody, camel, mediapipe])
def test_hands_come_by_name(tmp_path: Path, style) -> None:
    names = {(side, point): style(("left", "right")[side], HAND_POINTS[point]) for side in range(2)
             for point in range(1, 21)}  # fmt: skip
    keypoints = read(write(tmp_path / "take", names))
    assert keypoints.hands is not None
    np.testing.assert_allclose(keypoints.hands[..., 1:, :], take()[1].hands[..., 1:, :], atol=1e-3)
    wrists = [keypoints.joint_set.keypoints.index(f"{side}_wrist") for side in ("left", "right")]
    seen = keypoints.hands[..., 0, 2] > 0
    assert seen.any()
    np.testing.assert_allclose(keypoints.hands[..., 0, :2][seen], keypoints.xy[:, :, wrists][seen], atol=1e-3)
    capture = load_capture(tmp_path / "take", fps=30.0)
    assert "keypoints_unknown" not in codes(capture.notes)


def test_own_names_lead_to_hands(tmp_path: Path) -> None:
    names = {(0, point): f"pt{point}" for point in range(1, 21)}
    root = write(tmp_path / "take", names)
    landmarks = {f"pt{point}": f"left_{HAND_POINTS[point]}" for point in range(1, 21)}
    (root / "keypoints.json").write_text(json.dumps({"landmarks": landmarks}))
    hands = read(root).hands
    assert hands is not None and not (hands[:, :, 1, :, 2] > 0).any()
    np.testing.assert_allclose(hands[:, :, 0, 1:], take()[1].hands[:, :, 0, 1:], atol=1e-3)


@pytest.mark.slow
def test_few_points_are_no_hand(tmp_path: Path) -> None:
    names = {(0, point): whole("left", HAND_POINTS[point]) for point in (4, 8)}
    root = write(tmp_path / "take", names)
    assert read(root).hands is None
    assert "keypoints_unknown" in codes(load_capture(root, fps=30.0).notes)


def test_fingers_of_a_body_are_none_of_a_hand() -> None:
    assert [hand_point(name) for name in ("left_index", "right_pinky", "left_thumb", "left_wrist", "nose")] == [
        None
    ] * 5
    assert (
        hand_point("left_big_toe1") is None and hand_point("index_tip") is None and hand_point("left_index_9") is None
    )
    assert hand_point("left_hand_root") == (0, 0)
    assert [hand_point(f"R_{finger}4") for finger in FINGERS] == [(1, 4), (1, 8), (1, 12), (1, 16), (1, 20)]
