"""Compare PyTorch's gradient with the analytic gradient."""

import numpy as np
import pytest

from research.baselines.person import prepare
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.recipes.bundlemocap import KEYS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import JointSet
from tests.benchmarks.bench_published import first_key, window_of
from tests.benchmarks.comparison.autograd_window import keypoint_regressor


@pytest.mark.filterwarnings("ignore:torch.asarray")  # its new default is what automatic differentiation needs
def test_autograd_equals_the_gradient_by_hand():
    torch = pytest.importorskip("torch")
    capture = demo_capture()
    prepared, layout = prepare(capture), KeyframeLayout.even(capture.num_frames, 20)
    key = first_key(prepared)
    window = window_of(prepared, layout, 1, key, torch.zeros(1, dtype=torch.float64))
    rng = np.random.default_rng(0)
    start = tuple(part.repeat(2, axis=0) for part in key)
    z = start[0] + 0.02 * rng.normal(size=start[0].shape)
    z -= z.mean(-1, keepdims=True)
    state = (z / np.linalg.norm(z, axis=-1, keepdims=True), start[1], start[2] + 0.01)
    (cost, gradient), (by_hand, expected) = window.objective(state), window.window.objective(state)
    assert cost == pytest.approx(by_hand, rel=1e-9)
    gradient, expected = (KEYS.project(state, found) for found in (gradient, expected))
    for name, one, other in zip("zRt", gradient, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * np.abs(other).max(), err_msg=name)


def test_keypoints_regressed_from_the_mesh_follow_the_landmarks():
    body = load_body()
    landmarks = keypoint_landmarks(body, JointSet.BODY_25)
    local = np.tile(np.eye(3), (2, 21, 1, 1))
    local[1] = exp_so3(0.3 * np.random.default_rng(0).normal(size=(21, 3)))
    pose = np.zeros(10), np.tile(np.eye(3), (2, 1, 1)), local, np.zeros((2, 3))
    points = pose_landmarks(body, landmarks, *pose).points
    found = keypoint_regressor(body, points[0]) @ pose_mesh(body, *pose)
    apart = np.linalg.norm(found - points, axis=-1)
    assert apart[0].max() < 1e-9
    assert np.median(apart[1]) < 0.02
