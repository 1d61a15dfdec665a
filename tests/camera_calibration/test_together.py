"""Several sources in one bundle adjustment: truth is recovered, what contradicts is named, what is held holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.camera_calibration.adjustment.bundle import Bodies, BodySightings, Held, Unknowns, adjust
from solver_backend.camera_calibration.extrinsics.together import (
    Clicks,
    board_evidence,
    calibrate_together,
    clicks_evidence,
    in_world_of,
    person_evidence,
)
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import diagnostic, sentence
from solver_backend.exchange.errors import CalibrationInvalid, NoDetections
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.types import Cameras, JointSet, Keypoints2D
from tests.support.carried_board import BOARD, carried, ring

PLACES = {f"p{i}": (x, y, z) for i, (x, y, z) in enumerate(
    (x, y, z) for x in (-0.5, 0.5) for y in (-0.4, 0.4) for z in (0.0, 0.9)
)}  # fmt: skip


def shaken(cameras: Cameras, seed: int, turn: float = 0.01, shift_m: float = 0.03) -> Cameras:
    rng = np.random.default_rng(seed)
    R = exp_so3(rng.normal(0, turn, (len(cameras), 3))) @ cameras.R
    return replace(cameras, R=R, t=cameras.t + rng.normal(0, shift_m, cameras.t.shape))


def walked(cameras: Cameras, seed: int, noise_px: float = 5.0, frames: int = 60) -> Keypoints2D:
    """Return the keypoints of somebody who goes round the middle, seen with noise."""
    rng = np.random.default_rng(seed)
    rest = np.stack([rng.uniform(-0.3, 0.3, 17), rng.uniform(-0.3, 0.3, 17), np.linspace(0.8, -0.8, 17)], axis=-1)
    angle = np.linspace(0, 2 * np.pi, frames)[:, None]
    path = 0.5 * np.concatenate([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    points = rest + path[:, None] + 0.1 * np.sin(3 * angle[..., None] + np.arange(17)[:, None])
    px = project(cameras, points)
    px = px + rng.normal(0, noise_px, px.shape)
    return Keypoints2D(px, np.full(px.shape[:-1], 0.9), JointSet.COCO_17, 30.0)


def clicked(cameras: Cameras, seed: int, places: bool = True) -> Clicks:
    px = project(cameras, np.array(list(PLACES.values())))
    px = px + np.random.default_rng(seed).normal(0, 1.0, px.shape)
    seen = {c: dict(zip(PLACES, map(tuple, rows), strict=True)) for c, rows in zip(cameras.names, px, strict=True)}
    return Clicks(seen, dict(PLACES) if places else {})


def off(found: Cameras, truth: Cameras) -> np.ndarray:
    return np.linalg.norm(found.centres - truth.centres, axis=1)


@pytest.mark.slow
def test_all_sources_at_once_are_nearer_the_truth_than_each_and_as_sure_as_they_say() -> None:
    truth, squares, told = ring(4), [], []
    for seed in range(4):
        clicks = clicked(truth, seed)
        start = in_world_of(clicks, shaken(truth, seed), with_scale=True)
        sources = [
            clicks_evidence(start, clicks),
            board_evidence(start, BOARD, carried(truth, 12, noise_px=0.3, seed=seed)),
            person_evidence(start, walked(truth, seed)),
        ]
        alone, found = (calibrate_together(start, chosen) for chosen in (sources[:1], sources))
        squares.append([(off(one.cameras, truth) ** 2).mean() for one in (alone, found)])
        told.append((found.centre_sigma_m**2).mean())
        assert found.findings == ()
        assert len(found.notes) == 4 and found.notes[-1] == diagnostic("world_origin", source="places")
        assert (found.centre_sigma_m < alone.centre_sigma_m).all()
    clicks_alone, together = np.sqrt(np.mean(squares, axis=0))
    assert together < 0.8 * clicks_alone
    assert together < 0.01
    assert 0.4 < together / np.sqrt(np.mean(told)) < 2.0


def test_a_board_on_the_floor_tells_the_world_of_a_take() -> None:
    truth = ring(3)
    start = shaken(truth, 1)
    board = board_evidence(start, BOARD, carried(truth, 15, seed=3))
    frame = board.labels[4]
    found = calibrate_together(start, [person_evidence(start, walked(truth, 2)), board], origin_frame=frame)
    sides = [np.linalg.norm(c.centres - np.roll(c.centres, 1, 0), axis=1) for c in (found.cameras, truth)]
    assert np.abs(sides[0] - sides[1]).max() < 0.005  # the board's scale, not the start's
    again = board_evidence(found.cameras, BOARD, carried(truth, 15, seed=3))
    i = again.labels.index(frame)
    assert np.linalg.norm(again.bodies.t[i]) < 0.005
    assert np.linalg.norm(log_so3(again.bodies.R[i] @ np.diag([1.0, -1.0, -1.0]))) < 0.02
    with pytest.raises(CalibrationInvalid, match="not visible at frame 900"):
        calibrate_together(start, [board], origin_frame=900)
    with pytest.raises(CalibrationInvalid, match="needs footage of a board"):
        calibrate_together(start, [person_evidence(start, walked(truth, 2))], origin_frame=0)


def test_a_camera_moved_between_the_board_and_the_take_is_found() -> None:
    truth = ring(4)
    R = truth.R.copy()
    R[2] = exp_so3(np.array([0.0, 0.03, 0.01])) @ R[2]
    moved = replace(truth, R=R, t=-(R @ truth.centres[..., None])[..., 0])
    board = board_evidence(truth, BOARD, carried(truth, 12, seed=1))
    assert calibrate_together(truth, [board, person_evidence(truth, walked(truth, 0))]).findings == ()
    found = calibrate_together(truth, [board, person_evidence(truth, walked(moved, 0))])
    [finding] = found.findings
    assert (finding.code, finding.where.cameras) == ("observations_contradict", ("cam3",))
    assert sentence(finding).startswith("In cam3, the error of the person is ")


def test_a_calibration_that_is_held_holds_and_lets_a_moved_camera_go() -> None:
    truth = ring(4)
    centre = truth.centres.copy()
    centre[1] += [0.25, 0.1, 0.0]
    now = replace(truth, t=-(truth.R @ centre[..., None])[..., 0])
    found = calibrate_together(truth, [person_evidence(truth, walked(now, 0, noise_px=2.0))], hold_m=0.005)
    assert off(found.cameras, now).max() < 0.02
    [finding] = found.findings
    assert (finding.code, finding.where.cameras) == ("camera_off", ("cam2",))
    assert 200 <= finding.values["size"] < 300
    same = calibrate_together(truth, [person_evidence(truth, walked(truth, 0))], hold_m=0.002)
    free = calibrate_together(truth, [person_evidence(truth, walked(truth, 0))])
    assert off(same.cameras, truth).max() < 0.004 < off(free.cameras, truth).max()
    assert (same.centre_sigma_m < 0.004).all()


def test_nothing_to_calibrate_by_is_named() -> None:
    truth = ring(3)
    with pytest.raises(CalibrationInvalid, match="no observations to use"):
        calibrate_together(truth, [])
    with pytest.raises(CalibrationInvalid, match="no observations for cam3"):
        calibrate_together(truth, [board_evidence(truth, BOARD, [*carried(truth, 9)[:2], {}])])
    with pytest.raises(NoDetections, match="No camera sees"):
        board_evidence(truth, BOARD, [{}, {}, {}])
    clicks = clicked(truth, 0)
    with pytest.raises(CalibrationInvalid, match="2 known positions are seen"):
        in_world_of(Clicks(clicks.px, {k: PLACES[k] for k in ("p0", "p1")}), truth, with_scale=True)
    assert in_world_of(clicked(truth, 0, places=False), truth, with_scale=True) is truth


def test_what_holds_a_pose_pulls_as_its_deviations_say() -> None:
    truth = ring(2)
    expected = shaken(truth, 3, 0.002, 0.004)
    point = Bodies(np.eye(3)[None], np.zeros((1, 3)))
    px = project(truth, np.zeros((1, 3)))[:, 0]
    seen = BodySightings(np.arange(2), np.zeros(2, int), np.zeros((2, 3)), px, np.full(2, 1e4))
    unknowns = Unknowns(np.ones(2, bool), np.zeros((2, 12), bool), held=Held(expected, 0.01, 0.02))
    found = adjust(truth, point, seen, unknowns, gauge=0)
    assert off(found.cameras, expected).max() < 1e-4  # a sighting of no weight leaves what is expected
    sigma = np.sqrt(np.diag(found.covariance)).reshape(2, -1)[:, :6]
    np.testing.assert_allclose(sigma, np.tile(np.repeat([0.01, 0.02], 3), (2, 1)), rtol=1e-2)
