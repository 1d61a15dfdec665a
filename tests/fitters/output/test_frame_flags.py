"""Frames that deserve a look are flagged, and no others."""

import numpy as np

from solver_backend.fitters.build_motion import flagged
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE

FRAMES = 60
SEEN = np.ones(FRAMES, bool)


def residuals():
    return np.abs(np.random.default_rng(0).normal(size=(3, FRAMES, 25)))


def sigma():
    return np.tile(np.linspace(0.008, 0.025, 24), (FRAMES, 1))


def test_a_usual_take_has_no_flags():
    assert not flagged(residuals(), SEEN, sigma()).any()


def test_frames_that_nobody_saw_are_unseen():
    detections = residuals()
    detections[:, 10:20] = np.nan
    seen = SEEN.copy()
    seen[10:20] = False
    assert (np.flatnonzero(flagged(detections, seen, None) & FLAG_UNSEEN) == np.arange(10, 20)).all()


def test_frames_far_from_the_detections_are_unsure():
    detections = residuals()
    detections[:, 30:33] += 8.0
    assert (np.flatnonzero(flagged(detections, SEEN, sigma()) == FLAG_UNSURE) == np.arange(30, 33)).all()


def test_frames_in_which_one_joint_is_hardly_known_are_unsure():
    spread = sigma()
    spread[40:44, 20] = 0.08
    assert (np.flatnonzero(flagged(residuals(), SEEN, spread) == FLAG_UNSURE) == np.arange(40, 44)).all()


def test_a_joint_that_is_well_known_everywhere_is_not_flagged_for_being_a_little_worse():
    spread = sigma()
    spread[40:44, 0] = 0.02
    assert not flagged(residuals(), SEEN, spread).any()


def test_frames_with_a_lost_limb_are_unsure_though_their_median_is_as_usual():
    detections, lost = residuals(), np.zeros(FRAMES, bool)
    detections[:, 20:24, 7] += 40.0
    lost[20:24] = True
    assert not flagged(detections, SEEN, sigma()).any()
    assert (np.flatnonzero(flagged(detections, SEEN, sigma(), lost) == FLAG_UNSURE) == np.arange(20, 24)).all()
