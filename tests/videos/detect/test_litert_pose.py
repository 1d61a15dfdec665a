"""The LiteRT worker for bodies: people are found, followed, and put where they are in the picture.

The models are stand-ins. Red and green of the test's pictures are each pixel's place, so that a model that sees only a
crop knows where it is, and answers with the points of the people who are there.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.videos.detect.child.pose_workers import litert_pose
from solver_backend.videos.detect.child.pose_workers.litert_pose import (
    NUM_ANCHORS,
    LiteRtPose,
    aligned,
    found_people,
    refined,
    whole_picture,
)
from solver_backend.videos.detect.child.pose_workers.serve import Refused
from solver_backend.videos.detect.detector import DetectorMissing, chosen_detector
from tests.support.fake_litert import FakeModel, install, sha256

WIDE, HIGH, SCALE = 960, 540, 3.8  # Of the picture, pixels; and pixels of a step of colour.
LOGIT = 3.0


def picture() -> np.ndarray:
    y, x = np.mgrid[0:HIGH, 0:WIDE]
    return np.stack([x / SCALE, y / SCALE, np.full_like(x, 255)], axis=-1).round().astype(np.uint8)


def person(hips: tuple[float, float], up_deg: float = 90.0, radius: float = 150.0, seed: int = 0) -> np.ndarray:
    """Return the (39, 2) points of a person, pixels; 33 are the hips, 34 the top of the circle."""
    up = np.array([np.cos(np.radians(up_deg)), -np.sin(np.radians(up_deg))])
    points = np.array(hips) + np.random.default_rng(seed).uniform(-0.7, 0.7, (39, 2)) * radius
    points[33], points[34] = hips, np.array(hips) + radius * up
    return points


@dataclass
class Scene:
    """Who is in the picture, and how often each model was asked."""

    people: list[np.ndarray]
    detected: int = 0
    looked: int = 0
    up: list[np.ndarray] = field(default_factory=list)
    """Direction in the crop of each person's top from the hips."""

    def detector(self, given: np.ndarray) -> list[np.ndarray]:
        """Return a box at the anchor nearest to each person."""
        self.detected += 1
        A, b = mapping((given + 1.0) / 2.0)
        boxes, scores = np.zeros((NUM_ANCHORS, 12)), np.full((NUM_ANCHORS, 1), -9.0)
        for points in self.people:
            hips, top = (np.linalg.solve(A, points[k] - b) for k in (33, 34))
            x, y = (np.floor(hips / 8.0)).astype(int)
            anchor = 2 * (28 * y + x)
            middle = 8.0 * np.array([x + 0.5, y + 0.5])
            size = 2.0 * np.linalg.norm(top - hips) * np.ones(2)
            boxes[anchor] = np.concatenate([hips - middle, size, hips - middle, top - middle, np.zeros(4)])
            scores[anchor] = LOGIT
        return [boxes, scores]

    def landmarks(self, given: np.ndarray) -> list[np.ndarray]:
        """Return the points of the person whose hips are nearest to the middle of the crop."""
        self.looked += 1
        A, b = mapping(given)
        inside = [np.linalg.solve(A, (points - b).T).T for points in self.people]
        apart = [np.linalg.norm(points[33] - 128.0) for points in inside]
        if not apart or min(apart) > 50:
            return [np.zeros(195), np.array([0.1]), np.zeros(256 * 256), np.full(64 * 64 * 39, -9.0)]
        points = inside[int(np.argmin(apart))]
        self.up.append((points[34] - points[33]) / np.linalg.norm(points[34] - points[33]))
        numbers = np.concatenate([points, np.zeros((39, 1)), np.full((39, 1), LOGIT), np.zeros((39, 1))], axis=1)
        return [numbers.ravel(), np.array([0.9]), np.zeros(256 * 256), np.full(64 * 64 * 39, -9.0)]


def mapping(crop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return A and b of ``x_picture = A x_crop + b`` as the colours of a crop show them."""
    y, x = np.mgrid[0 : len(crop) : 3, 0 : len(crop) : 3]
    crop = crop[::3, ::3]
    place = 255.0 * SCALE * crop[..., :2]
    high = (HIGH - 1) / SCALE
    clear = (crop[..., 2] > 0.99) & (place[..., 0] > 2 * SCALE) & (place[..., 1] > 2 * SCALE)
    clear &= (place[..., 0] < WIDE - 3 * SCALE) & (place[..., 1] < SCALE * (high - 3))
    columns = np.stack([x[clear], y[clear], np.ones(clear.sum())], axis=1)
    found, *_ = np.linalg.lstsq(columns, place[clear], rcond=None)
    return found[:2].T, found[2]


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Scene:
    scene = Scene([person((400.0, 270.0))])
    land = FakeModel("pose_landmark_full", (256, 256, 3), scene.landmarks, [(195,), (1,), (256, 256, 1), (64, 64, 39)])
    det = FakeModel("pose_detection", (224, 224, 3), scene.detector, [(NUM_ANCHORS, 12), (NUM_ANCHORS, 1)])
    install(monkeypatch, {b"landmarks": land, b"detector": det})
    monkeypatch.setitem(litert_pose.LANDMARKS, sha256(b"landmarks"), land.name)
    monkeypatch.setitem(litert_pose.DETECTORS, sha256(b"detector"), det.name)
    (tmp_path / "pose_landmark_full.tflite").write_bytes(b"landmarks")
    (tmp_path / litert_pose.DETECTOR_FILE).write_bytes(b"detector")
    return scene


def worker(folder: Path, people: int = 1) -> LiteRtPose:
    return LiteRtPose({"model": str(folder / "pose_landmark_full.tflite"), "people": people})


@pytest.mark.parametrize("up_deg", [90.0, 160.0, -80.0])
def test_a_person_is_found_upright_in_the_crop_and_followed_without_the_detector(scene, tmp_path, up_deg):
    scene.people = [person((400.0, 270.0), up_deg)]
    detector, rgb = worker(tmp_path), picture()
    for shift in ((0.0, 0.0), (9.0, -4.0), (18.0, -8.0)):
        points = scene.people[0] + shift
        scene.people = [points]
        [found] = detector.detect(rgb, 0.0)["keypoints"]
        inside = ((points[:33] >= 0) & (points[:33] <= (WIDE, HIGH))).all(axis=1)
        assert np.abs(found[:, :2] - (points[:33] - 0.5)).max() < 0.3
        assert np.allclose(found[:, 2], inside / (1.0 + np.exp(-LOGIT)), atol=1e-6)
    assert scene.detected == 1 and scene.looked == 3
    assert np.allclose(scene.up[0], (0.0, -1.0), atol=0.02)


def test_who_is_lost_is_looked_for_in_the_same_picture_and_found_again(scene, tmp_path):
    detector, rgb = worker(tmp_path), picture()
    assert len(detector.detect(rgb, 0.0)["keypoints"]) == 1
    here, scene.people = scene.people, [person((800.0, 200.0), radius=90.0)]
    [found] = detector.detect(rgb, 0.0)["keypoints"]
    assert np.abs(found[:, :2] - (scene.people[0][:33] - 0.5)).max() < 0.3
    scene.people = []
    assert detector.detect(rgb, 0.0)["keypoints"].shape == (0, 33, 3)
    scene.people = here
    assert len(detector.detect(rgb, 0.0)["keypoints"]) == 1 and scene.detected == 4


def test_several_people_are_each_found_once(scene, tmp_path):
    scene.people = [person((250.0, 270.0)), person((700.0, 270.0), seed=1)]
    rgb = picture()
    assert len(worker(tmp_path).detect(rgb, 0.0)["keypoints"]) == 1
    detector = worker(tmp_path, people=3)
    for _ in range(2):
        found = detector.detect(rgb, 0.0)["keypoints"]
        hips = sorted(round(float(points[:, 0].mean() - true[:33, 0].mean()), 0) for points, true in zip(
            sorted(found, key=lambda p: p[:, 0].mean()), scene.people, strict=True))  # fmt: skip
        assert len(found) == 2 and np.abs(hips).max() <= 1.0


def test_overlapping_boxes_are_one_person_and_scores_below_half_are_none():
    boxes, scores = np.zeros((NUM_ANCHORS, 12)), np.full(NUM_ANCHORS, -9.0)
    boxes[:, 2:4] = 60.0
    hips, top = np.array([3.0, -2.0]), np.array([3.0, -40.0])
    for anchor in (2 * (28 * 10 + 10), 2 * (28 * 10 + 11)):
        middle = 8.0 * np.array([10.5 + (anchor // 2) % 28 - 10, 10.5])
        boxes[anchor, 4:8] = np.concatenate([np.array([84.0, 84.0]) + hips - middle, [84.0, 84.0] + top - middle])
        scores[anchor] = 2.0
    scores[2 * (28 * 20 + 20)] = -0.1
    [(found_hips, found_top)] = found_people(boxes, scores)
    assert np.allclose(found_hips, 84.0 + hips) and np.allclose(found_top, 84.0 + top)
    scores[2 * (28 * 20 + 20)] = 0.1
    assert len(found_people(boxes, scores)) == 2


def test_points_lie_at_the_mean_of_their_heat_where_one_is_sure():
    points = np.full((39, 2), 100.0)
    heat = np.full((64, 64, 39), -20.0)
    heat[24, 27, 0] = heat[24, 28, 0] = 4.0
    heat[24, 27, 1] = -1.0  # nothing sure
    points[2] = (300.0, 100.0)  # beyond the crop
    heat[24, 27, 2] = 4.0
    found = refined(points, heat)
    assert np.allclose(found[0], (4 * 27.5, 4 * 24.0), atol=1e-3)
    assert np.array_equal(found[1:], points[1:])


def test_a_square_is_larger_than_the_circle_and_a_whole_picture_fits_its_own():
    square = aligned(np.array([100.0, 50.0]), np.array([140.0, 50.0]), 256)
    corners = square.in_picture(np.array([[128.0, 128.0], [128.0, 0.0], [0.0, 128.0]]))
    assert np.allclose(corners, [[100, 50], [150, 50], [100, 0]])
    corners = whole_picture(np.zeros((HIGH, WIDE, 3), np.uint8)).in_picture(np.array([[0.0, 0.0], [224.0, 224.0]]))
    assert np.allclose(corners, [[0, HIGH / 2 - WIDE / 2], [WIDE, HIGH / 2 + WIDE / 2]])
    black = whole_picture(picture()).cut(picture(), 224, 0.5)
    assert not black[:40].any() and black[112].any()


def test_models_that_are_not_there_or_of_another_version_are_named(scene, tmp_path):
    model, beside = tmp_path / "pose_landmark_full.tflite", tmp_path / litert_pose.DETECTOR_FILE
    beside.write_bytes(b"another")
    with pytest.raises(Refused, match=f"SHA-256 of {litert_pose.DETECTOR_FILE} is"):
        worker(tmp_path)
    beside.unlink()
    with pytest.raises(Refused, match="is not in the folder of pose_landmark_full.tflite") as refused:
        worker(tmp_path)
    assert "npm pack @mediapipe/pose@0.5" in refused.value.hint
    model.write_bytes(b"another")
    beside.write_bytes(b"detector")
    with pytest.raises(Refused, match="not one of pose_landmark_full, pose_landmark_heavy, pose_landmark_lite"):
        worker(tmp_path)


def test_a_python_without_litert_is_named(scene, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ai_edge_litert.interpreter", None)
    with pytest.raises(Refused, match="ai-edge-litert package is missing") as refused:
        worker(tmp_path)
    assert "pip install ai-edge-litert" in refused.value.hint


def test_a_model_is_run_by_the_worker_for_its_ending(tmp_path):
    for ending, module in ((".tflite", "litert_pose"), (".onnx", "onnx_pose")):
        (tmp_path / f"model{ending}").write_bytes(b"")
        choice = chosen_detector(str(tmp_path / f"model{ending}"), people=2)
        assert choice.module == module and choice.options["people"] == 2
    with pytest.raises(DetectorMissing, match="no such model"):
        chosen_detector(str(tmp_path / "none.tflite"))
    with pytest.raises(CommandLineInvalid, match="not a known detector"):
        chosen_detector(str(tmp_path / "model.pt"))
