"""Variances by landmark and stretch of time: known noise is found again, and outliers teach nothing."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.person_shape import LANDMARK_RANGE as RANGE
from solver_backend.fitters.person_shape import with_window_variances
from solver_backend.residuals.positions import PositionTerm

FRAMES, FPS, SIGMA = 120, 60.0, 0.01
Person = tuple[Subject, PosedFrames, np.ndarray]
FIRST, LAST = slice(0, 30), slice(90, 120)


@pytest.fixture(scope="module")
def person() -> Person:
    body = load_body()
    subject = Subject.average(body, marker_landmarks(body, marker_layout("MANIFOLD_53")), np.zeros(1))
    eye = np.eye(3)
    frames = PosedFrames(np.tile(eye, (FRAMES, 1, 1)), np.tile(eye, (FRAMES, 21, 1, 1)), np.zeros((FRAMES, 3)))
    return subject, frames, np.asarray(pose(subject, frames).points)


def learned(person: Person, sigma: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return the (F, L) variances learned from noise of these standard deviations, in first variances."""
    subject, frames, points = person
    noisy = points + sigma[..., None] * np.random.default_rng(seed).normal(size=points.shape)
    term = PositionTerm(noisy, np.full(points.shape[:2], SIGMA**-2))
    return term.weight / weights(term, subject, frames, 0.0)


def weights(term: PositionTerm, subject: Subject, frames: PosedFrames, dof: float) -> np.ndarray:
    found = with_window_variances(term, pose(subject, frames).points, FPS, 4.0, dof)
    assert isinstance(found, PositionTerm)
    return found.weight


def test_a_stretch_in_which_nobody_is_seen_is_as_the_rest(person: Person) -> None:
    subject, frames, points = person
    noisy = points + SIGMA * np.random.default_rng(0).normal(size=points.shape)
    term, seen = PositionTerm(noisy, np.full(points.shape[:2], SIGMA**-2)), np.ones(FRAMES, dtype=bool)
    seen[30:60] = False  # the second of four stretches
    found = with_window_variances(term, pose(subject, frames).points[seen], FPS, 4.0, 0.0, seen)
    assert isinstance(found, PositionTerm)
    variance = term.weight / found.weight
    assert variance.shape == (FRAMES, 53)
    assert variance[30:60].mean() == pytest.approx(1.0, abs=0.06)
    np.testing.assert_allclose(variance[30:60], np.broadcast_to(variance[30], (30, 53)))


def test_a_landmark_that_errs_in_one_stretch_is_trusted_less_there_alone(person: Person) -> None:
    sigma = np.full((FRAMES, 53), SIGMA)
    sigma[LAST, 7] = 2.0 * SIGMA
    found = learned(person, sigma)
    assert found[LAST, 7].mean() > 2.2
    assert found[FIRST, 7].mean() < 1.6
    others = np.delete(found, 7, axis=1)
    assert others.mean() == pytest.approx(1.0, abs=0.06)


def test_a_landmark_that_always_errs_is_found_to(person: Person) -> None:
    sigma = np.full((FRAMES, 53), SIGMA)
    sigma[:, 3] = 1.3 * SIGMA
    found = learned(person, sigma)
    assert found[:, 3].mean() == pytest.approx(1.3**2, rel=0.15)
    assert np.delete(found, 3, axis=1).mean() == pytest.approx(1.0, abs=0.06)


def test_a_level_above_the_first_is_believed_and_one_below_is_not(person: Person) -> None:
    loud, quiet = (learned(person, np.full((FRAMES, 53), factor * SIGMA)) for factor in (1.25, 0.1))
    assert loud.mean() == pytest.approx(1.25**2, rel=0.08)
    assert np.median(quiet) == pytest.approx(1.0, rel=0.05)


def test_outliers_teach_nothing_and_variances_stay_in_their_range(person: Person) -> None:
    sigma = np.full((FRAMES, 53), SIGMA)
    sigma[:, 11] = 50.0 * SIGMA
    found = learned(person, sigma)
    assert RANGE[0] <= found.min() and found.max() <= RANGE[1]
    assert np.delete(found, 11, axis=1).max() < 2.5


def test_what_was_not_measured_changes_nothing(person: Person) -> None:
    subject, frames, points = person
    weight = np.full(points.shape[:2], SIGMA**-2)
    weight[:, 20:25] = 0.0
    off = points + 0.005
    terms = [PositionTerm(np.where(weight[..., None] > 0, off, elsewhere), weight) for elsewhere in (0.0, 9.0)]
    first, second = (weights(term, subject, frames, 9.0) for term in terms)
    np.testing.assert_array_equal(first, second)
    assert not first[:, 20:25].any()


def test_every_second_frame_tells_what_all_of_them_do(person: Person) -> None:
    """And nothing of what the others hold: they may be anywhere."""
    points = person[2]
    sigma = np.full((FRAMES, 53), SIGMA)
    sigma[LAST, 7] = 2.0 * SIGMA
    noisy = points + sigma[..., None] * np.random.default_rng(4).normal(size=points.shape)
    looked_at = np.arange(FRAMES) % 2 == 0
    spoilt = np.where(looked_at[:, None, None], noisy, 9.0)
    found = []
    for measured in (noisy, spoilt):
        term = PositionTerm(measured, np.full(points.shape[:2], SIGMA**-2))
        rescaled = with_window_variances(term, points[looked_at], FPS, 4.0, 0.0, looked_at)
        assert isinstance(rescaled, PositionTerm)
        found.append(term.weight / rescaled.weight)
    np.testing.assert_array_equal(found[0], found[1])
    assert found[0].shape == (FRAMES, 53) and found[0][LAST, 7].mean() > 1.5 * found[0][FIRST, 7].mean()
    assert np.delete(found[0], 7, axis=1).mean() == pytest.approx(1.0, abs=0.08)
