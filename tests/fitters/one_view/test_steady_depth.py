"""Depth that trembles is calmed, lengths and slow movement stay."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.one_view.depth import OneView
from solver_backend.fitters.one_view.steady import steady_depth
from solver_backend.fitters.problem import SolvedFrames
from solver_backend.geometry.interpolation import smooth
from solver_backend.geometry.rotations import exp_so3
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
