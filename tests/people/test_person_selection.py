"""The person most views agree on is kept, and nobody else is ever mixed in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.simulation import bad_input
from solver_backend.agreement.person_selection import SelectedPerson, select_people
from solver_backend.agreement.person_tracks import PeopleInSpace, assigned_exclusively, persons, view_tracks
from solver_backend.agreement.reading import sightings
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import NoDetections, TooFewViews
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Detections
from tests.support.crowds import COCO, Scene, everywhere
from tests.support.scenes import ring_of_cameras, walker
from tests.support.words import words

DEMO = demo_capture()


def chosen(found: SelectedPerson, who: np.ndarray) -> np.ndarray:
    """Return (C, F) who was chosen; -1 = nobody."""
    views, frames = np.indices(found.detection.shape)
    return np.where(found.detection >= 0, who[views, frames, found.detection], -1)


@pytest.mark.parametrize("views", [(0,), (1, 2), (0, 2)])
def test_a_larger_more_certain_bystander_listed_first_is_left_out(views: tuple[int, ...]) -> None:
    cameras, frames = ring_of_cameras(), 60
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (-0.5, 0.0), (0.4, 0.1)), everywhere(frames), certainty=0.3)
    near = tuple(0.55 * cameras.centres[list(views)].mean(0)[:2])
    scene.add(walker(COCO, frames, near, (0.0, 0.1)), everywhere(frames, views), certainty=0.95)
    detections, who = scene.detections(shuffle=False)
    found = select_people(cameras, detections, 30.0)[0]
    assert (chosen(found, who) == 0).all()
    expected = np.where(scene.people[0][1] > 0, scene.people[0][1], 0.0)
    np.testing.assert_allclose(found.keypoints.confidence, expected, rtol=1e-6)
    assert "Other people are ignored" in words(found.notes)[1]
    for c in range(4):
        assert (f"{cameras.names[c]} in 60 frames" in words(found.notes)[1]) == (c in views)


@pytest.mark.parametrize("seed", range(12))
def test_nobody_is_mixed_in_however_the_detections_come_and_go(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames, cameras = 150, ring_of_cameras()
    scene = Scene(cameras, seed)
    subject = walker(COCO, frames, (-1.0, 0.0), (0.3, rng.uniform(-0.1, 0.1)))
    scene.add(subject, _with_bursts(everywhere(frames), rng))
    while len(scene.people) < 3:
        other = walker(COCO, frames, tuple(rng.uniform(-2, 2, 2)), tuple(rng.uniform(-0.3, 0.3, 2)), phase=1.0)
        if np.linalg.norm(other[:, 5, :2] - subject[:, 5, :2], axis=-1).min() > 0.7:
            scene.add(other, _with_bursts(everywhere(frames, tuple(rng.choice(4, 2, replace=False))), rng))
    detections, who = scene.detections()
    found = chosen(select_people(cameras, detections, 30.0)[0], who)
    assert set(np.unique(found)) <= {-1, 0}
    assert (found == 0).sum() > 0.95 * scene.people[0][2].sum()


def _with_bursts(seen: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    seen = seen.copy()
    for c in range(len(seen)):
        for start in rng.integers(0, seen.shape[1], 2):
            seen[c, start : start + rng.integers(5, 25)] = False
    return seen


def test_whoever_is_there_while_the_person_is_away_does_not_replace_them() -> None:
    cameras, frames = ring_of_cameras(), 120
    scene = Scene(cameras)
    present = everywhere(frames)
    present[:, 40:70] = False
    scene.add(walker(COCO, frames, (-0.5, 0.0), (0.2, 0.0)), present)
    scene.add(walker(COCO, frames, (0.9, 1.2), (0.0, 0.0)), everywhere(frames, (1, 2)))
    detections, who = scene.detections()
    found = chosen(select_people(cameras, detections, 30.0)[0], who)
    np.testing.assert_array_equal(found == 0, present)
    assert (found[:, 40:70] == -1).all()


def test_someone_who_passes_behind_an_undetected_person_is_not_taken_for_them() -> None:
    cameras, frames = ring_of_cameras(), 90
    scene = Scene(cameras)
    seen = everywhere(frames)
    seen[0, 30:60] = False
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.0, 0.0)), seen)
    away = -cameras.centres[0][:2] / np.linalg.norm(cameras.centres[0][:2])
    across = np.array([-away[1], away[0]]) * 0.8
    start = 1.2 * away - across * 1.5
    scene.add(walker(COCO, frames, (start[0], start[1]), (across[0], across[1])), everywhere(frames, (0,)))
    detections, who = scene.detections()
    found = chosen(select_people(cameras, detections, 30.0)[0], who)
    np.testing.assert_array_equal(found == 0, seen)


def test_a_person_found_in_two_pieces_is_put_together() -> None:
    cameras, frames = ring_of_cameras(), 30
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.2, 0.0)), everywhere(frames), missing=0.0)
    detections, _ = scene.detections()
    xy = np.concatenate([detections.xy, np.full_like(detections.xy, np.nan)], axis=2)
    confidence = np.concatenate([detections.confidence, np.zeros_like(detections.confidence)], axis=2)
    for c in (1, 2):
        xy[c, 10:20, 1, 11:], confidence[c, 10:20, 1, 11:] = xy[c, 10:20, 0, 11:], confidence[c, 10:20, 0, 11:]
        xy[c, 10:20, 0, 11:], confidence[c, 10:20, 0, 11:] = np.nan, 0.0
    found = select_people(cameras, Detections(cameras.names, xy, confidence, COCO), 30.0)[0]
    np.testing.assert_array_equal(found.keypoints.xy, detections.xy[:, :, 0])
    assert (found.keypoints.confidence > 0).all()


def test_a_view_with_left_and_right_swapped_is_kept() -> None:
    cameras, frames = ring_of_cameras(), 20
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.2, 0.0)), everywhere(frames), missing=0.0)
    detections, _ = scene.detections()
    mirrored = list(COCO.mirrored())
    detections.xy[1, 5:15] = detections.xy[1, 5:15][..., mirrored, :]
    found = select_people(cameras, detections, 30.0)[0]
    assert (found.detection == 0).all()


def test_two_cameras_are_enough() -> None:
    cameras, frames = ring_of_cameras(5).subset([0, 1]), 40
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.2, 0.0)), np.ones((2, frames), bool))
    detections, who = scene.detections()
    assert (chosen(select_people(cameras, detections, 30.0)[0], who) == 0).all()


def test_one_frame() -> None:
    cameras = ring_of_cameras()
    scene = Scene(cameras)
    scene.add(walker(COCO, 1, (0.0, 0.0), (0.0, 0.0)), everywhere(1))
    scene.add(walker(COCO, 1, (1.5, 0.0), (0.0, 0.0)), everywhere(1, (0, 1)))
    detections, who = scene.detections()
    assert (chosen(select_people(cameras, detections, 30.0)[0], who) == 0).all()


@pytest.mark.parametrize("still_first", [True, False])
def test_a_mannequin_is_not_the_person(still_first: bool) -> None:
    cameras, frames = ring_of_cameras(), 40
    still = np.repeat(walker(COCO, 1, (1.2, 0.0), (0.0, 0.0)), frames, axis=0)
    moving = walker(COCO, frames, (-0.5, 0.0), (0.3, 0.0))
    scene = Scene(cameras)
    for points in (still, moving) if still_first else (moving, still):
        scene.add(points, everywhere(frames), certainty=0.9 if points is still else 0.5)
    detections, who = scene.detections()
    assert (chosen(select_people(cameras, detections, 30.0)[0], who) == int(still_first)).all()


def test_few_views_for_long_count_less_than_many_for_a_while() -> None:
    cameras, frames = ring_of_cameras(), 120
    scene = Scene(cameras)
    seen = everywhere(frames)
    seen[:, 40:] = False
    scene.add(walker(COCO, frames, (-0.5, 0.0), (0.2, 0.0)), seen)
    scene.add(walker(COCO, frames, (0.9, 1.2), (0.1, 0.0)), everywhere(frames, (1, 2)))
    detections, who = scene.detections()
    np.testing.assert_array_equal(chosen(select_people(cameras, detections, 30.0)[0], who) == 0, seen)


def test_a_second_person_seen_as_well_is_named() -> None:
    cameras, frames = ring_of_cameras(), 40
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.2, 0.0)), everywhere(frames))
    scene.add(walker(COCO, frames, (1.2, 0.0), (0.0, 0.2)), everywhere(frames))
    detections, who = scene.detections()
    found = select_people(cameras, detections, 30.0)[0]
    assert len(np.unique(chosen(found, who))) == 1
    assert "Person 2 is also visible in 40 frames, in 4.0 views on average" in words(found.notes)[-1] and not words(
        found.problems
    )


def test_views_that_agree_on_nobody_are_an_error() -> None:
    cameras, frames = ring_of_cameras().subset([0, 1]), 10
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.2, 0.0)), np.ones((2, frames), bool))
    detections, _ = scene.detections()
    detections.xy[1, ..., 1] += 250
    with pytest.raises(NoDetections, match=r"No two cameras agree.*cam_a, cam_b.*calibration"):
        select_people(cameras, detections, 30.0)[0]


def test_views_of_another_calibration_are_a_problem() -> None:
    cameras, frames = ring_of_cameras(), 10
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.2, 0.0)), everywhere(frames))
    detections, _ = scene.detections()
    detections.xy[2:, ..., 1] += np.array([250, -250], np.float32)[:, None, None, None]
    found = select_people(cameras, detections, 30.0)[0]
    assert (
        "On average, 4.0 views show a person, but only 2.0 of them agree on the person's position."
        in words(found.problems)[0]
    )


def test_all_zero_confidences_and_single_views_are_errors() -> None:
    cameras, frames = ring_of_cameras(), 10
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.2, 0.0)), everywhere(frames, (2,)))
    detections, _ = scene.detections()
    with pytest.raises(TooFewViews, match="Of 4 cameras, only cam_c has detections, but two are needed"):
        select_people(cameras, detections, 30.0)[0]
    detections.confidence[:] = 0
    with pytest.raises(NoDetections, match="All confidences are zero"):
        select_people(cameras, detections, 30.0)[0]


def _in_space(frames: list[int], members: list[list[int]], places: np.ndarray) -> PeopleInSpace:
    points = np.repeat(places[:, None], 5, axis=1)
    return PeopleInSpace(np.array(frames), np.array(members), points, np.full(len(frames), 1.9))


def test_a_person_whom_one_view_follows_throughout_is_one_though_other_keypoints_come_into_the_picture() -> None:
    """A person walks to the edge of a picture twice. Its keypoints are seen from the legs up, or from the head down."""
    frames = [f for f in range(150) if f not in (50, 100)]
    people = _in_space(frames, [[0, 0]] * 148, np.array([[0.0, 0.0, 1.1 - 0.6 * (f % 50) / 49] for f in frames]))
    tracks = np.stack([np.zeros(150, int), 1 + np.arange(150) // 50])[..., None]
    found = persons(people, tracks, 60.0)
    assert [len(rows) for rows in found] == [148]


def test_a_person_whose_views_agree_in_changing_pairs_for_a_while_stays_one() -> None:
    """Three views, of which the first and the last place the person 0.6 m apart from frame 40 on."""
    groups = [
        ([0, 0, -1], 0.0) if 40 <= f < 50 and f % 2 else ([-1, 0, 0] if f >= 40 else [0, 0, 0], 0.6 * (f >= 40))
        for f in range(100)
    ]
    people = _in_space(list(range(100)), [views for views, _ in groups], np.array([[x, 0.0, 1.0] for _, x in groups]))
    found = persons(people, np.repeat(np.arange(3)[:, None], 100, axis=1)[..., None], 30.0)
    assert [len(rows) for rows in found] == [100]


def test_a_person_whom_one_view_alone_sees_is_nobody_else() -> None:
    cameras, frames = ring_of_cameras(2), 60
    scene = Scene(cameras)
    seen = np.ones((2, frames), bool)
    seen[1, 20:40] = False
    scene.add(walker(COCO, frames, (-0.5, 0.0), (0.4, 0.1)), seen)
    found = select_people(cameras, scene.detections()[0], 30.0)
    assert [note.code for note in found[0].notes] == ["person_chosen"]


def test_tracks_of_a_view_end_where_two_people_cannot_be_told_apart() -> None:
    cameras, frames = ring_of_cameras(), 20
    scene = Scene(cameras)
    scene.add(walker(COCO, frames, (0.0, 0.0), (0.1, 0.0)), everywhere(frames), missing=0.0)
    detections, _ = scene.detections()
    twice = Detections(
        cameras.names,
        np.concatenate([detections.xy, detections.xy + 2.0], axis=2),
        np.concatenate([detections.confidence, detections.confidence], axis=2),
        COCO,
    )
    alone, crowded = (view_tracks(sightings(cameras, d).xy) for d in (detections, twice))
    assert len(np.unique(alone)) == 4
    assert len(np.unique(crowded)) > 4 * frames


def test_views_that_agree_in_every_frame_win_against_rays_of_strangers_that_meet_in_some() -> None:
    """The first detections of all views are one person; a stranger in the last view is nearer to its rays at times."""
    views, frames, met = 3, 20, range(8, 12)
    tracks = np.broadcast_to(np.arange(2 * views).reshape(views, 1, 2), (views, frames, 2))
    groups = [(frame, (0, 0, 0), 2.0) for frame in range(frames)] + [(frame, (0, 0, 1), 2.5) for frame in met]
    frame, members, score = zip(*sorted(groups), strict=True)
    people = PeopleInSpace(np.array(frame), np.array(members), np.zeros((len(frame), 1, 3)), np.array(score))
    chosen = assigned_exclusively(people, tracks)
    np.testing.assert_array_equal(chosen.frame, np.arange(frames))
    np.testing.assert_array_equal(chosen.members, np.zeros((frames, views)))


def test_a_view_that_sees_one_person_elsewhere_is_kept_and_named():
    """Whether the camera or the person is wrong is told later, by what puts such views right."""
    capture = bad_input.bumped(demo_capture(num_frames=40), 1)
    cameras, keypoints = capture.require_multiview()
    everybody = Detections(
        cameras.names, keypoints.xy[:, :, None], keypoints.confidence[:, :, None], keypoints.joint_set
    )
    found = select_people(cameras, everybody, keypoints.fps)[0]
    assert found.problems == (diagnostic("camera_sees_elsewhere", cameras=["cam02"]),)
    seen = keypoints.confidence[1] > 0
    np.testing.assert_array_equal(found.keypoints.xy[1][seen], keypoints.xy[1][seen])


@pytest.mark.parametrize(
    "spoil", [lambda c: bad_input.bumped(c, 1, 5.0, 20), lambda c: bad_input.calibrations_exchanged(c, 0, 2)]
)
def test_views_of_one_person_each_are_kept_for_what_puts_cameras_right(spoil):
    wrong = spoil(demo_capture(num_frames=40))
    cameras, keypoints = wrong.require_multiview()
    everybody = Detections(
        cameras.names, keypoints.xy[:, :, None], keypoints.confidence[:, :, None], keypoints.joint_set
    )
    found = select_people(cameras, everybody, keypoints.fps)[0]
    np.testing.assert_array_equal(found.keypoints.confidence, keypoints.confidence)


def test_people_whose_detections_are_worse_for_a_while_are_kept() -> None:
    """Accurate detections elsewhere set no smaller tolerance than the error of a hidden limb."""
    cameras, keypoints = DEMO.require_multiview()
    rng, burst = np.random.default_rng(0), np.zeros(360)
    burst[120:228] = 10.0
    people = []
    for offset in ([0.0, 0.0, 0.0], [0.8, 0.3, 0.0]):
        xy = project(cameras, DEMO.truth["keypoints3d"] + offset)
        xy = xy + rng.normal(0.0, 0.5, xy.shape)
        xy[1] += burst[:, None, None] * rng.normal(size=(1, 25, 2))
        people.append(replace(keypoints, xy=xy, confidence=np.ones(xy.shape[:-1])))
    found = select_people(cameras, Detections.of_people(cameras.names, people), 60.0)
    assert len(found) == 2
    for person in found:
        assert (person.detection >= 0).mean() > 0.99
