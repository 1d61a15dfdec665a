"""Keys around a lost limb start anew from the points; all others stay. Keys of a gap start between its ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from solver_backend.fitters.keyframes.initial_keys import _neighbours
from solver_backend.fitters.keyframes.optimise import BundleModel, Schedule, solve_keys
from solver_backend.fitters.keyframes.restart import regained, restarted
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.fitters.model.subject import pose
from tests.support.stick_scene import ROTATIONS, StickScene


def _measured(scene: StickScene) -> Measurements:
    covariance = np.tile(1e-4 * np.eye(3), (*scene.points.shape[:2], 1, 1))
    return Measurements(
        scene.subject.landmarks, np.asarray(scene.points), covariance, scene.term, 60.0, lambda points: (None, {})
    )


def _of_windows(keys: Keyframes) -> Callable[[slice], Keyframes]:
    return lambda windows: keys.select(slice(2 * windows.start, 2 * windows.stop + 1))


def _restarted(scene: StickScene, measured: Measurements, model: BundleModel, keys: Keyframes) -> Keyframes | None:
    points = pose(model.subject, model.poses(keys, scene.layout)).points
    return restarted(measured, scene.layout, points, keys, _of_windows(scene.start))


def test_a_limb_that_residual_rotations_threw_away_is_started_anew():
    scene = StickScene()
    model, measured = scene.model(ROTATIONS), _measured(scene)
    assert _restarted(scene, measured, model, scene.truth) is None
    thrown = scene.truth.residual.copy()
    thrown[3, [15, 17]] += 1.5
    keys = _restarted(scene, measured, model, replace(scene.truth, residual=thrown))
    assert keys is not None
    for name in ("z", "transl", "residual"):
        found = getattr(keys, name)
        np.testing.assert_array_equal(found[2:5], getattr(scene.start, name)[2:5])
        np.testing.assert_array_equal(found[[0, 1, 5, 6]], getattr(scene.truth, name)[[0, 1, 5, 6]])


def test_a_lost_limb_is_solved_again_alone_and_only_for_a_lower_cost():
    scene = StickScene()
    model, measured, schedule = scene.model(ROTATIONS), _measured(scene), Schedule((3.0,), 20)
    solution = solve_keys(model, scene.layout, scene.truth, schedule)
    assert regained(measured, model, scene.layout, solution, _of_windows(scene.start), schedule).cost == solution.cost
    thrown = solution.keys.residual.copy()
    thrown[3, [15, 17]] += 1.5
    lost = replace(solution, keys=replace(solution.keys, residual=thrown))
    found = regained(measured, model, scene.layout, lost, _of_windows(scene.start), schedule).keys
    assert _restarted(scene, measured, model, found) is None
    np.testing.assert_allclose(found.transl, solution.keys.transl, atol=0.01)


def test_keys_of_a_gap_lie_between_its_ends_and_all_others_at_the_nearest_seen_frame():
    seen = np.r_[2:10, 20:31]
    before, after, share = _neighbours(seen, np.array([0.0, 5.0, 7.5, 12.0, 17.0, 20.0, 34.0]))
    assert before.tolist() == [2, 5, 7, 9, 9, 9, 30] and after.tolist() == [2, 5, 7, 20, 20, 20, 30]
    np.testing.assert_allclose(share, [0, 0, 0, 3 / 11, 8 / 11, 1, 0])
