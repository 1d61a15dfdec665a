"""A take cut into chunks against the same take solved at once; blocks of frames against all of them."""

import numpy as np
import pytest

from solver_backend.fitters.keyframes import normal_equations, optimise
from solver_backend.fitters.keyframes.normal_equations import MotionPrior, ResidualRotationTerm
from solver_backend.fitters.keyframes.optimise import (
    Schedule,
    chunks_of,
    covariance_of_joints,
    noise_inflation,
    solve_keys,
    solve_long,
)
from solver_backend.fitters.model import keyframe_curve, subject
from solver_backend.fitters.model.keyframe_curve import key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import points_of, pose
from solver_backend.geometry.small_matrices import mean_sigma, unpacked
from tests.support.finer_keys import resampled
from tests.support.stick_scene import FRAMES
from tests.support.stick_scene import StickScene as Scene

TIGHT = Schedule((3.0,), 12, tolerance=1e-7)
MOTION = MotionPrior(2 / 60, unseen=np.arange(30) // 6 == 2), ResidualRotationTerm(np.full((21, 3), 0.05), 2.0)


@pytest.fixture
def scene():
    """A scene of 15 windows, and a start."""
    scene = Scene()
    finer = KeyframeLayout.even(FRAMES, 4)
    scene.start, scene.layout = resampled(scene.start, scene.layout, finer), finer
    return scene


@pytest.mark.slow
def test_chunks_agree_with_the_whole_and_are_joined_at_their_keys(scene):
    model = scene.model(*MOTION)
    whole = solve_keys(model, scene.layout, scene.start, TIGHT).keys
    cut = solve_long(model, scene.layout, scene.start, TIGHT, windows=5, overlap=4).keys
    points = [pose(scene.subject, scene.poses(keys)).points for keys in (whole, cut)]
    np.testing.assert_allclose(points[1], points[0], atol=2e-4)
    alone = solve_long(model, scene.layout, scene.start, TIGHT, windows=5, overlap=0).keys
    rough = pose(scene.subject, scene.poses(alone)).points
    assert np.abs(rough - points[0]).max() > 5 * np.abs(points[1] - points[0]).max()


def test_covariance_of_chunks_is_that_of_the_whole(scene):
    model = scene.model(*MOTION)
    frames, constant_m = scene.poses(scene.start), np.full(24, 0.0065)
    one, cut = (
        covariance_of_joints(model, scene.layout, scene.start, frames, 3.0, 2.0, constant_m, windows, overlap=4)
        for windows in (99, 5)
    )
    assert one.shape == (FRAMES, 24 + 17, 6)  # of joints, then of turns
    assert np.linalg.eigvalsh(unpacked(one)).min() > 0
    scale = mean_sigma(one)[..., None] ** 2
    np.testing.assert_allclose(cut / scale, one / scale, atol=0.03)


def test_chunks_hold_every_window_once():
    chunks = chunks_of(23, 1, 5, 2)
    assert [w for chunk in chunks for w in range(chunk.kept.start, chunk.kept.stop)] == list(range(23))
    assert all(chunk.solved.start <= chunk.kept.start < chunk.kept.stop <= chunk.solved.stop for chunk in chunks)
    assert (chunks[0].solved.start, chunks[1].solved.start, chunks[-1].solved.stop) == (0, chunks[1].kept.start - 1, 23)


def test_blocks_of_frames_add_up_to_all_of_them(scene, monkeypatch):
    model, found = scene.model(*MOTION), []
    for frames in (10_000, 9):
        monkeypatch.setattr(normal_equations, "BLOCK_FRAMES", frames)
        monkeypatch.setattr(keyframe_curve, "BLOCK_POSES", frames)
        monkeypatch.setattr(optimise, "BLOCK_POSES", frames)
        monkeypatch.setattr(subject, "BLOCK_POSES", frames)
        cost, form = model.equations(scene.layout.rows(), scene.start, 3.0)
        equations = form()
        poses = key_poses(scene.prior, scene.start, scene.layout, residuals=True)
        inflation = noise_inflation(points_of(scene.subject, poses), scene.term, 3.0, 8)
        found.append((cost, equations.g, poses.local, inflation, equations.diagonal, equations.upper))
    for one, other in zip(found[0][:4], found[1][:4], strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-7)
    for one, other in zip(found[0][4:], found[1][4:], strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-4, atol=1e-3 * np.abs(one).max())
