"""Which feet stand: found in a made-up walk, held by the solver's data term."""

import numpy as np

from solver_backend.fitters.person_shape import find_contacts
from solver_backend.residuals.positions import SIGMA_M

NAMES = ("nose", "left_big_toe", "left_heel", "right_big_toe")
FPS, FRAMES = 60.0, 120


def walk(noise_m: float = 0.0) -> np.ndarray:
    """The left foot stands in frames 0-49 and 80-119 and swings between; the right toe glides at 0.5 m/s."""
    points = np.zeros((FRAMES, 4, 3))
    points[:, 0, 2] = 1.6
    swing = np.clip((np.arange(FRAMES) - 50) / 30.0, 0, 1)
    for column, ahead in ((1, 0.2), (2, 0.0)):
        points[:, column, 0] = ahead + 0.8 * swing
        points[:, column, 2] = 0.03 + 0.15 * np.sin(np.pi * swing)
    points[:, 3, 1] = 0.5 * np.arange(FRAMES) / FPS
    return points + noise_m * np.random.default_rng(0).normal(size=points.shape)


def test_stands_are_found_and_glides_are_not():
    contacts = find_contacts(walk(), NAMES, FPS)
    for column in (1, 2):
        assert contacts.planted[2:47, column].all() and contacts.planted[84:118, column].all()
        assert not contacts.planted[54:76, column].any()
    assert not contacts.planted[:, [0, 3]].any()
    np.testing.assert_array_equal(contacts.feet(NAMES)[60], [False, False])
    np.testing.assert_array_equal(contacts.feet(NAMES)[20], [True, False])
    np.testing.assert_allclose(contacts.anchors[10, 1, :2], [0.2, 0.0], atol=0.01)


def test_a_single_camera_forgives_what_it_does_not_see():
    """A drift of 0.4 m/s is a stand along its line of sight, and none across."""
    points, sight = walk(), np.tile([0.0, 1.0, 0.0], (FRAMES, 1))
    points[:, 3, 1] *= 0.8
    assert not find_contacts(points, NAMES, FPS).planted[:, 3].any()
    assert find_contacts(points, NAMES, FPS, sight=sight).planted[3:-3, 3].all()
    assert not find_contacts(points, NAMES, FPS, sight=sight[:, [1, 0, 2]]).planted[:, 3].any()


def test_a_touch_is_no_stand_and_few_frames_are_none():
    points = walk()
    assert not find_contacts(points[:6], NAMES, FPS).planted.any()
    assert not find_contacts(points[:2], NAMES, FPS).planted.any()
    footless = ("nose", "neck", "left_hip", "right_hip")
    contacts = find_contacts(points, footless, FPS)
    assert not contacts.planted.any() and contacts.feet(footless) is None


def test_planted_points_are_pulled_to_their_anchors_and_others_left_alone():
    points = walk()
    contacts = find_contacts(points, NAMES, FPS)
    term = contacts.term(points)
    moved = points + [0.004, 0.0, 0.0]
    evidence = term(moved, 3.0)
    assert (evidence.gradient[20, 1:3, 0] > 0).all()
    np.testing.assert_array_equal(evidence.gradient[:, [0, 3]], 0.0)
    step, direction = 1e-7, np.random.default_rng(1).normal(size=points.shape)
    numeric = (term(moved + step * direction, 3.0).cost - term(moved - step * direction, 3.0).cost) / (2 * step)
    np.testing.assert_allclose((evidence.gradient * direction).sum((1, 2)), numeric, atol=1e-3 / SIGMA_M)


def test_a_stand_outlasts_a_twitch_and_stays_where_frames_are_fixed():
    points = walk()
    points[20:24, 1, 0] += [0.01, 0.03, 0.03, 0.01]
    points[30:50, 1, 0] += 0.02
    fixed = np.arange(FRAMES) < 15
    contacts = find_contacts(points, NAMES, FPS, fixed)
    assert contacts.planted[2:47, 1].all()
    np.testing.assert_allclose(contacts.anchors[2:47, 1, 0], 0.2, atol=1e-9)
    assert find_contacts(points, NAMES, FPS).anchors[10, 1, 0] > 0.205


def test_markers_of_the_feet_tell_contacts_too():
    places = ("LFHD", "LTOE", "LHEE", "RMT5")
    found, named = find_contacts(walk(), places, FPS), find_contacts(walk(), NAMES, FPS)
    np.testing.assert_array_equal(found.planted, named.planted)
    np.testing.assert_array_equal(found.feet(places), named.feet(NAMES))
