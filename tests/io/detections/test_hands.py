"""Hands as detectors write them come back by side, person and point, and stay with their person."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.agreement.reading import PictureReading, Reading
from solver_backend.agreement.repeated_frames import without_repeats
from solver_backend.agreement.starts import align_rows
from solver_backend.agreement.synchronisation import synchronised
from solver_backend.agreement.view_faults import without_faults
from solver_backend.exchange.errors import KeypointCountMismatch, NoDetections, NonFiniteData
from solver_backend.exchange.joint_sets import HAND_POINTS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.recognition.confidence import in_pixels
from solver_backend.types import Capture, Detections, JointSet, Keypoints2D, PersonInViews
from tests.support.scenes import detected, ring_of_cameras, small_capture, walker
from tests.support.trial_files import write_trial

CAMERAS, FRAMES = ("cam01", "cam02", "cam03"), 4
SIZE = np.array([1920, 1080])  # Width and height of the images in pixels.
RNG = np.random.default_rng(5)


def _points(*shape: int) -> np.ndarray:
    """Return (..., 3) pixels and confidences."""
    return np.concatenate([RNG.uniform(1, 900, (*shape, 2)), RNG.uniform(0.3, 0.9, (*shape, 1))], axis=-1).round(3)


BODY, FACE, HANDS = _points(3, FRAMES, 33), _points(3, FRAMES, 70), _points(3, FRAMES, 2, 21)


def openpose(c: int, f: int) -> list[dict[str, Any]]:
    left, right = HANDS[c, f].reshape(2, -1).tolist()
    return [
        {"pose_keypoints_2d": BODY[c, f, :25].ravel().tolist(), "face_keypoints_2d": FACE[c, f].ravel().tolist(),
         "hand_left_keypoints_2d": left, "hand_right_keypoints_2d": right},
    ]  # fmt: skip


def old_openpose(c: int, f: int) -> list[dict[str, Any]]:
    left, right = HANDS[c, f].reshape(2, -1).tolist()
    body = BODY[c, f, :25].ravel().tolist()
    return [{"pose_keypoints": body, "hand_left_keypoints": left, "hand_right_keypoints": right}]


def whole_body(c: int, f: int) -> list[dict[str, Any]]:
    columns = [BODY[c, f, :23], FACE[c, f, :68], *HANDS[c, f]]
    return [{"pose_keypoints_2d": np.concatenate(columns).ravel().tolist()}]


def halpe(c: int, f: int) -> list[dict[str, Any]]:
    columns = [BODY[c, f, :26], FACE[c, f, :68], *HANDS[c, f]]
    return [{"pose_keypoints_2d": np.concatenate(columns).ravel().tolist()}]


def write(root: Path, people: Callable[[int, int], list[dict[str, Any]]]) -> None:
    for c, name in enumerate(CAMERAS):
        folder = root / "pose" / f"{name}_json"
        folder.mkdir(parents=True)
        for f in range(FRAMES):
            (folder / f"{f:06d}.json").write_text(json.dumps({"people": people(c, f)}))


def read(root: Path) -> Detections:
    return read_detections(camera_sources(root))


def read_hands(root: Path) -> np.ndarray:
    hands = read(root).hands
    assert hands is not None
    return hands


@pytest.mark.parametrize(("corner", "scale"), [(0.0, SIZE), (-1.0, SIZE / 2)], ids=["from the corner", "centred"])
def test_hands_in_fractions_of_the_image_become_pixels(corner: float, scale: np.ndarray, tmp_path: Path) -> None:
    def people(c: int, f: int) -> list[dict[str, Any]]:
        flat = [np.concatenate([p[..., :2] / scale + corner, p[..., 2:]], -1) for p in (BODY[c, f, :25], *HANDS[c, f])]
        names = ("pose_keypoints_2d", "hand_left_keypoints_2d", "hand_right_keypoints_2d")
        return [{name: points.ravel().tolist() for name, points in zip(names, flat, strict=True)}]

    write(tmp_path / "take", people)
    found = in_pixels(read(tmp_path / "take"), np.tile(SIZE, (len(CAMERAS), 1)))
    np.testing.assert_allclose(found.xy[:, :, 0], BODY[..., :25, :2], atol=1e-3)
    np.testing.assert_allclose(found.hands[:, :, 0], HANDS, atol=1e-3)


@pytest.mark.parametrize("people", [openpose, old_openpose, whole_body, halpe], ids=lambda people: people.__name__)
def test_both_hands_come_back(people: Callable[[int, int], list[dict[str, Any]]], tmp_path: Path) -> None:
    write(tmp_path / "take", people)
    hands = read_hands(tmp_path / "take")
    assert hands.shape == (3, FRAMES, 1, 2, len(HAND_POINTS), 3)
    np.testing.assert_allclose(hands[:, :, 0], HANDS, rtol=1e-6)


def test_easymocap_lists_hands_beside_its_bodies(tmp_path: Path) -> None:
    for c, name in enumerate(CAMERAS):
        folder = tmp_path / "take" / "annots" / name
        folder.mkdir(parents=True)
        for f in range(FRAMES):
            left, right = HANDS[c, f].tolist()
            person = {"personID": 0, "keypoints": BODY[c, f, :25].tolist(), "handl2d": left, "handr2d": right}
            (folder / f"{f:06d}.json").write_text(json.dumps({"annots": [person], "height": 1080}))
    np.testing.assert_allclose(read_hands(tmp_path / "take")[:, :, 0], HANDS, rtol=1e-6)


def test_freemocap_writes_the_right_hand_first(tmp_path: Path) -> None:
    folder = tmp_path / "take" / "output_data" / "raw_data"
    folder.mkdir(parents=True)
    array = np.full((3, FRAMES, 553, 2), np.nan)
    array[:, :, :33] = BODY[..., :2]
    array[:, :, 33:54], array[:, :, 54:75] = HANDS[:, :, 1, :, :2], HANDS[:, :, 0, :, :2]
    array[1, 2, 54:75] = np.nan
    np.save(folder / "mediapipe2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy", array)
    hands, expected = read_hands(tmp_path / "take")[:, :, 0], HANDS[..., :2].copy()
    expected[1, 2, 0] = np.nan
    np.testing.assert_allclose(hands[..., :2], expected, rtol=1e-6)
    assert not hands[1, 2, 0, :, 2].any()
    assert (hands[1, 2, 1, :, 2] == 1).all()


def test_a_hand_that_was_not_found_is_unseen(tmp_path: Path) -> None:
    def people(c: int, f: int) -> list[dict[str, Any]]:
        found = openpose(c, f)
        if f == 1:
            found[0]["hand_left_keypoints_2d"] = [0.0] * 63
        if f == 2:
            found[0] |= {"hand_left_keypoints_2d": [], "hand_right_keypoints_2d": []}
        return [{}, *found] if f == 3 else found

    write(tmp_path / "take", people)
    hands = read_hands(tmp_path / "take")[:, :, 0]
    assert np.isnan(hands[:, 1, 0, :, :2]).all()
    assert not hands[:, 1, 0, :, 2].any()
    assert not hands[:, 2, ..., 2].any()
    np.testing.assert_allclose(hands[:, 3], HANDS[:, 3], rtol=1e-6)


@pytest.mark.parametrize("form", ["logarithms", "percent"])
def test_scores_of_hands_beside_bodies_have_their_own_scale(form: str, tmp_path: Path) -> None:
    def people(c: int, f: int) -> list[dict[str, Any]]:
        found, hands = openpose(c, f), HANDS[c, f].copy()
        hands[..., 2] = np.log(hands[..., 2]) if form == "logarithms" else 100 * hands[..., 2]
        left, right = hands.reshape(2, -1).tolist()
        return [{**found[0], "hand_left_keypoints_2d": left, "hand_right_keypoints_2d": right}]

    write(tmp_path / "take", people)
    found = read(tmp_path / "take")
    assert found.hands is not None
    np.testing.assert_allclose(found.hands[:, :, 0], HANDS, rtol=1e-5)
    reported = [item.values["how"] for item in found.problems if item.code == "confidence_rescaled"]
    assert reported == (["percent"] if form == "percent" else [])


def test_people_of_arrays_are_seen_by_logarithms_and_not_by_minus_one() -> None:
    points = np.ones((2, 2, 17, 3))
    points[..., 2] = np.log(0.5)
    points[1, 1, :, 2] = -1.0
    frames = CameraFrames.of_array(points, Path("take.npy"))
    assert [len(frames.people(row)) for row in range(2)] == [2, 1]


def test_detections_without_hands_have_none(tmp_path: Path) -> None:
    write(tmp_path / "take", lambda c, f: [{"pose_keypoints_2d": BODY[c, f, :25].ravel().tolist()}])
    assert read(tmp_path / "take").hands is None


def test_a_hand_of_another_number_of_points_is_named(tmp_path: Path) -> None:
    write(tmp_path / "take", lambda c, f: [openpose(c, f)[0] | {"hand_left_keypoints_2d": [1.0] * 60}])
    with pytest.raises(
        KeypointCountMismatch, match=r"'hand_left_keypoints_2d' contains 20 points, but a hand has 21"
    ) as error:
        read(tmp_path / "take")
    assert "000000.json" in error.value.where


@pytest.mark.parametrize("count", [21, 42])
def test_points_of_hands_alone_are_called_so(tmp_path: Path, count: int) -> None:
    alone = [{"pose_keypoints_2d": np.concatenate(HANDS[0, 0])[:count].ravel().tolist()}]
    write(tmp_path / "take", lambda c, f: alone)
    with pytest.raises(KeypointCountMismatch, match=f"{count} keypoints per person: hand points, without a body"):
        read(tmp_path / "take")


def test_hands_beside_an_empty_body_are_called_so(tmp_path: Path) -> None:
    def people(c: int, f: int) -> list[dict[str, Any]]:
        return [{**openpose(c, f)[0], "pose_keypoints_2d": []}]

    write(tmp_path / "take", people)
    with pytest.raises(NoDetections, match="All lists of people are empty.*Hands cannot be solved without a body"):
        read(tmp_path / "take")


def test_hands_stay_with_their_person(tmp_path: Path) -> None:
    cameras = ring_of_cameras(3)
    near = detected(cameras, walker(JointSet.BODY_25, 12, (-0.5, 0.0), (0.4, 0.1)), np.random.default_rng(0))
    far = detected(cameras, walker(JointSet.BODY_25, 12, (1.0, 0.8), (0.0, 0.0)), np.random.default_rng(1))
    write_trial(tmp_path, cameras=cameras, people=[near, far], names=CAMERAS, calibrated=CAMERAS)
    for c, name in enumerate(CAMERAS):
        for f in range(12):
            path = next((tmp_path / "pose" / f"{name}_json").glob(f"*_{f:012d}_keypoints.json"))
            document = json.loads(path.read_text())
            for p, entry in enumerate(document["people"]):
                entry["hand_left_keypoints_2d"] = [100.0 * (p + 1) + c, 7.0 + f, 0.5] * 21
            document["people"] = document["people"][:: (-1) ** f]  # who comes first changes from frame to frame
            path.write_text(json.dumps(document))
    capture = load_capture(tmp_path, as_calibrated=True)
    assert isinstance(capture, Capture)
    assert len(capture.people) == 2
    for person in capture.people:
        hands = person.keypoints.hands
        assert hands is not None
        seen = (hands[:, :, 0, :, 2] > 0).all(-1)
        whose = np.round(hands[..., 0, 0, 0] - np.arange(3)[:, None])
        assert seen.mean() > 0.9
        assert len(np.unique(whose[seen])) == 1
        np.testing.assert_array_equal(hands[..., 0, 0, 1][seen], np.broadcast_to(7.0 + np.arange(12), (3, 12))[seen])
        assert not (hands[:, :, 1, :, 2] > 0).any()


def with_hands(capture: Capture) -> tuple[Capture, Keypoints2D]:
    keypoints = capture.keypoints
    assert keypoints is not None
    hands = _points(*keypoints.xy.shape[:2], 2, 21).astype(np.float32)
    hands[0, 0, 1] = np.nan
    keypoints = replace(keypoints, hands=hands)
    return replace(capture, keypoints=keypoints), keypoints


def test_a_capture_file_holds_hands(tmp_path: Path) -> None:
    capture, keypoints = with_hands(small_capture(5))
    other = replace(keypoints, hands=None)
    people = (PersonInViews("Ann", keypoints), PersonInViews("Ben", other))
    back = read_capture(write_capture(tmp_path / "c.npz", replace(capture, people=people, person="Ann")))
    assert back.keypoints is not None
    np.testing.assert_array_equal(back.keypoints.hands, keypoints.hands)
    np.testing.assert_array_equal(back.people[0].keypoints.hands, keypoints.hands)
    assert not (np.nan_to_num(back.people[1].keypoints.hands) > 0).any()
    plain = read_capture(write_capture(tmp_path / "plain.npz", small_capture(5)))
    assert plain.keypoints is not None
    assert plain.keypoints.hands is None


def test_views_and_frames_take_their_hands_along() -> None:
    capture, keypoints = with_hands(small_capture(5))
    assert keypoints.hands is not None
    np.testing.assert_array_equal(keypoints.frames(1, 3).hands, keypoints.hands[:, 1:3])
    part = capture.views([1]).keypoints
    assert part is not None
    np.testing.assert_array_equal(part.hands, keypoints.hands[[1]])


def test_what_undoes_a_views_fault_undoes_it_in_the_hands() -> None:
    capture, keypoints = with_hands(small_capture(5))
    cameras, hands = capture.cameras, keypoints.hands
    assert cameras is not None and hands is not None
    written, at = Reading.as_written(len(cameras)), slice(0, 5)
    flipped = written.with_view(1, pictures=PictureReading(mirrored=True), sides=True)
    mirrored = without_faults(cameras, keypoints, flipped, at).hands
    assert mirrored is not None
    np.testing.assert_allclose(mirrored[1, :, 0, :, 0], cameras.image_size[1, 0] - 1 - hands[1, :, 1, :, 0])
    np.testing.assert_array_equal(mirrored[0], hands[0])
    owners = (1, 0, *range(2, len(cameras)))
    exchanged = without_faults(cameras, keypoints, replace(written, owners=owners), at).hands
    assert exchanged is not None
    np.testing.assert_array_equal(exchanged[[0, 1]], hands[[1, 0]])
    R = exp_so3(np.array([0.0, 0.1, 0.0]))
    pose = (*(R @ cameras.R[1]).ravel().tolist(), *(R @ cameras.t[1]).tolist())
    hand_as_body = replace(keypoints, xy=np.tile(hands[:, :, 0, :1, :2], (1, 1, keypoints.xy.shape[2], 1)))
    seen = replace(hand_as_body, confidence=np.ones(keypoints.xy.shape[:3]))
    turned = without_faults(cameras, seen, written.with_view(1, moved=pose), at)
    assert turned.hands is not None
    np.testing.assert_allclose(turned.hands[1, :, 0, 0, :2], turned.xy[1, :, 0])
    assert np.abs(turned.hands[1, :, 0, 0, 0] - hands[1, :, 0, 0, 0]).min() > 10


def test_hands_move_in_time_with_their_view() -> None:
    keypoints = with_hands(small_capture(5))[1]
    hands = keypoints.hands
    assert hands is not None
    late = synchronised(keypoints, np.array([0.0, 1.0, *[0.0] * (keypoints.num_views - 2)])).hands
    assert late is not None
    np.testing.assert_array_equal(late[1, :4], hands[1, 1:])
    np.testing.assert_array_equal(late[0], hands[0])
    repeated = np.zeros(keypoints.xy.shape[:2], bool)
    repeated[1, 2] = True
    bridged = without_repeats(keypoints, repeated).hands
    assert bridged is not None
    assert not bridged[1, 2, ..., 2].any()
    detections = Detections(
        ("a", "b"),
        keypoints.xy[:2, :, None],
        keypoints.confidence[:2, :, None],
        keypoints.joint_set,
        hands[:2, :, None],
    )
    aligned = align_rows(detections, np.array([0, 2]), 0, 4).hands
    assert aligned is not None
    np.testing.assert_array_equal(aligned[1, :3, 0], hands[1, 2:])
    assert not aligned[1, 3, ..., 2].any()


def test_impossible_hands_are_refused() -> None:
    _, keypoints = with_hands(small_capture(5))
    assert keypoints.hands is not None
    with pytest.raises(KeypointCountMismatch, match="The hands have the shape"):
        replace(keypoints, hands=keypoints.hands[:, :, :1])
    infinite = keypoints.hands.copy()
    infinite[1, 2, 1, 4, 0] = np.inf
    with pytest.raises(NonFiniteData, match="infinite") as error:
        replace(keypoints, hands=infinite)
    assert error.value.where == "view 1, frame 2, right thumb_tip"
