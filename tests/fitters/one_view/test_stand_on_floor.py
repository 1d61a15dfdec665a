"""Standing feet are put on the floor and held. Feet in the air keep their height above the body."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.fitters.model.subject import PosedFrames, Subject
from solver_backend.fitters.one_view.shape import foot_vertices
from solver_backend.fitters.one_view.steady import stand_on_floor
from solver_backend.fitters.pipeline import solve
from solver_backend.fitters.problem import SolvedFrames
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.load import load_capture
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.types import JointSet
from tests.support.recordings import ABSENT, BALANCING_TRIAL, recordings_folder
from tests.support.standing_people import with_feet_on_the_floor

FRAMES, FPS = 40, 30.0
LEVEL = np.tile([0.0, 1.0, 0.0], (FRAMES, 1))
KNEES, ANKLES, HIPS = [3, 4], [6, 7], [0, 1]  # Columns of the local rotations, left and right.


def solved(above_m: float, slide_m_s: float = 0.0, lifted: float = 0.0) -> SolvedFrames:
    """Return somebody with slightly bent legs whose soles are so far above the floor, with the right knee lifted."""
    body = load_body()
    local = np.zeros((FRAMES, 21, 3))
    for side in (0, 1):
        bend = 0.3 + lifted * side
        local[:, HIPS[side], 0], local[:, KNEES[side], 0], local[:, ANKLES[side], 0] = -bend, 2 * bend, -bend
    root = np.tile(exp_so3(np.array([np.pi / 2, 0.0, 0.0])), (FRAMES, 1, 1))
    frames = PosedFrames(root, exp_so3(local), np.zeros((FRAMES, 3)))
    subject = Subject.average(body, keypoint_landmarks(body, JointSet.COCO_17), frames.transl)
    found = SolvedFrames(subject, frames, contacts=np.tile([True, not lifted], (FRAMES, 1)))
    transl = frames.transl - [0.0, 0.0, soles(found)[0][0, :, 2].min() - above_m]
    transl = transl + np.arange(FRAMES)[:, None] / FPS * [slide_m_s, 0.0, 0.0]
    return replace(found, frames=replace(frames, transl=transl))


def soles(take: SolvedFrames) -> list[np.ndarray]:
    """Return the (F, V, 3) vertices of the left and the right foot."""
    body, frames = take.subject.body, take.frames
    mesh = np.asarray(pose_mesh(body, np.zeros(10), frames.root, frames.local, frames.transl))
    return [mesh[:, foot_vertices(body, side)] for side in ("left", "right")]


def test_floating_and_sinking_soles_stand_on_the_floor() -> None:
    for above in (0.03, -0.03):
        for foot in soles(stand_on_floor(solved(above), LEVEL, FPS)):
            assert np.abs(foot[..., 2].min(axis=1)).max() < 1e-3


def test_both_feet_of_a_simulated_person_touch_the_floor() -> None:
    take = solved(0.0, lifted=0.05)
    frames = take.frames
    person = Person(take.subject.body, np.zeros(10), frames.root, frames.local, frames.transl)
    before, after = (
        soles(take),
        soles(replace(take, frames=replace(frames, local=with_feet_on_the_floor(person, FPS).local))),
    )
    assert before[1][..., 2].min() > 0.012
    for foot in after:
        assert np.abs(foot[..., 2].min(axis=1)).max() < 1e-3


def test_a_slide_of_standing_feet_is_taken_out() -> None:
    take = solved(0.01, slide_m_s=0.06)
    speeds = [
        np.abs(np.diff(soles(one)[0].mean(axis=1)[:, 0])).max() * FPS
        for one in (take, stand_on_floor(take, LEVEL, FPS))
    ]
    assert speeds[0] > 0.05 and speeds[1] < 0.005


def test_a_lifted_foot_follows_the_body_and_is_not_pulled_down() -> None:
    take = solved(0.03, lifted=0.4)
    before, after = (soles(one)[1][..., 2].min(axis=1) for one in (take, stand_on_floor(take, LEVEL, FPS)))
    assert before.min() > 0.05
    assert np.abs(before - after - 0.03).max() < 1e-3


def test_a_slow_error_of_height_moves_the_body_along_the_line_of_sight_of_a_high_camera() -> None:
    pitch = np.radians(30.0)
    sight = np.tile([0.0, np.cos(pitch), -np.sin(pitch)], (FRAMES, 1))
    take = solved(0.03)
    way = (np.asarray(stand_on_floor(take, sight, FPS).frames.transl) - take.frames.transl)[FRAMES // 2]
    assert way[1] > 0.03 and abs(way[2] + 0.03) < 1e-6


def test_planted_feet_stay_while_a_drifting_height_moves_the_body_along_a_pitched_line_of_sight() -> None:
    take = solved(0.0)
    drift = np.linspace(-0.02, 0.02, FRAMES)[:, None] * [0.0, 0.0, 1.0]
    take = replace(take, frames=replace(take.frames, transl=take.frames.transl + drift))
    for pitch in np.radians([5.0, 12.0, 30.0]):
        sight = np.tile([0.0, np.cos(pitch), -np.sin(pitch)], (FRAMES, 1))
        stood = stand_on_floor(take, sight, FPS)
        assert np.ptp(np.asarray(stood.frames.transl)[:, 1]) > 0.02
        for foot in soles(stood):
            assert np.abs(np.diff(foot.mean(axis=1)[:, :2], axis=0)).max() * FPS < 0.005
            assert np.abs(foot[..., 2].min(axis=1)).max() < 2e-3


def test_feet_high_above_the_floor_do_not_pull_the_body_down() -> None:
    take, late = solved(0.0), np.arange(FRAMES) >= FRAMES // 2
    climbed = take.frames.transl + 0.5 * late[:, None] * [0.0, 0.0, 1.0]
    contacts = np.tile(~late[:, None], 2)
    take = replace(take, frames=replace(take.frames, transl=climbed), contacts=contacts)
    moved = np.asarray(stand_on_floor(take, LEVEL, FPS).frames.transl) - climbed
    assert np.abs(moved).max() < 1e-3


def test_a_contact_that_is_missed_for_a_moment_is_no_flight_and_a_jump_is() -> None:
    take, middle = solved(0.0), np.arange(FRAMES) - FRAMES // 2
    missed = (np.abs(middle) < 6)[:, None]
    time = np.clip(6 - np.abs(middle), 0, None) / FPS * (np.clip(6 + np.abs(middle), 0, 12)) / FPS
    for height, stays in ((0.015 * time / time.max(), False), (0.5 * 9.81 * time, True)):
        frames = replace(take.frames, transl=take.frames.transl + height[:, None] * [0.0, 0.0, 1.0])
        stood = stand_on_floor(replace(take, frames=frames, contacts=np.tile(~missed, 2)), LEVEL, FPS)
        for foot in soles(stood):
            low = foot[..., 2].min(axis=1)
            assert bool(low[FRAMES // 2] > 0.9 * height.max()) is stays
            assert stays or np.abs(low).max() < 0.006


@pytest.mark.parametrize("fps", [30.0, 60.0])
@pytest.mark.parametrize("missed", [0, 1, 2])
def test_a_jump_keeps_its_height_if_contacts_beside_it_are_missed(fps: float, missed: int) -> None:
    take, flight_s = solved(0.0), 0.25
    time = (np.arange(FRAMES) - FRAMES // 2) / fps
    height = 0.5 * 9.81 * np.clip((flight_s / 2) ** 2 - time**2, 0.0, None)
    stands = np.abs(time) >= flight_s / 2 + (missed - 1e-6) / fps
    frames = replace(take.frames, transl=take.frames.transl + height[:, None] * [0.0, 0.0, 1.0])
    take = replace(take, frames=frames, contacts=np.tile(stands[:, None], 2))
    for shown in (slice(None), slice(FRAMES // 2 + 1), slice(FRAMES // 2, None)):  # The ends show half of the flight.
        posed = PosedFrames(frames.root[shown], frames.local[shown], frames.transl[shown])
        stood = stand_on_floor(replace(take, frames=posed, contacts=take.contacts[shown]), LEVEL[shown], fps)
        for foot in soles(stood):
            assert np.abs(foot[..., 2].min(axis=1) - height[shown]).max() < 0.1 * height.max()


def test_without_contacts_nothing_moves() -> None:
    take = replace(solved(0.03), contacts=np.zeros((FRAMES, 2), dtype=bool))
    assert stand_on_floor(take, LEVEL, FPS) is take


@pytest.mark.slow
def test_the_foot_that_balances_stays_on_the_floor_that_one_video_shows(tmp_path: Path) -> None:
    recorded = recordings_folder() / BALANCING_TRIAL / "pose" / "cam04_json"
    if not recorded.is_dir():
        pytest.skip(ABSENT)
    shutil.copytree(recorded, tmp_path / "pose" / recorded.name)
    motion = solve(load_capture(tmp_path)).motion
    turns = exp_so3(motion.global_orient), exp_so3(motion.body_pose.reshape(motion.num_frames, -1, 3)[:, :21])
    body = load_body()
    mesh = np.asarray(pose_mesh(body, motion.betas, *turns, motion.transl))
    left = mesh[:90, foot_vertices(body, "left"), 2].min(axis=1)  # It stands until the other one is down.
    assert np.abs(left).max() < 0.01
