"""The whole skin: against landmarks on it, correctives on and off, rest pose, moved and turned as a whole."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics, with_resting_hands
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.body.mesh import pose_mesh

FRAMES = 18


@pytest.fixture(scope="module")
def body():
    plain = load_body()
    rng = np.random.default_rng(3)
    mask = (plain.weights[:, 1:] > 0) & (plain.weights[:, 1:] < 1)
    posedirs = 0.003 * rng.normal(size=(*plain.v_template.shape, 23, 9)) * mask[:, None, :, None]
    return dataclasses.replace(plain, posedirs=posedirs.reshape(*plain.v_template.shape, 207))


@pytest.fixture(scope="module")
def state():
    rng = np.random.default_rng(4)
    local = Rotation.from_rotvec(0.5 * rng.normal(size=(FRAMES * 21, 3))).as_matrix().reshape(FRAMES, 21, 3, 3)
    root = Rotation.random(FRAMES, random_state=1).as_matrix()
    return {"betas": rng.normal(size=10), "root": root, "local": local, "transl": rng.normal(size=(FRAMES, 3))}


@pytest.mark.parametrize("correctives", [True, False])
def test_vertices_as_landmarks_are_the_mesh(body, state, correctives):
    chosen = np.arange(0, len(body.v_template), 131)
    posedirs = body.posedirs[chosen] if correctives else None
    landmarks = Landmarks.of_points(
        tuple(map(str, chosen)),
        body.v_template[chosen],
        body.shapedirs[chosen],
        body.weights[chosen],
        posedirs=posedirs,
    )
    posed = pose_landmarks(body, landmarks, state["betas"], state["root"], state["local"], state["transl"])
    mesh = pose_mesh(body, **state, correctives=correctives)
    assert mesh.shape == (FRAMES, len(body.v_template), 3)
    np.testing.assert_allclose(mesh[:, chosen], posed.points, atol=1e-12)


def test_correctives_move_only_what_they_are_for(body, state):
    moved = np.linalg.norm(pose_mesh(body, **state) - pose_mesh(body, **state, correctives=False), axis=-1)
    has = np.abs(body.posedirs[..., : 9 * 21]).max((1, 2)) > 0
    assert (moved[:, has].max(0) > 1e-4).all() and moved[:, ~has].max() < 1e-12


def test_rest_pose_is_the_shaped_template(body, state):
    still = np.tile(np.eye(3), (1, 21, 1, 1))
    mesh = pose_mesh(body, state["betas"], np.eye(3)[None], still, np.zeros((1, 3)))
    np.testing.assert_allclose(mesh[0], body.v_template + body.shapedirs @ state["betas"], atol=1e-12)


def test_a_rigid_motion_of_the_root_moves_everything_alike(body, state):
    turn, shift = Rotation.random(random_state=7).as_matrix(), np.array([0.3, -1.0, 2.0])
    pelvis = body.rest_joints(state["betas"])[0] + state["transl"]
    moved = {
        **state,
        "root": turn @ state["root"],
        "transl": (pelvis @ turn.T + shift) - body.rest_joints(state["betas"])[0],
    }
    np.testing.assert_allclose(pose_mesh(body, **moved), pose_mesh(body, **state) @ turn.T + shift, atol=1e-12)


def test_torch_equals_numpy(body, state):
    torch = pytest.importorskip("torch")
    mesh = pose_mesh(body, **{k: torch.as_tensor(v) for k, v in state.items()})
    np.testing.assert_allclose(mesh.numpy(), pose_mesh(body, **state), atol=1e-12)


def test_resting_hands_are_appended_where_none_are_given(body, state):
    mean = np.array([[0.1, 0.2, 0.3], [0.3, -0.2, 0.1]])
    hands, relaxed = Rotation.from_rotvec(mean).as_matrix(), dataclasses.replace(body, hands_mean=mean)
    filled = with_resting_hands(relaxed, state["local"])
    np.testing.assert_allclose(filled[:, 21:], np.broadcast_to(hands, (FRAMES, 2, 3, 3)), atol=1e-14)
    assert with_resting_hands(relaxed, filled) is filled
    assert with_resting_hands(body, state["local"]) is state["local"]
    args = (state["betas"], state["root"])
    np.testing.assert_allclose(
        pose_mesh(relaxed, *args, state["local"], state["transl"]), pose_mesh(body, *args, filled, state["transl"])
    )
    np.testing.assert_allclose(
        forward_kinematics(relaxed, *args, state["local"], state["transl"]).G[:, 22:],
        forward_kinematics(body, *args, state["local"], state["transl"]).G[:, 20:22] @ hands,
    )
