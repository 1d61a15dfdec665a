"""Keys around a lost limb start anew from the points; all others stay. Keys of a gap start between its ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from solver_backend.fitters.keyframes.initial_keys import _lost_windows, _neighbours, resolve_lost_limbs
from solver_backend.fitters.keyframes.optimise import Schedule, solve_keys
from solver_backend.fitters.measurements.views import LocatedPoints
from solver_backend.fitters.model.subject import Keyframes, pose
from solver_backend.fitters.problem import Measurements
from tests.support.stick_scene import ROTATIONS, StickScene


def _measured(scene: StickScene) -> Measurements:
    covariance = np.tile(1e-4 * np.eye(3), (*scene.points.shape[:2], 1, 1))
    points, landmarks = np.asarray(scene.points), scene.subject.landmarks
    return Measurements(landmarks, points, covariance, scene.term, 60.0, LocatedPoints.of(points, landmarks.names))


def _of_windows(keys: Keyframes) -> Callable[[slice], Keyframes]:
    return lambda windows: keys.select(slice(2 * windows.start, 2 * windows.stop + 1))


def _resolved(scene: StickScene, keys: Keyframes, schedule: Schedule) -> Keyframes:
    model = scene.model(ROTATIONS)
    at = pose(model.subject, model.poses(keys, scene.layout)).points
    return resolve_lost_limbs(_measured(scene), model, scene.layout, keys, at, _of_windows(scene.start), schedule)


def _lost(scene: StickScene, keys: Keyframes) -> np.ndarray:
    model = scene.model(ROTATIONS)
    points = pose(model.subject, model.poses(keys, scene.layout)).points
    return _lost_windows(_measured(scene), scene.layout, points, None)


def test_a_lost_limb_is_solved_again_alone_and_only_for_a_lower_cost():
    scene, schedule = StickScene(), Schedule((3.0,), 20)
    solution = solve_keys(scene.model(ROTATIONS), scene.layout, scene.truth, schedule)
    assert not _lost(scene, solution.keys).any()
    assert _resolved(scene, solution.keys, schedule) is solution.keys
    thrown = solution.keys.residual.copy()
    thrown[3, [15, 17]] += 1.5
    lost = replace(solution.keys, residual=thrown)
    assert _lost(scene, lost).tolist() == [False, True, False]
    found = _resolved(scene, lost, schedule)
    assert not _lost(scene, found).any()
    np.testing.assert_allclose(found.transl, solution.keys.transl, atol=0.01)


def test_points_that_are_wrong_for_some_frames_do_not_lead_keys_astray():
    """A labeller takes a limb's point for another's, and single frames make bodies of it that face the wrong way."""
    scene, schedule = StickScene(), Schedule((3.0,), 3)
    model = scene.model(ROTATIONS)
    keys = solve_keys(model, scene.layout, scene.truth, schedule).keys
    points = np.array(scene.points)
    points[20:40, -1, 2] += 0.3 * np.sin(np.pi * np.arange(20) / 20) ** 2
    measured = replace(_measured(scene), points=points)
    at = pose(model.subject, model.poses(keys, scene.layout)).points
    assert _lost_windows(measured, scene.layout, at, None).any()
    turned = replace(scene.start, quat=scene.start.quat[:, [3, 2, 1, 0]] * np.array([-1.0, -1.0, 1.0, 1.0]))
    found = resolve_lost_limbs(measured, model, scene.layout, keys, at, _of_windows(turned), schedule)
    assert found is keys


def test_keys_of_a_gap_lie_between_its_ends_and_all_others_at_the_nearest_seen_frame():
    seen = np.r_[2:10, 20:31]
    before, after, share = _neighbours(seen, np.array([0.0, 5.0, 7.5, 12.0, 17.0, 20.0, 34.0]))
    assert before.tolist() == [2, 5, 7, 9, 9, 9, 30] and after.tolist() == [2, 5, 7, 20, 20, 20, 30]
    np.testing.assert_allclose(share, [0, 0, 0, 3 / 11, 8 / 11, 1, 0])
