"""Hands in footage: crops stand upright where the arm ends, and what is found in them comes back to the picture."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import solver_backend.videos.detect.find_hands as find_hands_module
from solver_backend.cameras.projection import project
from solver_backend.types import Cameras
from solver_backend.videos.detect.child.pose_workers import litert_pose
from solver_backend.videos.detect.child.pose_workers.crops import SquareCrop
from solver_backend.videos.detect.child.pose_workers.serve import Refused
from solver_backend.videos.detect.detector import DetectorMissing, chosen_hand_detector
from solver_backend.videos.detect.find_hands import (
    HAND_M,
    LEAST_TRUST,
    RIGHT,
    SIDE,
    Arms,
    HandInCrop,
    Look,
    arms_of,
    first_crop,
    is_due,
    pictures_of,
    search_hands,
    second_crop,
    seen_by,
)
from solver_backend.videos.files.video import Picture
from tests.support.fake_litert import FakeModel, install, sha256
from tests.support.handed_take import handed_take
from tests.support.scenes import ring_of_cameras

CAMERAS = ring_of_cameras(3)
RNG = np.random.default_rng(2)


@pytest.mark.parametrize("side", [0, 1])
def test_a_crop_stands_upright_and_a_left_hand_is_mirrored(side: int) -> None:
    wrist, elbow = np.array([500.0, 400.0]), np.array([400.0, 400.0])
    hand_px = CAMERAS.K[0, 0, 0] * HAND_M / 3.0
    crop = first_crop(wrist, elbow, hand_px, side)
    up = crop.in_picture(np.array([[111.5, 0.0]]))[0] - crop.in_picture(np.array([[111.5, 223.0]]))[0]
    np.testing.assert_allclose(up / np.linalg.norm(up), [1.0, 0.0], atol=1e-9)
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
    cut = crop.cut(rgb, SIDE, 0.0)
    for at in ((50, 60), (112, 112), (200, 30)):
        where = crop.in_picture(np.array([[at[1], at[0]]], dtype=float))[0]
        if ((where > 1) & (where < [318, 238])).all():
            np.testing.assert_allclose(cut[at][:2], [0.75 * where[0], where[1]], atol=1.6)
    far = replace(crop, b=crop.b + 5000.0)
    assert not far.cut(rgb, SIDE, 0.0).any()


def test_the_second_crop_holds_what_the_first_one_found() -> None:
    points = np.array([300.0, 200.0]) + RNG.uniform(-40, 40, (21, 2))
    crop = second_crop(points, 1)
    inside = np.linalg.solve(crop.A, (points - crop.b).T)
    assert ((inside > 0.1 * SIDE) & (inside < 0.9 * SIDE)).all()


@dataclass(frozen=True)
class Scene:
    """A frame of a take whose pictures are blank, and a network that knows where the hands are."""

    cameras: Cameras
    arms: Arms
    truth: np.ndarray
    """(C, 2, 21, 2) px."""
    pictures: dict[int, np.ndarray]

    def look(self, seen: np.ndarray, spent: list[tuple[int, int]], reach: float = 0.7) -> Look:
        """Return what finds hands whose middle lies in the crop's, in views and sides (C, 2) that show them."""

        def find(rgb: np.ndarray) -> HandInCrop:
            view, crop, side = placed.pop()
            spent.append((view, side))
            own = np.linalg.solve(crop.A, (self.truth[view, side] - crop.b).T).T
            inside = np.abs(own.mean(axis=0) - 0.5 * SIDE).max() < reach * 0.5 * SIDE
            return (
                HandInCrop(own, 0.9) if inside and seen[view, side] else HandInCrop(np.full((21, 2), 0.5 * SIDE), 0.01)
            )

        return find


placed: list[tuple[int, SquareCrop, int]] = []
"""Crops that were cut and not looked at yet: their view, themselves, their side."""


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Scene:
    """Return a scene whose pictures are as bright as their view's number, so that a crop shows whose it is."""
    take = handed_take(4, seed=1)
    assert take.capture.cameras is not None
    cameras, frame = take.capture.cameras, 2
    px = project(cameras, take.hands.points)
    pictures = {view: np.full((1080, 1920, 3), 10 * view, np.uint8) for view in range(len(cameras))}
    cut = SquareCrop.cut

    def noted(self: SquareCrop, rgb: np.ndarray, side: int, black_from: float | None) -> np.ndarray:
        placed.append((int(rgb[0, 0, 0]) // 10, self, int(np.linalg.det(self.A) > 0)))
        found = cut(self, rgb, side, black_from)
        assert found.shape == (SIDE, SIDE, 3)
        return found

    monkeypatch.setattr(SquareCrop, "cut", noted)
    return Scene(cameras, arms_of(take.capture)[0].at(frame), px[:, frame], pictures)


def test_both_hands_come_back_in_the_pixels_of_each_picture_and_are_followed_with_one_look(scene: Scene) -> None:
    every, spent = np.ones((4, 2), bool), list[tuple[int, int]]()
    found = search_hands(scene.pictures, scene.cameras, scene.arms, scene.look(every, spent))
    np.testing.assert_allclose(found[..., :2], scene.truth, atol=1e-6)
    assert (found[..., 2] == 0.9).all()
    assert len(spent) == 16
    spent.clear()
    again = search_hands(scene.pictures, scene.cameras, scene.arms, scene.look(every, spent), found)
    np.testing.assert_allclose(again[..., :2], scene.truth, atol=1e-6)
    assert len(spent) == 8
    nothing = search_hands(scene.pictures, scene.cameras, scene.arms, scene.look(~every, spent))
    assert not nothing[..., 2].any()


def test_views_are_searched_at_a_time_with_the_same_result() -> None:
    take, rng = handed_take(4, seed=1), np.random.default_rng(0)
    assert take.capture.cameras is not None
    arms = arms_of(take.capture)[0].at(2)
    pictures = {view: rng.integers(0, 256, (1080, 1920, 3), dtype=np.uint8) for view in range(2)}
    meeting, met = threading.Barrier(2, timeout=20.0), threading.Event()

    def look(crop: np.ndarray) -> HandInCrop:
        own = np.random.default_rng(int(crop.sum()))  # the answer to a crop depends on its pixels alone
        return HandInCrop(own.uniform(60, 160, (21, 2)), float(own.uniform(0.4, 1.0)))

    def look_together(crop: np.ndarray) -> HandInCrop:
        if not met.is_set():
            meeting.wait()  # two looks, or BrokenBarrierError
            met.set()
        return look(crop)

    with ThreadPoolExecutor(2) as pool:
        found = search_hands(pictures, take.capture.cameras, arms, look_together, each=pool.map)
    assert met.is_set() and found[..., 2].any()
    np.testing.assert_array_equal(found, search_hands(pictures, take.capture.cameras, arms, look))


def test_a_view_whose_own_wrist_is_elsewhere_is_looked_at_there(scene: Scene) -> None:
    """The cameras' calibration is a little off, or two views have the wrist where it is not."""
    every = np.ones((4, 2), bool)
    moved = replace(scene.arms, places=scene.arms.places + [0.0, 0.0, 0.35])
    found = search_hands(scene.pictures, scene.cameras, moved, scene.look(every, []))
    np.testing.assert_allclose(found[..., :2], scene.truth, atol=1e-6)
    unsure = replace(moved, detected=moved.detected * [1.0, 1.0, 0.2])
    assert not search_hands(scene.pictures, scene.cameras, unsure, scene.look(every, []))[..., 2].any()


def test_a_view_that_misses_a_hand_finds_it_where_two_others_have_it(scene: Scene) -> None:
    every = np.ones((4, 2), bool)
    arms = replace(scene.arms, places=scene.arms.places + [0.0, 0.0, 0.06])
    px = project(scene.cameras, arms.places)  # fmt: skip
    astray = replace(arms, detected=np.concatenate([px, np.ones((*px.shape[:-1], 1))], axis=-1))
    own, well = scene.look(every, [], 0.9), scene.look(every, [], 0.4)

    def blind(rgb: np.ndarray) -> HandInCrop:
        """View 2 needs crops that sit well."""
        return own(rgb) if placed[-1][0] != 2 else well(rgb)

    found = search_hands(scene.pictures, scene.cameras, astray, blind)
    np.testing.assert_allclose(found[..., :2], scene.truth, atol=1e-6)
    alone = {2: scene.pictures[2]}
    assert not search_hands(alone, scene.cameras, astray, blind)[..., 2].any()


@pytest.mark.parametrize(("right", "share"), [(0.9, 1.0), (0.5 * RIGHT, 0.5), (0.0, LEAST_TRUST)])
def test_a_hand_that_looks_like_one_of_the_other_side_counts_for_less(scene: Scene, right: float, share: float) -> None:
    look = scene.look(np.ones((4, 2), bool), [])
    found = search_hands(scene.pictures, scene.cameras, scene.arms, lambda crop: replace(look(crop), right=right))
    np.testing.assert_allclose(found[..., 2], 0.9 * share)


def test_a_view_that_is_not_due_does_not_look(scene: Scene) -> None:
    every, spent = np.ones((4, 2), bool), list[tuple[int, int]]()
    due = every.copy()
    due[2, 0] = False
    found = search_hands(scene.pictures, scene.cameras, scene.arms, scene.look(every, spent), None, due)
    assert (2, 0) not in spent and not found[2, 0, :, 2].any() and found[2, 1, :, 2].all()


def test_a_hand_far_from_its_wrist_is_somebody_elses(scene: Scene) -> None:
    far = replace(scene, truth=scene.truth + [90.0, 0.0])
    assert not search_hands(far.pictures, far.cameras, far.arms, far.look(np.ones((4, 2), bool), [], 3.0))[..., 2].any()


def test_a_side_whose_wrist_no_views_agree_on_is_named() -> None:
    capture = handed_take(4, seed=1).capture
    assert capture.keypoints is not None
    confidence = capture.keypoints.confidence.copy()
    confidence[1:, :, capture.keypoints.joint_set.keypoints.index("left_wrist")] = 0.0
    arms, found = arms_of(replace(capture, keypoints=replace(capture.keypoints, confidence=confidence)))
    assert [(item.code, item.where.joints) for item in found] == [("hand_not_found", ("left_wrist",))]
    assert np.isfinite(arms.places[:, :, 1]).all()
    assert not arms_of(capture)[1]


def test_a_view_that_misses_a_hand_of_two_others_looks_for_it_in_turn() -> None:
    hands = np.zeros((4, 2, 21, 3))
    hands[:3, 1, :, 2], hands[:1, 0, :, 2] = 0.9, 0.9
    due = np.stack([is_due(hands, frame, 3) for frame in range(1, 7)])
    assert due[:, :3].all() and due[:, 3, 0].all(), "hands that are there, and one that a single view has"
    assert due[:, 3, 1].tolist() == [False, True, False] * 2
    assert is_due(None, 0, 3) is None and is_due(hands, 1, 1) is None


def test_shares_count_frames_that_two_views_show() -> None:
    capture = handed_take(4, seed=1).capture
    assert capture.keypoints is not None and capture.keypoints.hands is not None
    hands = capture.keypoints.hands.copy()
    hands[..., 2] = 0.9
    hands[1:, :2, 1, :, 2] = 0.0
    assert seen_by(replace(capture, keypoints=replace(capture.keypoints, hands=hands)), 2) == {
        "left": 100.0,
        "right": 50.0,
    }


def test_pictures_of_all_views_come_together_from_where_the_take_begins(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One view begins late, one has a picture that cannot be decoded, one has no footage."""
    numbers = {"a": range(6), "b": [2, 3, 5, 6, 7]}

    def read(path: Path) -> Iterator[Picture]:
        yield from (Picture(n, 0.0, np.full((2, 2, 3), n, np.uint8)) for n in numbers[path.name])

    monkeypatch.setattr(find_hands_module, "probe", lambda path: path)
    monkeypatch.setattr(find_hands_module, "read_pictures", read)
    capture = handed_take(4, seed=1).capture
    capture = replace(capture, footage=(tmp_path / "a", tmp_path / "b", None, None), footage_first=(0, 2, 0, 0))
    found = [{view: int(rgb[0, 0, 0]) for view, rgb in pictures.items()} for _, pictures in pictures_of(capture)]
    assert found == [{0: 0, 1: 2}, {0: 1, 1: 3}, {0: 2}, {0: 3, 1: 5}]


def _hand(given: np.ndarray) -> list[np.ndarray]:
    return [np.arange(63.0), given.max(keepdims=True).reshape(1), np.zeros(1), np.zeros(63)]


@pytest.fixture
def litert(monkeypatch: pytest.MonkeyPatch) -> None:
    model = FakeModel("hand_landmark_full", (224, 224, 3), _hand, [(63,), (1,), (1,), (63,)])
    install(monkeypatch, {b"a model": model, b"with other outputs": replace(model, gives=[(1,), (63,), (1,), (63,)])})
    for content in (b"a model", b"with other outputs"):
        monkeypatch.setitem(litert_pose.HANDS, sha256(content), "hand_landmark_full")


def test_the_worker_feeds_the_model_and_reads_its_points(litert: None, tmp_path: Path) -> None:
    (tmp_path / "model.tflite").write_bytes(b"a model")
    worker = litert_pose.LiteRtHands({"model": str(tmp_path / "model.tflite")})
    assert worker.about["licence"] == "Apache-2.0"
    found = worker.detect(np.full((224, 224, 3), 255, np.uint8), 0.0)
    np.testing.assert_array_equal(found["points"][1], [3.0, 4.0])
    assert found["presence"] == [1.0] and found["right"] == [0.0]


def test_a_model_of_another_version_is_refused_by_its_hash_or_its_outputs(litert: None, tmp_path: Path) -> None:
    (tmp_path / "other.tflite").write_bytes(b"another model")
    with pytest.raises(
        Refused, match="SHA-256 of other.tflite is [0-9a-f]{64}, which is not one of hand_landmark_full"
    ):
        litert_pose.LiteRtHands({"model": str(tmp_path / "other.tflite")})
    (tmp_path / "other.tflite").write_bytes(b"with other outputs")
    with pytest.raises(Refused, match=r"have \[1, 63, 1, 63\] numbers, but the first ones must have \[63, 1, 1\]"):
        litert_pose.LiteRtHands({"model": str(tmp_path / "other.tflite")})


def test_a_missing_model_or_python_is_named(tmp_path: Path) -> None:
    with pytest.raises(DetectorMissing, match="no such model"):
        chosen_hand_detector(tmp_path / "none.tflite")
    with pytest.raises(DetectorMissing, match="no such Python"):
        chosen_hand_detector(tmp_path / "none.tflite", python=tmp_path / "python")
