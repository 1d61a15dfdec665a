"""Hands in footage: crops stand upright where the arm ends, and what is found in them comes back to the picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cameras.projection import project
from solver_backend.types import Capture
from solver_backend.videos.detect.child.pose_workers import litert_hands
from solver_backend.videos.detect.child.pose_workers.serve import Refused
from solver_backend.videos.detect.choice import chosen_hand_detector
from solver_backend.videos.detect.errors import DetectorMissing
from solver_backend.videos.detect.find_hands import arms_of, look_at, seen_by_two
from solver_backend.videos.detect.hand_crops import HAND_M, SIDE, first_crop, second_crop
from tests.support.fake_litert import FakeModel, install, sha256
from tests.support.handed_take import handed_take
from tests.support.scenes import ring_of_cameras

CAMERAS = ring_of_cameras(3)
RNG = np.random.default_rng(2)


@pytest.mark.parametrize("side", [0, 1])
def test_a_crop_stands_upright_and_a_left_hand_is_mirrored(side: int) -> None:
    wrist, elbow = np.array([500.0, 400.0]), np.array([400.0, 400.0])
    crop = first_crop(CAMERAS, 0, wrist, elbow, 3.0, side)
    up = crop.in_picture(np.array([[111.5, 0.0]]))[0] - crop.in_picture(np.array([[111.5, 223.0]]))[0]
    np.testing.assert_allclose(up / np.linalg.norm(up), [1.0, 0.0], atol=1e-9)
    hand_px = CAMERAS.K[0, 0, 0] * HAND_M / 3.0
    assert hand_px < np.linalg.norm(up) < 2.5 * hand_px
    turned = np.linalg.det(crop.A)
    assert (turned > 0) == (side == 1)
    tip = wrist + [hand_px, 0.0]
    inside = np.linalg.solve(crop.A, np.stack([wrist, tip], axis=1) - crop.b[:, None])
    assert ((inside > 0) & (inside < SIDE)).all()


@pytest.mark.parametrize("side", [0, 1])
def test_a_cut_shows_the_pictures_own_pixels(side: int) -> None:
    y, x = np.mgrid[0:240, 0:320]
    rgb = np.stack([x * 0.75, y, 0 * x], axis=-1).astype(np.uint8)
    points = np.array([160.0, 120.0]) + RNG.uniform(-30, 30, (21, 2))
    crop = second_crop(points, side)
    cut = crop.cut(rgb)
    for at in ((50, 60), (112, 112), (200, 30)):
        where = crop.in_picture(np.array([[at[1], at[0]]], dtype=float))[0]
        if ((where > 1) & (where < [318, 238])).all():
            np.testing.assert_allclose(cut[at][:2], [0.75 * where[0], where[1]], atol=1.6)
    far = replace(crop, b=crop.b + 5000.0)
    assert not far.cut(rgb).any()


def test_the_second_crop_holds_what_the_first_one_found() -> None:
    points = np.array([300.0, 200.0]) + RNG.uniform(-40, 40, (21, 2))
    crop = second_crop(points, 1)
    inside = np.linalg.solve(crop.A, (points - crop.b).T)
    assert ((inside > 0.1 * SIDE) & (inside < 0.9 * SIDE)).all()


def test_both_hands_of_a_picture_come_back_in_its_pixels() -> None:
    """A stand-in for the network knows where the hands are, and that it must look at both twice."""
    take = handed_take(4, seed=1)
    capture, frame, view = take.capture, 2, 1
    assert capture.cameras is not None
    cameras, arms = capture.cameras, arms_of(capture)
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, take.hands.points, cameras.distortion_model)
    truth, looks = px[view, frame], []
    canvas = np.zeros((1080, 1920, 3), np.uint8)

    def look(crop: np.ndarray) -> tuple[np.ndarray, float]:
        assert crop.shape == (SIDE, SIDE, 3)
        side = len(looks) // 2
        expected = first_crop(
            cameras, view, *project(
                cameras.K, cameras.distortion, cameras.R, cameras.t, arms[::-1, frame], cameras.distortion_model
            )[view][:, side], float(arms[1, frame, side] @ cameras.R[view, 2] + cameras.t[view, 2]), side,
        ) if len(looks) % 2 == 0 else second_crop(truth[side], side)  # fmt: skip
        looks.append(side)
        return np.linalg.solve(expected.A, (truth[side] - expected.b).T).T, 0.9

    found = look_at(canvas, cameras, view, arms[:, frame], look)
    assert looks == [0, 0, 1, 1]
    np.testing.assert_allclose(found[..., :2], truth, atol=1e-6)
    assert (found[..., 2] == 0.9).all()
    nothing = look_at(canvas, cameras, view, arms[:, frame], lambda crop: (np.zeros((21, 2)), 0.1))
    assert not nothing[..., 2].any()
    before, again = found.copy(), []

    def once(crop: np.ndarray) -> tuple[np.ndarray, float]:
        side = len(again)
        again.append(side)
        expected = second_crop(before[side, :, :2], side)
        return np.linalg.solve(expected.A, (truth[side] - expected.b).T).T, 0.8

    followed = look_at(canvas, cameras, view, arms[:, frame], once, before)
    assert again == [0, 1]
    np.testing.assert_allclose(followed[..., :2], truth, atol=1e-6)
    astray = before.copy()
    astray[..., 0] += 400.0
    strayed = look_at(canvas, cameras, view, arms[:, frame], lambda crop: (np.zeros((21, 2)), 0.9), astray)
    assert np.linalg.norm(strayed[:, 0, :2] - (truth[:, 0] + [400.0, 0.0]), axis=-1).min() > 100
    shown = replace(capture, keypoints=replace(capture.keypoints, hands=np.stack([np.stack([found] * 4)] * 4)))  # type: ignore[type-var]
    assert isinstance(shown, Capture)
    assert seen_by_two(shown) == {"left": 100.0, "right": 100.0}


def _hand(given: np.ndarray) -> list[np.ndarray]:
    return [np.arange(63.0), given.max(keepdims=True).reshape(1), np.zeros(1), np.zeros(63)]


@pytest.fixture
def litert(monkeypatch: pytest.MonkeyPatch) -> None:
    model = FakeModel("hand_landmark_full", (224, 224, 3), _hand, [(63,), (1,), (1,), (63,)])
    install(monkeypatch, {b"a model": model, b"with other outputs": replace(model, gives=[(1,), (63,), (1,), (63,)])})
    for content in (b"a model", b"with other outputs"):
        monkeypatch.setitem(litert_hands.MODELS, sha256(content), "hand_landmark_full")


def test_the_worker_feeds_the_model_and_reads_its_points(litert: None, tmp_path: Path) -> None:
    (tmp_path / "model.tflite").write_bytes(b"a model")
    worker = litert_hands.LiteRtHands({"model": str(tmp_path / "model.tflite")})
    assert worker.about["licence"] == "Apache-2.0"
    found = worker.detect(np.full((224, 224, 3), 255, np.uint8), 0.0)
    np.testing.assert_array_equal(found["points"][1], [3.0, 4.0])
    assert found["presence"] == [1.0]


def test_a_model_of_another_version_is_refused_by_its_hash_or_its_outputs(litert: None, tmp_path: Path) -> None:
    (tmp_path / "other.tflite").write_bytes(b"another model")
    with pytest.raises(Refused, match="SHA-256 of other.tflite is [0-9a-f]{64}; it is none of hand_landmark_full"):
        litert_hands.LiteRtHands({"model": str(tmp_path / "other.tflite")})
    (tmp_path / "other.tflite").write_bytes(b"with other outputs")
    with pytest.raises(Refused, match=r"hold \[1, 63, 1, 63\] numbers; \[63, 1\] are expected"):
        litert_hands.LiteRtHands({"model": str(tmp_path / "other.tflite")})


def test_a_missing_model_or_python_is_named(tmp_path: Path) -> None:
    with pytest.raises(DetectorMissing, match="no such model"):
        chosen_hand_detector(tmp_path / "none.tflite")
    with pytest.raises(DetectorMissing, match="no such Python"):
        chosen_hand_detector(tmp_path / "none.tflite", python=tmp_path / "python")
