"""Strange bodies: no shape of the solver's, still bodies; and what a solve makes of one that is seen exactly."""

from __future__ import annotations

import numpy as np
import pytest

from research.simulation.model_error import exact_capture
from solver_backend.body.body import load_body
from solver_backend.fitters import solve
from solver_backend.synthesis.simulation.cast import strange_body
from tests.support.walking_take import walk


def _lengths(body) -> np.ndarray:
    joints = body.joints_template
    return np.array([np.linalg.norm(joints[j] - joints[p]) for j, p in enumerate(body.parents) if p >= 0])


def test_bones_and_flesh_are_as_strange_as_asked() -> None:
    body = load_body()
    bones = [strange_body(seed, 0.04, 0.0) for seed in range(12)]
    shares = np.array([_lengths(bone) / _lengths(body) - 1 for bone in bones])
    assert 0.02 < np.sqrt(np.mean(shares**2)) < 0.06
    flesh = [strange_body(seed, 0.0, 6.0).v_template - body.v_template for seed in range(12)]
    assert 4.5 < 1e3 * np.sqrt(np.mean(np.square(flesh))) < 7.5
    assert np.array_equal(bones[3].v_template, strange_body(3, 0.04, 0.0).v_template)


def test_no_shape_of_the_solvers_is_like_it() -> None:
    body, strange = load_body(), strange_body(5)
    moved = (strange.v_template - body.v_template).ravel()
    basis = body.shapedirs.reshape(-1, body.shapedirs.shape[-1])
    left = moved - basis @ np.linalg.lstsq(basis, moved, rcond=None)[0]
    assert np.sqrt(np.mean(left**2)) > 0.004


@pytest.fixture(scope="module")
def seen_exactly():
    return exact_capture(walk(60), seed=2)


@pytest.mark.slow
def test_a_person_whom_the_body_cannot_follow_loses_no_limb_where_detections_are_exact(seen_exactly) -> None:
    motion = solve(seen_exactly).motion
    error = 1e3 * np.linalg.norm(np.asarray(motion.keypoints3d) - seen_exactly.truth["meant3d"], axis=-1)
    assert error.mean() < 2.0 and error.max() < 20.0
    assert motion.joint_sigma is not None and np.isfinite(motion.joint_sigma).all()
