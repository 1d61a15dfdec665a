"""Solves with a prior of another size, on a body with joints that no prior covers, and on one that lacks an arm."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver_backend.body.anatomy import LandmarkBuilder
from solver_backend.body.body import Body
from solver_backend.body.keypoints import joint_landmarks, keypoint_rules
from solver_backend.exchange.body_layout import SMPL, BodyLayout
from solver_backend.exchange.errors import BodyInvalid, PriorInvalid
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.measurements.markers import measure_landmarks
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.pipeline import solve_problem
from solver_backend.fitters.problem import Problem
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import SPoser, load_sposer
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.short_solves import cut
from tests.support.stick_body import stick_body

FRAMES, FPS = 61, 60.0
QUICK = SolveSettings(contacts=False, iterations=6)
TAIL, WINGS = [f"tail{i}" for i in range(8)], [f"{side}_wing{i}" for side in ("left", "right") for i in range(4)]
CHAINS = ((TAIL, "pelvis", (0.0, -0.05, -0.12)), (WINGS[:4], "spine3", (0.15, 0.1, -0.1)),
          (WINGS[4:], "spine3", (-0.15, 0.1, -0.1)))  # fmt: skip
METHODS = ["global", *(pytest.param(name, marks=pytest.mark.slow) for name in ("sliding", "frame"))]
ONE_ARM = SMPL.without(("right_shoulder",), "one arm")


def dragon() -> Body:
    """Return a stick figure of 40 joints: SMPL's 24, all of which turn, a tail and two wings."""
    plain = stick_body()
    joints, parents, groups = [*SMPL.joints], [*SMPL.parents], [*SMPL.groups]
    rest = [*plain.joints_template]
    for names, root, step in CHAINS:
        above = joints.index(root)
        for name in names:
            rest.append(rest[above] + np.array(step))
            joints.append(name)
            parents.append(above)
            groups.append(names[0].rstrip("0"))
            above = len(joints) - 1
    return sticks(BodyLayout("dragon", tuple(joints), tuple(parents), tuple(groups)), np.array(rest))


def one_armed() -> Body:
    kept = [SMPL.joints.index(name) for name in ONE_ARM.joints]
    return sticks(ONE_ARM, stick_body().joints_template[kept])


def sticks(layout: BodyLayout, rest: np.ndarray) -> Body:
    count = layout.num_joints
    eye, still = np.eye(count), np.zeros((count, 3, 9 * (count - 1)))
    shapedirs = np.zeros((count, 3, 10))
    shapedirs[..., 0] = 0.04 * rest
    return Body(layout.name, rest, shapedirs, still, eye, eye, layout, np.zeros((0, 3), int))


def moving(body: Body, swinging: tuple[str, ...] = ()) -> tuple[PosedFrames, Subject]:
    """Return poses of the prior's that change smoothly, with some joints that swing beside it."""
    prior, t = prior_on_body(load_sposer(), body.layout), np.linspace(0.0, 1.0, FRAMES)
    ends = prior.encode(prior.sample(2, seed=4))
    z = (1 - t)[:, None] * ends[0] + t[:, None] * (0.6 * ends[0] + 0.4 * ends[1])
    z -= z.mean(axis=1, keepdims=True)
    local = prior.decode(z / np.linalg.norm(z, axis=1, keepdims=True))
    for number, name in enumerate(swinging):
        turn = 0.5 * np.sin(2 * np.pi * (0.7 * t + 0.1 * number))[:, None] * [1.0, 0.0, 0.4]
        local[:, body.layout.solved.index(name)] = exp_so3(turn)
    upright = np.tile(exp_so3(np.array([np.pi / 2, 0.0, 0.0])), (FRAMES, 1, 1))
    transl = np.stack([0.8 * t, 0.2 * t, np.full(FRAMES, 0.95)], axis=1)
    landmarks = joint_landmarks(body, body.layout)
    return PosedFrames(upright, local, transl), Subject(body, landmarks, np.zeros(10), np.zeros((len(landmarks), 3)))


def solved(body: Body, points: np.ndarray, settings: SolveSettings) -> Any:
    measured = measure_landmarks(joint_landmarks(body, body.layout), points, FPS, np.zeros(1), sigma_m=0.005)
    return solve_problem(Problem.of(body, load_sposer(), measured), settings).motion


@pytest.mark.parametrize("method", METHODS)
def test_joints_that_no_prior_covers_follow_what_is_seen_of_them_and_rest_where_nothing_is(method):
    body = dragon()
    assert body.layout.num_joints == 40
    truth, person = moving(body, tuple(TAIL[:-1]))
    points = pose(person, truth).points + 0.002 * np.random.default_rng(0).normal(size=(FRAMES, 40, 3))
    points[:, [body.layout.joints.index(name) for name in WINGS]] = np.nan
    motion = solved(body, points, replace(QUICK, method=method))
    assert motion.body_layout == body.layout and motion.joints.shape == (FRAMES, 40, 3)
    tail = [body.layout.joints.index(name) for name in TAIL]
    wings = [body.layout.joints.index(name) - 1 for name in WINGS]
    off = np.linalg.norm(motion.joints - pose(person, truth).points, axis=-1)
    assert np.median(off[:, tail]) < 0.01 and off[:, :24].mean() < 0.02
    at_rest = np.linalg.norm(motion.body_pose.reshape(FRAMES, 39, 3)[:, wings], axis=-1)
    assert at_rest.max() < 0.02


def test_a_joint_of_the_bodys_own_is_a_keypoint_by_its_name():
    body, names = dragon(), ("left_knee", "tail3", "left_wing0")
    built = LandmarkBuilder(body, keypoint_rules()).build(names)
    np.testing.assert_allclose(built.anchors.sum(axis=1), body.joints_template[[*body.layout.numbers(*names)]])
    with pytest.raises(BodyInvalid, match="dragon has no horn"):
        LandmarkBuilder(body, keypoint_rules()).build(("horn",))


def test_a_body_without_an_arm_is_solved_and_its_motion_comes_back(tmp_path):
    body = one_armed()
    truth, person = moving(body)
    exact = pose(person, truth).points
    points = exact + 0.002 * np.random.default_rng(1).normal(size=exact.shape)
    motion = solved(body, points, QUICK)
    assert motion.joints.shape == (FRAMES, 20, 3) and motion.joint_covariance.shape == (FRAMES, 20, 6)
    assert np.linalg.norm(motion.joints - exact, axis=-1).mean() < 0.01
    again = read_motion(write_motion(tmp_path / "one_arm.npz", motion))
    assert again.body_layout == body.layout.recorded
    np.testing.assert_allclose(again.joints, motion.joints, atol=1e-6)


def narrow_prior(width: int = 24) -> SPoser:
    """Return a prior of shorter codes: those of SPoser in a subspace."""
    shipped, rng = load_sposer(), np.random.default_rng(2)
    # Orthonormal columns of zero mean: unit codes stay unit vectors of zero mean.
    centred = rng.normal(size=(shipped.latent_dim, width))
    wide = np.linalg.qr(centred - centred.mean(axis=0))[0]

    class Narrow(SPoser):
        name = "narrow"

        @property
        def latent_dim(self):
            return width

        def encode(self, rotations):
            return spherical_normalisation(shipped.encode(rotations) @ wide)

        def decode(self, z):
            return shipped.decode(z @ wide.T.astype(z.dtype))

        def decode_with_vjp(self, z):
            rotations, vjp = shipped.decode_with_vjp(z @ wide.T)
            return rotations, lambda cotangent: vjp(cotangent) @ wide

        def decode_with_jacobian(self, z):
            rotations, by_code = shipped.decode_with_jacobian(z @ wide.T.astype(z.dtype))
            return rotations, by_code @ wide.astype(z.dtype)

    return Narrow(shipped._encoder, shipped._decoder, 2.0 * shipped.residual_sigma, {"sha256": "narrow"})


@pytest.mark.parametrize("method", METHODS)
def test_a_prior_of_another_latent_size_solves_a_capture(method):
    capture = cut(demo_capture(), 100, 161)
    prior = narrow_prior()
    assert prior.encode(load_sposer().sample(3, seed=0)).shape == (3, 24)
    motion = solve(capture, SolveSettings(method=method, iterations=6), prior=prior).motion
    error = np.linalg.norm(motion.joints - capture.truth["joints"], axis=-1)
    assert error.mean() < (0.05 if method == "global" else 0.1)
    assert motion.provenance["prior"] == {"name": "narrow", "weights": "narrow"}


def broken(prior: SPoser, **change: Any) -> SPoser:
    made = type("Broken", (SPoser,), {"name": "broken", **change})
    return made(prior._encoder, prior._decoder, prior.residual_sigma, prior.metadata)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"joints": property(lambda self: SMPL.joints[1:20])},
            r"residual_sigma of the prior broken has shape \(21, 3\)",
        ),
        ({"latent_dim": 30}, r"prior broken cannot encode and decode the rest pose: .*\(N, 30\), not \(1, 32\)"),
        ({"joints": ("tentacle",)}, "broken models none of the joints of SMPL"),
        ({"encode": lambda self, rotations: np.ones((len(rotations), 32))}, "not unit vectors with zero mean"),
        (
            {"decode": lambda self, z: np.zeros((len(z), 20, 3, 3))},
            r"decode of the prior broken has shape \(1, 20, 3, 3\)",
        ),
    ],
)
def test_a_prior_that_does_not_fit_is_refused_by_name(change, message):
    with pytest.raises(PriorInvalid, match=message):
        solve(cut(demo_capture(), 100, 110), QUICK, prior=broken(load_sposer(), **change))
