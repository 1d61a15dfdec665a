"""A take cut into stretches against the same take solved at once; blocks of frames against all of them."""

import numpy as np
import pytest

from solver_backend.fitters.keyframes import normal_equations as chain
from solver_backend.fitters.keyframes import posterior as uncertainty
from solver_backend.fitters.keyframes.chunked import covariance_of_joints, parts_of, solve_long
from solver_backend.fitters.keyframes.optimise import Schedule, solve_keys
from solver_backend.fitters.keyframes.posterior import noise_inflation
from solver_backend.fitters.keyframes.temporal_prior import MotionPrior
from solver_backend.fitters.model import keyframe_curve as keyframes
from solver_backend.fitters.model.keyframe_curve import KeyframeLayout, key_poses, resampled
from solver_backend.fitters.model.subject import pose
from solver_backend.geometry.symmetric import mean_sigma, unpacked
from solver_backend.residuals import pose_mixture as usual_poses
from tests.support.stick_scene import FRAMES
from tests.support.stick_scene import StickScene as Scene

TIGHT = Schedule((3.0,), 12, tolerance=1e-7)
MOTION = MotionPrior(2 / 60, np.full((21, 3), 0.05), 2.0, unseen=np.arange(30) // 6 == 2)


@pytest.fixture(autouse=True)
def _a_figure_that_is_no_person(monkeypatch):
    monkeypatch.setattr(usual_poses, "STRENGTH", 0.0)


@pytest.fixture
def scene():
    """A scene of 15 windows, and a start."""
    scene = Scene()
    finer = KeyframeLayout.even(FRAMES, 4)
    scene.start, scene.layout = resampled(scene.start, scene.layout, finer), finer
    return scene


def test_stretches_agree_with_the_whole_and_are_joined_at_their_keys(scene):
    model = scene.model(MOTION, residuals=True)
    whole = solve_keys(model, scene.layout, scene.start, TIGHT).keys
    cut = solve_long(model, scene.layout, scene.start, TIGHT, stretch=5, overlap=4)
    points = [pose(scene.subject, scene.poses(keys)).points for keys in (whole, cut)]
    np.testing.assert_allclose(points[1], points[0], atol=2e-4)
    alone = solve_long(model, scene.layout, scene.start, TIGHT, stretch=5, overlap=0)
    rough = pose(scene.subject, scene.poses(alone)).points
    assert np.abs(rough - points[0]).max() > 5 * np.abs(points[1] - points[0]).max()


def test_covariance_of_stretches_is_that_of_the_whole(scene):
    model = scene.model(MOTION, residuals=True)
    frames = scene.poses(scene.start)
    one, cut = (
        covariance_of_joints(model, scene.layout, scene.start, frames, 3.0, 2.0, stretch, overlap=4)
        for stretch in (99, 5)
    )
    assert one.shape == (FRAMES, 24, 6)
    assert np.linalg.eigvalsh(unpacked(one)).min() > 0
    scale = mean_sigma(one)[..., None] ** 2
    np.testing.assert_allclose(cut / scale, one / scale, atol=0.02)


def test_parts_hold_every_window_once():
    parts = parts_of(23, 1, 5, 2)
    assert [w for part in parts for w in range(part.kept.start, part.kept.stop)] == list(range(23))
    assert all(part.solved.start <= part.kept.start < part.kept.stop <= part.solved.stop for part in parts)
    assert (parts[0].solved.start, parts[1].solved.start, parts[-1].solved.stop) == (0, parts[1].kept.start - 1, 23)


def test_blocks_of_frames_add_up_to_all_of_them(scene, monkeypatch):
    model, found = scene.model(MOTION, residuals=True), []
    for frames in (10_000, 9):
        monkeypatch.setattr(chain, "BLOCK_FRAMES", frames)
        monkeypatch.setattr(keyframes, "BLOCK_POSES", frames)
        monkeypatch.setattr(uncertainty, "BLOCK_POSES", frames)
        cost, form = model.equations(scene.layout.rows(), scene.start, 3.0)
        equations = form()
        poses = key_poses(scene.prior, scene.start, scene.layout, residuals=True)
        inflation = noise_inflation(scene.subject, poses, scene.term, 3.0, 8)
        found.append((cost, equations.g, poses.local, inflation, equations.diagonal, equations.upper))
    for one, other in zip(found[0][:4], found[1][:4], strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-7)
    for one, other in zip(found[0][4:], found[1][4:], strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-4, atol=1e-3 * np.abs(one).max())
