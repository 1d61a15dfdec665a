"""People in one camera's picture: followed by where they are, whatever their place in the files."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.person_selection import select_in_one_view
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import load_table
from solver_backend.exchange.errors import NoDetections
from solver_backend.types import Detections, JointSet
from tests.support.one_view_situations import filmed_walk
from tests.support.words import words

JOINTS = JointSet.COCO_17
FRAMES = 60


def detections(people: np.ndarray, seen: np.ndarray) -> Detections:
    """Return detections of (F, P, 17, 2) points, whose places in the files change from frame to frame."""
    rng = np.random.default_rng(0)
    order = np.stack([rng.permutation(people.shape[1]) for _ in range(len(people))])
    xy = np.take_along_axis(people, order[..., None, None], axis=1)
    there = np.take_along_axis(seen, order, axis=1)
    confidence = np.where(there[..., None], 0.9, 0.0) * np.ones(17)
    xy = np.where(there[..., None, None], xy, np.nan)
    return Detections(("cam",), xy[None].astype(np.float32), confidence[None].astype(np.float32), JOINTS)


def two_people() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    shape = rng.uniform(-1, 1, (17, 2))
    time = np.linspace(0, 1, FRAMES)[:, None, None]
    large = 150 * shape + [400.0, 300.0] + time * [300.0, 0.0]
    small = 60 * shape[::-1] + [900.0, 250.0] - time * [100.0, 0.0]
    return np.stack([large, small], axis=1), np.ones((FRAMES, 2), dtype=bool)


def test_the_largest_for_longest_comes_first_and_nobody_is_mixed_up() -> None:
    people, seen = two_people()
    seen[20:25, 0] = False
    first, second = select_in_one_view(detections(people, seen), 30.0)
    found = first.keypoints
    assert (found.confidence[0].any(axis=-1) == seen[:, 0]).all()
    np.testing.assert_allclose(found.xy[0][seen[:, 0]], people[seen[:, 0], 0], atol=1e-3)
    np.testing.assert_allclose(second.keypoints.xy[0], people[:, 1], atol=1e-3)
    assert first.notes[0].values == {"basis": "largest", "seen": 55, "of": 60} and first.notes[1].values == {
        "count": 1,
        "solvable": 1,
    }
    assert "(55 of 60 frames)" in words(first.notes)[0] and not second.notes


def test_small_people_in_the_background_leave_a_large_one_whole() -> None:
    people, _ = two_people()
    near = 300 * (people[:, 0] - people[:, 0].mean(axis=1, keepdims=True)) / 150 + [300.0, 500.0]
    near += np.arange(FRAMES)[:, None, None] * [12.0, 0.0]
    small = people[:, 1] - people[:, 1].mean(axis=1, keepdims=True)
    crowd = [0.5 * small + [100.0 + 250 * k, 300.0] for k in range(6)]
    largest = select_in_one_view(detections(np.stack([near, *crowd], axis=1), np.ones((FRAMES, 7), bool)), 30.0)[0]
    np.testing.assert_allclose(largest.keypoints.xy[0], near, atol=1e-3)


def test_hands_stay_with_their_person() -> None:
    people, seen = two_people()
    seen[20:25, 0] = False
    found = detections(people, seen)
    hands = np.ones((1, FRAMES, 2, 2, 21, 3), np.float32)
    hands[..., :2] = found.xy[:, :, :, 9:11, None]  # each hand where its wrist is
    first, second = select_in_one_view(replace(found, hands=hands), 30.0)
    assert select_in_one_view(found, 30.0)[0].keypoints.hands is None
    for person, there in ((first.keypoints, seen[:, 0]), (second.keypoints, seen[:, 1])):
        assert person.hands is not None and np.isnan(person.hands[0, ~there, ..., :2]).all()
        assert not person.hands[0, ~there, ..., 2].any()
        wrists = np.repeat(person.xy[0, there, 9:11, None], 21, axis=2)
        np.testing.assert_allclose(person.hands[0, there, ..., :2], wrists, atol=1e-3)


def test_who_is_gone_for_long_is_somebody_new() -> None:
    people, seen = two_people()
    seen[:, 1] = False
    seen[20:45, 0] = False
    found = select_in_one_view(detections(people, seen), 30.0)
    assert len(found) == 2
    assert [int((p.keypoints.confidence[0] > 0).any(-1).sum()) for p in found] == [20, 15]


def test_a_mirror_on_the_wall_is_another_track_and_not_mixed_up_with_the_person() -> None:
    capture = filmed_walk(90)
    cameras, rng = capture.require_views()[0], np.random.default_rng(3)
    names = capture.require_views()[1].joint_set.keypoints
    points = capture.truth["keypoints3d"][:, [names.index(name) for name in JOINTS.keypoints]]
    normal = np.array([*cameras.R[0, 2, :2], 0.0]) / np.linalg.norm(cameras.R[0, 2, :2])
    wall = float((points @ normal).max()) + 0.5
    behind = points + (2.0 * (wall - points @ normal))[..., None] * normal
    both = np.stack([points, behind[:, list(JOINTS.mirrored())]], axis=1)
    people = project(cameras, both)[0]
    people += 3.0 * rng.normal(size=people.shape)
    found = select_in_one_view(detections(people, np.ones(people.shape[:2], dtype=bool)), 30.0)
    for number, person in enumerate(found):
        np.testing.assert_allclose(person.keypoints.xy[0], people[:, number], atol=1e-3)
    assert "reflection" in load_table()["other_tracks"].cause and found[0].notes[1].values == {
        "count": 1,
        "solvable": 1,
    }


def test_nobody_is_an_error() -> None:
    people, seen = two_people()
    with pytest.raises(NoDetections):
        select_in_one_view(detections(people, seen & False), 30.0)
