"""Everybody whom two views see: each is found, and nobody's detections are another's."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.agreement.person_selection import select_people
from tests.support.crowds import COCO, Scene, add_strangers, everywhere
from tests.support.scenes import ring_of_cameras, walker
from tests.support.words import words


def whom(found, who: np.ndarray) -> list[set[int]]:
    """Return for each found person whose detections they were given."""
    views, frames = np.indices(found[0].detection.shape)
    return [set(who[views, frames, p.detection][p.detection >= 0].tolist()) for p in found]


@pytest.mark.parametrize("seed", range(6))
def test_three_who_come_and_go_are_three(seed: int) -> None:
    cameras, frames = ring_of_cameras(), 90
    scene = Scene(cameras, seed)
    for start, velocity in (((-0.8, 0.0), (0.5, 0.0)), ((0.8, 0.6), (-0.5, 0.05)), ((0.0, -1.5), (0.0, 0.2))):
        seen = everywhere(frames)
        away = int(scene.rng.integers(10, 70))
        seen[scene.rng.permutation(4)[:2], away : away + 12] = False
        scene.add(walker(COCO, frames, start, velocity), seen)
    detections, who = scene.detections()
    found = select_people(cameras, detections, 30.0)
    assert sorted(map(tuple, whom(found, who))) == [(0,), (1,), (2,)]
    assert [p.name for p in found] == ["Person 1", "Person 2", "Person 3"]
    theirs = [(p.detection >= 0).sum() for p in found]
    assert sum(theirs) > 0.97 * (who >= 0).sum()


def test_somebody_whom_no_view_sees_for_a_second_comes_back_as_the_same() -> None:
    cameras, frames = ring_of_cameras(), 120
    scene = Scene(cameras)
    hidden = everywhere(frames)
    hidden[:, 50:80] = False
    scene.add(walker(COCO, frames, (-1.0, 0.8), (0.5, 0.0)), hidden)
    scene.add(walker(COCO, frames, (1.0, -0.6), (-0.4, 0.0)), everywhere(frames))
    detections, who = scene.detections()
    found = select_people(cameras, detections, 30.0)
    assert sorted(map(tuple, whom(found, who))) == [(0,), (1,)]


def test_one_view_alone_and_a_moment_are_nobody() -> None:
    cameras, frames = ring_of_cameras(), 90
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.3, 0.0)), everywhere(frames))
    scene.add(walker(COCO, frames, (1.5, 0.5), (0.0, 0.2)), everywhere(frames, (1,)))
    moment = np.zeros((4, frames), bool)
    moment[:, 20:30] = True
    scene.add(walker(COCO, frames, (-1.5, 0.5), (0.0, 0.2)), moment)
    detections, who = scene.detections()
    found = select_people(cameras, detections, 30.0)
    assert whom(found, who) == [{0}]
    assert any("Other people are ignored" in note for note in words(found[0].notes))


@pytest.mark.parametrize("seed", range(3))
def test_strangers_in_the_background_of_single_views_are_nobody(seed: int) -> None:
    cameras, frames = ring_of_cameras(), 90
    scene = Scene(cameras, seed)
    scene.add(walker(COCO, frames, (-0.6, 0.0), (0.3, 0.1)), everywhere(frames))
    scene.add(walker(COCO, frames, (0.6, 0.9), (-0.3, 0.1)), everywhere(frames, (1, 2)))
    add_strangers(scene, frames, 2)
    detections, who = scene.detections()
    assert whom(select_people(cameras, detections, 30.0), who) == [{0}, {1}]
