"""Depth that trembles is calmed, lengths and slow movement stay. Turns are as unsure as the ends of their bones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.biomechanics.segments import SEGMENTS, segment_turns, turn_spread
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.one_view.depth import TURNS, OneView, with_open_depth
from solver_backend.fitters.one_view.steady import steady_depth
from solver_backend.fitters.problem import SolvedFrames
from solver_backend.geometry.interpolation import smooth
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.types import JointSet

FRAMES, FPS = 60, 30.0
SIGHT = np.array([0.0, 1.0, 0.0])
ELBOW, WRIST, SHOULDER = 18, 20, 16


def one_view() -> OneView:
    """Return a camera 4 m in front of the person, which looks along +Y."""
    sight = np.tile(SIGHT, (FRAMES, 1))
    deviation = np.full((FRAMES, 24), 0.1)
    return OneView(
        "cam",
        np.tile([0.0, -4.0, 1.0], (FRAMES, 1)),
        0.03,
        0.0,
        0.0,
        "",
        False,
        sight,
        deviation,
        np.full((len(sight), 8, 3), 1 / 3),
    )


def solved(depth_noise: float, transl_noise: float = 0.0) -> SolvedFrames:
    """Return somebody who raises the left arm in a second, its forearm trembling in depth."""
    body, rng = load_body(), np.random.default_rng(0)
    local = np.zeros((FRAMES, 21, 3))
    share = np.linspace(-1.0, 0.8, FRAMES)
    local[:, SHOULDER - 1, 2] = share
    local[:, ELBOW - 1, 1] = depth_noise * rng.normal(size=FRAMES)
    transl = np.tile([0.0, 0.0, 0.95], (FRAMES, 1))
    transl[:, 1] += transl_noise * rng.normal(size=FRAMES)
    upright = np.tile(exp_so3(np.array([np.pi / 2, 0.0, 0.0])), (FRAMES, 1, 1))
    frames = PosedFrames(upright, exp_so3(local), transl)
    return SolvedFrames(Subject.average(body, keypoint_landmarks(body, JointSet.COCO_17), transl), frames)


def joints(take: SolvedFrames) -> np.ndarray:
    return np.asarray(pose(take.subject, take.frames).skeleton.joints)


def trembling(points: np.ndarray, axis: int) -> float:
    return float(np.diff(points[..., axis], 2, axis=0).std())


def test_a_trembling_forearm_is_calmed_in_depth_and_keeps_its_length_and_its_way_across() -> None:
    still, rough = joints(solved(0.0)), solved(0.25)
    before, after = joints(rough), joints(steady_depth(rough, one_view(), FPS))
    assert trembling(after[:, WRIST], 1) < 0.1 * trembling(before[:, WRIST], 1)
    for points in (before, after):
        length = np.linalg.norm(points[:, WRIST] - points[:, ELBOW], axis=1)
        assert np.abs(length - length[0]).max() < 1e-9
    inner = slice(8, -8)
    assert np.abs(after[inner, WRIST] - still[inner, WRIST])[:, [0, 2]].max() < 0.02
    off = [np.abs(points - still)[inner, WRIST, 1].std() for points in (after, before)]
    assert off[0] < 0.6 * off[1]


def test_distance_is_calmed_and_the_place_across_is_where_it_was() -> None:
    rough = solved(0.0, transl_noise=0.03)
    before, after = joints(rough), joints(steady_depth(rough, one_view(), FPS))
    assert trembling(after[:, 0], 1) < 0.1 * trembling(before[:, 0], 1)
    assert np.abs(after[:, 0] - before[:, 0])[:, [0, 2]].max() < 0.01


def test_what_stands_still_or_moves_evenly_stays() -> None:
    take = solved(0.0)
    before, after = joints(take), joints(steady_depth(take, one_view(), FPS))
    assert np.abs(after - before).max() < 2e-3, "at the ends too"
    line = np.arange(20.0)[:, None]
    np.testing.assert_allclose(smooth(line, 2.0), line, atol=1e-12)
    np.testing.assert_allclose(smooth(np.ones((2, 3)), 4.0), 1.0)


SHIN = list(SEGMENTS).index("left_shank")


def test_turns_are_as_unsure_as_the_ends_of_their_bones() -> None:
    body, take, one = load_body(), solved(0.0), one_view()
    frames, joints = len(one.sight), np.asarray(body.recorded_joints)
    unsure = one.sight_sigma_m.copy()
    unsure[: frames // 2] *= 2.0
    zero = np.zeros((frames, len(joints), 6))
    turns = np.full((frames, len(SEGMENTS), 6), [1e-4, 0, 0, 1e-4, 0, 1e-4])
    wide = with_open_depth(replace(take, covariance=zero, turns=turns), replace(one, sight_sigma_m=unsure), joints)
    variance = np.trace(unpacked(np.asarray(wide.turns)), axis1=-2, axis2=-1)[:, SHIN] / 3.0 - 1e-4
    rest = body.joints_template
    length = np.linalg.norm(rest[7] - rest[4])
    assert np.allclose(np.sqrt(variance[-1]), TURNS["shank"] * np.hypot(0.1, 0.1) / length, rtol=1e-6)
    assert np.allclose(variance[0], 4.0 * variance[-1])


def test_a_segment_turns_by_the_joints_between_it_and_the_one_above() -> None:
    body = load_body()
    local = np.tile(np.eye(3), (1, 21, 1, 1))
    bends = [exp_so3(np.array([0.1 * k, 0.0, 0.0])) for k in (1, 2, 3)]
    for joint, bend in zip((3, 6, 9), bends, strict=True):  # the spine, from the pelvis to the thorax
        local[0, joint - 1] = bend
    turns = segment_turns(body, np.eye(3)[None], local)[0]
    assert np.allclose(turns[list(SEGMENTS).index("thorax")], exp_so3(np.array([0.6, 0.0, 0.0])))
    assert np.allclose(turns[SHIN], np.eye(3))
    assert turn_spread(body, np.ones((2, len(body.recorded_joints)))).shape == (2, len(SEGMENTS))
