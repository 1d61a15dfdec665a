"""Hands are sorted by the wrists they lie at."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import Remedy
from solver_backend.fitters.hands.measured_hands import sort_hands
from solver_backend.fitters.hands.shown_hands import HandViews
from tests.support.scenes import ring_of_cameras

CAMERAS = ring_of_cameras(3)
FRAMES = 12
WRISTS = np.tile([[[0.4, 0.0, 1.0], [-0.4, 0.1, 1.1]]], (FRAMES, 1, 1))
ELBOWS = WRISTS + [0.0, 0.0, 0.25]


def hands_at(places: np.ndarray) -> HandViews:
    px = project(CAMERAS, places)
    xy = px[:, :, :, None] + np.arange(21)[:, None] * [1.0, 0.5]
    return HandViews(CAMERAS, xy, np.ones(xy.shape[:-1]))


def exchanged(views: HandViews, view: int, frames: slice) -> HandViews:
    xy = views.xy.copy()
    xy[view, frames] = xy[view, frames, ::-1]
    return HandViews(CAMERAS, xy, views.confidence)


def test_hands_at_their_wrists_stay() -> None:
    views = hands_at(WRISTS)
    found = sort_hands(views, WRISTS, ELBOWS)
    np.testing.assert_array_equal(found.views.xy, views.xy)
    np.testing.assert_array_equal(found.views.confidence, views.confidence)
    assert not found.diagnostics


def test_exchanged_hands_are_exchanged_back_and_named() -> None:
    right = hands_at(WRISTS)
    found = sort_hands(exchanged(right, 1, slice(3, 8)), WRISTS, ELBOWS)
    np.testing.assert_array_equal(found.views.xy, right.xy)
    (item,) = found.diagnostics
    assert (item.code, item.where.frames, item.remedy) == ("hands_exchanged", ((3, 7),), Remedy.REPAIRED)
    assert item.where.cameras == (CAMERAS.names[1],)


def test_one_hand_alone_goes_to_the_wrist_it_lies_at() -> None:
    views = hands_at(WRISTS)
    confidence = views.confidence.copy()
    confidence[:, :, 1] = 0.0
    wrong = exchanged(HandViews(CAMERAS, views.xy, confidence), 0, slice(0, FRAMES))
    wrong.confidence[0] = wrong.confidence[0, :, ::-1]
    found = sort_hands(wrong, WRISTS, ELBOWS).views
    np.testing.assert_array_equal(found.confidence[..., 0] > 0, np.broadcast_to([True, False], (3, FRAMES, 2)))
    np.testing.assert_array_equal(found.xy[0, :, 0], views.xy[0, :, 0])


def test_a_hand_at_neither_wrist_is_left_out() -> None:
    views = hands_at(np.concatenate([WRISTS[:, :1], WRISTS[:, 1:] + [0.0, 0.0, 0.7]], axis=1))
    found = sort_hands(views, WRISTS, ELBOWS)
    assert not found.views.confidence[:, :, 1].any()
    assert found.views.confidence[:, :, 0].all()
    assert {item.code for item in found.diagnostics} == {"hand_elsewhere"}


def test_clapping_hands_keep_their_names() -> None:
    """Both lie at both wrists: nothing tells them apart, and nothing is exchanged."""
    together = WRISTS.copy()
    together[:, 1] = together[:, 0] + [-0.03, 0.0, 0.0]
    views = hands_at(together)
    found = sort_hands(exchanged(views, 2, slice(0, FRAMES)), together, together + [0.0, 0.0, 0.25])
    assert not [item for item in found.diagnostics if item.code == "hands_exchanged"]


def test_a_right_hand_that_every_view_names_left_stays_right_where_hands_meet() -> None:
    """The left hand is unseen. In the middle of the take it is beside the right one, and nothing shows a side."""
    wrists = WRISTS.copy()
    wrists[4:8, 0] = wrists[4:8, 1] + [0.05, 0.0, 0.0]
    right = hands_at(wrists)
    confidence = right.confidence.copy()
    confidence[:, :, 0] = 0.0
    swapped = HandViews(CAMERAS, right.xy[:, :, ::-1].copy(), confidence[:, :, ::-1].copy())
    found = sort_hands(swapped, wrists, wrists + [0.0, 0.0, 0.25])
    assert not found.views.confidence[:, :, 0].any(), "the unseen left hand has no detections"
    np.testing.assert_array_equal(found.views.xy[:, :, 1], right.xy[:, :, 1])
    assert {item.where.frames for item in found.diagnostics} == {((0, FRAMES - 1),)}


def test_a_name_that_changes_where_hands_meet_is_left_alone() -> None:
    wrists = WRISTS.copy()
    wrists[4:8, 0] = wrists[4:8, 1] + [0.05, 0.0, 0.0]
    views = hands_at(wrists)
    found = sort_hands(exchanged(views, 1, slice(0, 6)), wrists, wrists + [0.0, 0.0, 0.25])
    (item,) = found.diagnostics
    assert item.where.frames == ((0, 3),)


def test_one_clear_frame_does_not_name_hands_that_meet_at_an_end_of_the_take() -> None:
    wrists = WRISTS.copy()
    wrists[:, 0] = wrists[:, 1] + [0.05, 0.0, 0.0]
    wrists[5] = WRISTS[5]
    views = hands_at(wrists)
    found = sort_hands(exchanged(views, 1, slice(5, 6)), wrists, wrists + [0.0, 0.0, 0.25])
    np.testing.assert_array_equal(found.views.xy, views.xy)
    assert not [item for item in found.diagnostics if item.code == "hands_exchanged"]


def test_frames_without_hands_are_not_named_as_exchanged() -> None:
    swapped = exchanged(hands_at(WRISTS), 1, slice(0, FRAMES))
    swapped.confidence[1, 4:8] = 0.0
    (item,) = sort_hands(swapped, WRISTS, ELBOWS).diagnostics
    assert item.where.frames == ((0, 3), (8, FRAMES - 1))


def test_two_wrong_frames_do_not_decide_about_hands_that_meet_between_them() -> None:
    wrists = WRISTS.copy()
    wrists[1:-1, 0] = wrists[1:-1, 1] + [0.05, 0.0, 0.0]
    right = hands_at(wrists)
    wrong = exchanged(exchanged(right, 1, slice(0, 1)), 1, slice(FRAMES - 1, FRAMES))
    found = sort_hands(wrong, wrists, wrists + [0.0, 0.0, 0.25])
    np.testing.assert_array_equal(found.views.xy, right.xy)
