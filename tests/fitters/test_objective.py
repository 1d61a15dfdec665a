"""Terms that this file makes up are minimised with the others: no solver knows which terms there are."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from solver_backend.body.state_layout import TRANSL, StateLayout
from solver_backend.fitters.keyframes.normal_equations import BundleObjective, KeyframeNormalEquations, MotionPrior
from solver_backend.fitters.keyframes.optimise import Schedule, solve_keys
from solver_backend.fitters.model.subject import FrameObjective, FrameStates, Keyframes, frame_equations, pose
from solver_backend.fitters.single_frame import fit_frames, posed
from solver_backend.geometry.rotations import left_jacobian_inverse_so3, log_so3, matrix_from_quat
from solver_backend.residuals.pose_mixture import PoseMixtureTerm
from solver_backend.residuals.positions import RelativePositionTerm
from solver_backend.residuals.terms import PointEvidence, PoseEvidence
from solver_backend.solver.levenberg_marquardt import LMSettings
from tests.support.layouts import POSE, WHOLE
from tests.support.stick_scene import StickScene as Scene

HEIGHT_M = 1.4
SMOOTH = MotionPrior(10 / 60, accel_sigma=20.0, angular_sigma=90.0, latent_sigma=60.0)


@dataclass(frozen=True)
class Ceiling:
    """A point term: ``E = w/2 sum_i max(0, z_i - h)²``."""

    weight: float

    def __call__(self, points: np.ndarray, scale: float) -> PointEvidence:
        above = np.maximum(points[..., 2] - HEIGHT_M, 0.0)
        gradient, information = np.zeros_like(points), np.zeros((*points.shape, 3))
        gradient[..., 2] = self.weight * above
        information[..., 2, 2] = self.weight * (above > 0)
        return PointEvidence(0.5 * self.weight * (above**2).sum(-1), gradient, information)

    def select(self, frames: Any) -> "Ceiling":
        return self

    def astype(self, precision: Any) -> "Ceiling":
        return replace(self, weight=precision(self.weight))


@dataclass(frozen=True)
class Bent:
    """A pose term: ``E = w/2 |x - a|²`` of the rotation vectors x of all joints."""

    weight: float
    target: np.ndarray
    """(21, 3)."""

    def __call__(self, local: np.ndarray) -> PoseEvidence:
        off = log_so3(local) - self.target
        gradient = np.swapaxes(left_jacobian_inverse_so3(log_so3(local)), -1, -2) @ (self.weight * off)[..., None]
        cost = 0.5 * self.weight * (off**2).sum((1, 2))
        return PoseEvidence(cost, gradient.reshape(len(off), -1), np.full((len(off), 1), self.weight))

    def select(self, frames: Any) -> "Bent":
        return self

    def astype(self, precision: Any) -> "Bent":
        return replace(self, target=self.target.astype(precision))

    def hessian(self, factors: np.ndarray) -> np.ndarray:
        return factors[..., None] * np.eye(63, dtype=factors.dtype)


@dataclass(frozen=True)
class Level:
    """A term over keys: ``E = w/2 sum_k (z_k - h)²`` of the roots' heights."""

    weight: float

    def part(self, keys: slice) -> "Level":
        return self

    def cost(self, keys: Keyframes, free: StateLayout) -> np.ndarray:
        return 0.5 * self.weight * (keys.transl[:, 2] - HEIGHT_M) ** 2

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        for key, height in enumerate(keys.transl[:, 2]):
            block, column = key // 2, (key % 2) * equations.dof + WHOLE[TRANSL].stop - 1
            equations.g[block, column] += self.weight * (height - HEIGHT_M)
            equations.diagonal[block, column, column] += self.weight


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene()


def states(scene: Scene) -> FrameStates:
    keys = scene.truth
    return FrameStates(keys.z, matrix_from_quat(keys.quat), keys.transl)


def test_equations_of_a_frame_are_the_sum_over_all_terms(scene):
    frames = posed(scene.prior, states(scene))
    term = scene.term.select(scene.layout.key_times.astype(int))
    poses = PoseMixtureTerm(), Bent(3.0, np.ones((21, 3)))
    objective = replace(scene.objective, points=(term, Ceiling(40.0)), poses=poses)
    whole = frame_equations(scene.subject, frames, objective, 3.0)
    parts = [
        frame_equations(scene.subject, frames, replace(objective, points=points, poses=poses), 3.0)
        for points, poses in (((term,), (objective.poses[0],)), ((Ceiling(40.0),), (objective.poses[1],)))
    ]
    for name in ("cost", "gradient", "hessian"):
        total = sum(getattr(part, name) for part in parts)
        np.testing.assert_allclose(getattr(whole, name), total, rtol=1e-10, atol=1e-9 * np.abs(total).max())
    direction = np.random.default_rng(0).normal(size=(len(frames.transl), POSE.dof))
    costs = [frame_equations(scene.subject, frames.retract(s * 1e-6 * direction), objective, 3.0).cost for s in (1, -1)]
    np.testing.assert_allclose((whole.gradient * direction).sum(1), (costs[0] - costs[1]) / 2e-6, rtol=2e-5)


def test_a_term_that_leaves_the_place_open_holds_the_pose_alone(scene):
    frames = posed(scene.prior, states(scene))
    points = pose(scene.subject, frames).points
    precision = np.broadcast_to(np.diag([400.0, 400.0, 25.0]), (*points.shape, 3))
    lifted = RelativePositionTerm.of(points + 0.05 * np.sin(points), precision, 0.5, points)
    objective = FrameObjective((Ceiling(0.0),), relative=(lifted,))
    found = frame_equations(scene.subject, frames, objective, 3.0)
    moving = np.zeros((len(points), POSE.dof))
    moving[:, -3:] = 1.0
    np.testing.assert_allclose((found.gradient * moving).sum(1), 0.0, atol=1e-8)
    np.testing.assert_allclose(np.einsum("fi,fij->fj", moving, found.hessian), 0.0, atol=1e-8)
    direction = np.random.default_rng(0).normal(size=moving.shape)
    costs = [frame_equations(scene.subject, frames.retract(s * 1e-6 * direction), objective, 3.0).cost for s in (1, -1)]
    np.testing.assert_allclose((found.gradient * direction).sum(1), (costs[0] - costs[1]) / 2e-6, rtol=2e-5)
    assert (np.linalg.eigvalsh(found.hessian) > -1e-6).all()


def test_frames_obey_terms_on_points_and_on_poses(scene):
    start = states(scene)
    term = scene.term.select(scene.layout.key_times.astype(int))
    plain = replace(scene.objective, points=(term,))
    low = replace(plain, points=(term, Ceiling(1e9)))
    bent = replace(plain, poses=(*plain.poses, Bent(1e6, np.full((21, 3), 0.2))))

    def solved(objective):
        found = fit_frames(scene.subject, scene.prior, objective, start, (1e3,), LMSettings(30))
        return posed(scene.prior, found.state)

    def highest(frames) -> float:
        return float(pose(scene.subject, frames).points[..., 2].max())

    def off(frames) -> float:
        return float(np.abs(log_so3(frames.local) - 0.2).mean())

    assert highest(solved(plain)) > HEIGHT_M + 0.1 and highest(solved(low)) < HEIGHT_M + 0.002
    assert off(solved(bent)) < 0.8 * off(solved(plain))


def test_keys_obey_a_term_over_keys(scene):
    keys = {}
    for name, terms in (("plain", ()), ("level", (Level(1e9),))):
        model = replace(scene.model(), objective=BundleObjective(scene.objective, (SMOOTH, *terms)))
        keys[name] = solve_keys(model, scene.layout, scene.start, Schedule((12.0, 3.0), 8)).keys
    assert np.abs(keys["plain"].transl[:, 2] - HEIGHT_M).min() > 0.1
    np.testing.assert_allclose(keys["level"].transl[:, 2], HEIGHT_M, atol=1e-3)


def test_made_up_terms_are_solved_in_single_precision_with_the_others(scene):
    frames = FrameObjective((scene.term, Ceiling(40.0)), (PoseMixtureTerm(), Bent(3.0, np.ones((21, 3)))))
    model = replace(scene.model(), objective=BundleObjective(frames, (SMOOTH,))).astype(np.float32)
    cost, form = model.equations(scene.layout.rows(), scene.start.astype(np.float32), 3.0)
    assert cost.dtype == form().g.dtype == np.float32
