"""Recover known keyframes of a stick figure from noisy detections, window by window and all at once."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.cameras.projection import project
from solver_backend.fitters.keyframes.normal_equations import MotionPrior, data_equations
from solver_backend.fitters.keyframes.optimise import Schedule, solve_keys, solve_sliding
from solver_backend.fitters.model.keyframe_curve import KeyframeCurve
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Keyframes, frame_equations, hemisphere_aligned, pose
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import JointSet, Keypoints2D
from tests.support.layouts import LAYOUTS, ON_MANIFOLD
from tests.support.stick_scene import FRAMES, NOISE_PX, ROTATIONS
from tests.support.stick_scene import StickScene as Scene

SCHEDULE = Schedule((12.0, 3.0), 8)


def prior_of_motion() -> MotionPrior:
    return MotionPrior(10 / 60, accel_sigma=20.0, angular_sigma=90.0, latent_sigma=60.0)


def test_sliding_recovers_the_keys():
    scene = Scene()
    before = scene.error_mm(scene.start)
    solved = solve_sliding(scene.model(), scene.layout, scene.start, SCHEDULE).keys
    assert before > 25
    assert scene.error_mm(solved) < 3.0


@pytest.mark.slow
def test_global_is_no_worse_than_sliding():
    scene = Scene()
    sliding = solve_sliding(scene.model(), scene.layout, scene.start, SCHEDULE).keys
    together = solve_keys(scene.model(prior_of_motion()), scene.layout, sliding, SCHEDULE).keys
    assert scene.error_mm(together) < 1.05 * scene.error_mm(sliding)


@pytest.mark.slow
def test_residual_rotations_reach_poses_off_the_manifold():
    scene = Scene()
    rng = np.random.default_rng(0)
    bent = Keyframes(
        scene.truth.z, scene.truth.quat, scene.truth.transl, 0.15 * rng.normal(size=(21, 3)) * np.ones((7, 1, 1))
    )
    scene.points = pose(scene.subject, scene.poses(bent)).points
    px = project(scene.cameras, scene.points)
    keypoints = Keypoints2D(px, np.ones(px.shape[:-1]), JointSet.SMPL_24, 60.0)
    scene.term = ReprojectionTerm.of(scene.cameras, keypoints, np.full(24, NOISE_PX), px)
    errors, keys = [], scene.start
    for residuals in (False, True):
        keys = solve_keys(scene.model(prior_of_motion(), *[ROTATIONS] * residuals), scene.layout, keys, SCHEDULE).keys
        errors.append(scene.error_mm(keys))
    assert errors[1] < 0.4 * errors[0]


@pytest.mark.slow
def test_a_second_without_any_view_is_bridged():
    scene = Scene()
    blind = scene.keypoints.confidence.copy()
    blind[:, 21:40] = 0
    keypoints = Keypoints2D(scene.keypoints.xy, blind, JointSet.SMPL_24, 60.0)
    scene.term = ReprojectionTerm.of(scene.cameras, keypoints, np.full(24, NOISE_PX), np.zeros(1))
    keys = solve_keys(scene.model(prior_of_motion()), scene.layout, scene.start, SCHEDULE).keys
    keys = solve_keys(scene.model(prior_of_motion(), ROTATIONS), scene.layout, keys, SCHEDULE).keys
    points = pose(scene.subject, scene.poses(keys)).points
    assert np.isfinite(points).all()
    speed = np.linalg.norm(np.diff(points, axis=0), axis=-1) * 60
    assert speed.max() < 6.0
    assert np.linalg.norm(points - scene.points, axis=-1)[:15].mean() < 0.003


@pytest.mark.slow
def test_torch_equals_numpy():
    torch = pytest.importorskip("torch")
    results = []
    for like in (np.zeros(1), torch.zeros(1, dtype=torch.float64)):
        scene = Scene(like)
        keys = solve_sliding(scene.model(), scene.layout, scene.start, SCHEDULE).keys
        few = Schedule(SCHEDULE.scales, 4)  # before a detection may pass for an outlier in one and not in the other
        keys = solve_keys(scene.model(prior_of_motion(), ROTATIONS), scene.layout, keys, few).keys
        results.append(np.asarray(pose(scene.subject, scene.poses(keys)).points))
    # Matrices in single precision steer the steps: what is left is how near to the minimum they stop.
    np.testing.assert_allclose(results[1], results[0], atol=1e-4)


def test_fixed_keys_stay_and_the_others_move():
    scene = Scene()
    free = np.ones(scene.layout.num_keys, dtype=bool)
    free[[0, 3]] = False
    keys = solve_keys(scene.model(prior_of_motion(), ROTATIONS), scene.layout, scene.start, SCHEDULE, ~free).keys
    for name in ("z", "quat", "transl", "residual"):
        before, after = getattr(hemisphere_aligned(scene.start), name), getattr(keys, name)
        np.testing.assert_allclose(after[~free], before[~free], atol=1e-12)
    assert (np.linalg.norm(keys.transl - scene.start.transl, axis=1)[free] > 1e-4).all()


@pytest.mark.parametrize("residuals", [False, True])
def test_gradient_by_keys_equals_central_differences(residuals):
    scene = Scene()
    rng = np.random.default_rng(5)
    bend = 0.1 * rng.normal(size=(7, 21, 3)) if residuals else np.zeros((7, 21, 3))
    keys = Keyframes(scene.start.z, scene.start.quat, scene.start.transl, bend)
    rows, step = scene.layout.rows(), 1e-6

    def cost(state):
        return data_equations(scene.data(residuals=residuals), state, rows, 3.0)

    gradient = cost(keys).gradient
    for _ in range(4):
        direction = rng.normal(size=gradient.shape)
        ahead, behind = (cost(keys.retract(s * step * direction, LAYOUTS[residuals])).cost.sum() for s in (1, -1))
        numeric = (ahead - behind) / (2 * step)
        np.testing.assert_allclose((gradient * direction).sum(), numeric, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("free", "screw"), [(1, False), (3, False), (3, True)])
def test_windows_of_other_curves_slide_to_the_points(free: int, screw: bool):
    """Points of the very curve, n keys a window: the gradient is the slope, and the person is found."""
    scene, rng = Scene(), np.random.default_rng(3)
    layout = KeyframeLayout.even(FRAMES, 10 * free, free=free)
    steps = rng.normal(size=(2, layout.num_keys, ON_MANIFOLD.dof))
    truth = scene.truth.select(np.zeros(layout.num_keys, dtype=int)).retract(0.2 * steps[0], ON_MANIFOLD)
    start = truth.retract(0.03 * (np.arange(layout.num_keys) > 0)[:, None] * steps[1], ON_MANIFOLD)
    true = pose(scene.subject, replace(scene.model(), screw=screw).poses(truth, layout)).points
    cameras = scene.cameras
    px = project(cameras, true)
    keypoints = Keypoints2D(px, np.ones(px.shape[:-1]), JointSet.SMPL_24, 60.0)
    scene.term = ReprojectionTerm.of(cameras, keypoints, np.full(24, NOISE_PX), np.zeros(1))
    model, rows, step = replace(scene.model(), screw=screw), layout.rows(), 1e-6
    gradient = data_equations(model, start, rows, 3.0).gradient
    direction = rng.normal(size=gradient.shape)
    moved = (start.retract(s * step * direction, ON_MANIFOLD) for s in (1, -1))
    ahead, behind = (data_equations(model, some, rows, 3.0).cost.sum() for some in moved)
    np.testing.assert_allclose((gradient * direction).sum(), (ahead - behind) / (2 * step), rtol=1e-5)

    def error_m(keys: Keyframes) -> float:
        points = pose(scene.subject, model.poses(keys, layout)).points
        return float(np.linalg.norm(points - true, axis=-1).mean())

    assert error_m(solve_sliding(model, layout, start, SCHEDULE).keys) < 0.3 * error_m(start)


@pytest.mark.slow
def test_the_matrix_by_keys_is_close_to_the_exact_gauss_newton_matrix():
    scene = Scene()
    layout = scene.layout
    rows = layout.rows()
    data = data_equations(scene.data(residuals=False), scene.truth, rows, 3.0)
    window, time = layout.positions(layout.frames)
    curve = KeyframeCurve.through(scene.truth.of_windows(window), time[:, None], residuals=False)
    equations = frame_equations(scene.subject, curve.poses(scene.prior), scene.objective, 3.0)
    first = window == 0
    B = curve.jacobian(scene.prior, ON_MANIFOLD)[first]
    exact = np.einsum("fia,fij,fjb->ab", B, equations.hessian[first], B)[36:72, 36:72]
    found = data.normal_equations().diagonal[0][36:72, 36:72] - 1e-2 * np.eye(36)
    assert np.linalg.norm(found - exact) < 0.1 * np.linalg.norm(exact)


def test_a_solve_can_be_ended_before_every_linearisation():
    scene, calls = Scene(), []

    def alive() -> None:
        calls.append(None)
        if len(calls) == 2:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        solve_keys(scene.model(), scene.layout, scene.start, SCHEDULE, alive=alive)
