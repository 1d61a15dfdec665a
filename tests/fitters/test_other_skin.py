"""Two people of a take whose bodies overlap: each moves out by half, and people apart stay as they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, film_benchmark
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.joint_sets import JointSet
from solver_backend.exchange.motion_file import FLAG_UNSEEN
from solver_backend.fitters.model.subject import BLOCK_POSES, PosedFrames, Subject
from solver_backend.fitters.other_skin import OtherSkin, only_close, spread_vertices
from solver_backend.fitters.pipeline import solve
from solver_backend.fitters.skin_contacts import find_touching_people
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Capture, Motion
from tests.support.floor_takes import FPS, kneeling

FRAMES = 20
PERSON = replace(kneeling(FRAMES, 0.0), local=np.tile(np.eye(3), (FRAMES, 21, 1, 1)))
BODY = PERSON.body


@pytest.fixture(name="capture", scope="module")
def four_views() -> Capture:
    """Return a person who stands."""
    return film_benchmark(PERSON, FPS, "stands", BenchmarkSettings(seed=3), np.random.default_rng(3))


@pytest.fixture(name="alone", scope="module")
def solved_alone(capture: Capture) -> Motion:
    """Return the person as solved without company."""
    return solve(capture).motion


def beside(motion: Motion, metres: float | np.ndarray) -> Motion:
    """Return the same person so far behind, in all frames or in each of them (F, 1)."""
    away = (metres * np.array([0.0, 1.0, 0.0])).astype(np.float32)
    joints = None if motion.joints is None else motion.joints + away.reshape(-1, 1, 3)
    return replace(motion, transl=motion.transl + away, joints=joints)


def gaps_mm(one: Motion, other: OtherSkin) -> np.ndarray:
    """Return (F,) distances of the deepest skin, negative inside the other."""
    turns = exp_so3(one.body_pose.reshape(one.num_frames, -1, 3)[:, :21].astype(float))
    root, transl = exp_so3(one.global_orient.astype(float)), one.transl.astype(float)
    skin = pose_mesh(BODY, one.betas.astype(float), root, turns, transl)[:, spread_vertices(BODY)]
    return 1000.0 * other.nearest(skin, np.arange(one.num_frames))[0].min(axis=1)


def test_distances_are_signed_and_end_where_nobody_is_seen(alone: Motion) -> None:
    flags = np.zeros(FRAMES, np.uint8)
    flags[5] = FLAG_UNSEEN
    skin = OtherSkin.of(BODY, [replace(alone, flags=flags)])
    middle, step = skin.points[0].astype(float), 0.004 * skin.normals[0].astype(float)
    for side in (1.0, -1.0):
        height, normals = skin.nearest((middle + side * step)[None], np.array([0]))
        assert np.abs(height - side * 0.004).max() < 1e-4
        assert ((normals[0] * skin.normals[0]).sum(axis=-1) > 0.999).mean() > 0.99
    assert np.isinf(skin.nearest(middle[None], np.array([5]))[0]).all()
    assert np.isinf(skin.nearest(middle[None] + [0.0, 3.0, 0.0], np.array([0]))[0]).all()


@pytest.mark.parametrize("seen", [0, 1])
def test_a_long_take_with_few_seen_frames_has_a_skin(seen: int) -> None:
    zeros = np.zeros((3 * BLOCK_POSES, 72), np.float32)
    flags = np.full(len(zeros), FLAG_UNSEEN, np.uint8)
    flags[7 : 7 + seen] = 0
    joints = zeros.reshape(-1, 24, 3)
    motion = Motion(zeros[0, :10], zeros[:, :3], zeros[:, 3:], zeros[:, :3], FPS, BODY.id, joints, flags=flags)
    rest = BODY.v_template[spread_vertices(BODY)]
    height, _ = OtherSkin.of(BODY, [motion]).nearest(np.stack([rest, rest]), np.array([7, 8]))
    assert np.isfinite(height).all(axis=1).tolist() == [seen > 0, False]


def test_only_people_who_come_close_meet(alone: Motion) -> None:
    assert only_close(alone, beside(alone, 1.0)) is None and only_close(alone, replace(alone, joints=None)) is None
    metres = np.where(np.arange(FRAMES) < 5, 0.2, 1.0)[:, None]
    near = only_close(alone, beside(alone, metres))
    assert near is not None and near.flags is not None
    np.testing.assert_array_equal(near.flags == 0, np.arange(FRAMES) < 5)
    skin, whole = (OtherSkin.of(BODY, [motion]) for motion in (near, beside(alone, metres)))
    assert len(skin.points) == 5 and len(whole.points) == FRAMES
    taken = np.arange(2, 8)
    height, found = (other.nearest(whole.points[taken].astype(float), taken)[0] for other in (skin, whole))
    np.testing.assert_array_equal(height[:3], found[:3])
    assert np.isinf(height[3:]).all() and np.isfinite(found).all()


def test_frames_in_which_either_is_unseen_are_no_meeting(alone: Motion) -> None:
    unseen, other = replace(alone, flags=np.full(FRAMES, FLAG_UNSEEN, np.uint8)), beside(alone, 0.2)
    assert only_close(unseen, other) is None and only_close(other, unseen) is None
    subject = Subject.average(BODY, keypoint_landmarks(BODY, JointSet.BODY_25), np.zeros(1))
    frames, seen = PosedFrames.of_motion(alone, subject.betas), np.arange(FRAMES) < 5
    met = find_touching_people(subject, frames, FPS, OtherSkin.of(BODY, [other]), seen)
    assert met is not None and met.works[:5].any() and met.solid[:5].any()
    assert not met.works[5:].any() and not met.solid[5:].any()


@pytest.mark.slow
def test_each_moves_out_by_half(capture: Capture, alone: Motion) -> None:
    other = beside(alone, 0.2)
    found = solve(capture, others=[other]).motion
    before, after = (gaps_mm(motion, OtherSkin.of(BODY, [other])).mean() for motion in (alone, found))
    assert before < -25.0 and 0.35 * before > after > 0.75 * before
    assert np.linalg.norm(found.joints - alone.joints, axis=-1).mean() < 0.02
    [note] = [item for item in found.provenance["diagnostics"] if item["code"] == "people_overlap"]
    assert note["values"]["size"] == pytest.approx(-0.1 * before, rel=0.3)
    apart = solve(capture, others=[beside(alone, 1.0)]).motion
    np.testing.assert_array_equal(apart.joints, alone.joints)


@pytest.mark.slow
@pytest.mark.parametrize("metres", [0.0, 0.06])
def test_a_second_track_of_the_same_person_moves_nobody(capture: Capture, alone: Motion, metres: float) -> None:
    found = solve(capture, others=[beside(alone, metres)]).motion
    np.testing.assert_array_equal(found.joints, alone.joints)
    refused = [item for item in found.provenance["diagnostics"] if item["code"] == "surface_contradicted"]
    assert [item["values"]["surface"] for item in refused] == ["other people"] * (metres > 0)
