"""Landmarks: kinematics against a plain loop, Jacobians against central differences, NumPy against torch."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.exchange.body_layout import SMPL

FRAMES, POINTS, MARKS = 3, 7, 5


@dataclass(frozen=True)
class Case:
    body: Body
    landmarks: Landmarks
    state: dict[str, np.ndarray]
    rest: np.ndarray
    shapedirs: np.ndarray
    weights: np.ndarray
    mix: np.ndarray
    posedirs: np.ndarray


def random_body(rng: np.random.Generator, vertices: int = 40) -> Body:
    weights = rng.dirichlet(np.ones(24) * 0.2, size=vertices)
    regressor = rng.dirichlet(np.ones(vertices), size=24)
    return Body(
        "random", rng.normal(size=(vertices, 3)), 0.1 * rng.normal(size=(vertices, 3, 10)),
        0.02 * rng.normal(size=(vertices, 3, 207)), regressor, weights, SMPL, np.zeros((0, 3), int),
    )  # fmt: skip


def few(rng: np.random.Generator, shape: tuple[int, ...], share: float) -> np.ndarray:
    """Return a mask with about this share of ones."""
    return (rng.random(shape) < share).astype(float)


def make_case(kind: str) -> Case:
    """'mixed': rigid points, several a landmark; 'skin': own points, correctives at few joints; 'dense': at all.

    'joints': rigid points, one bone each.
    """
    rng = np.random.default_rng(5)
    weights = rng.dirichlet(np.ones(24) * 0.3, size=POINTS) * few(rng, (POINTS, 24), 0.2 if kind == "skin" else 1.0)
    weights[:, 16] += 0.1
    if kind == "joints":
        weights = np.eye(24)[rng.choice(24, POINTS)]
    weights /= weights.sum(1, keepdims=True)
    rest, shapedirs = rng.normal(size=(POINTS, 3)), 0.1 * rng.normal(size=(POINTS, 3, 10))
    posedirs = 0.05 * rng.normal(size=(POINTS, 3, 23, 9)) * few(rng, (POINTS, 1, 23, 1), 0.2 if kind == "skin" else 1.0)
    posedirs = posedirs.reshape(POINTS, 3, 207)
    if kind == "mixed":
        mix, posedirs = rng.dirichlet(np.ones(POINTS), size=MARKS), 0 * posedirs
        landmarks = Landmarks.of_points(tuple("abcde"), rest, shapedirs, weights, mix)
    elif kind == "joints":
        mix, posedirs = np.eye(POINTS), 0 * posedirs
        landmarks = Landmarks.of_points(tuple("abcdefg"), rest, shapedirs, weights)
    else:
        mix = np.eye(POINTS)
        landmarks = Landmarks.of_points(tuple("abcdefg"), rest, shapedirs, weights, posedirs=posedirs)
    state = {
        "betas": rng.normal(size=10),
        "global_orient": Rotation.random(FRAMES, random_state=1).as_matrix(),
        "local": Rotation.random(FRAMES * 21, random_state=2).as_matrix().reshape(FRAMES, 21, 3, 3),
        "transl": rng.normal(size=(FRAMES, 3)),
        "offsets": 0.1 * rng.normal(size=(len(mix), 3)),
    }
    return Case(random_body(rng), landmarks, state, rest, shapedirs, weights, mix, posedirs)


@pytest.fixture(params=["mixed", "skin", "dense", "joints"])
def case(request) -> Case:
    return make_case(request.param)


def points(body, landmarks, state):
    return pose_landmarks(body, landmarks, **state).points


def turned(matrices, tangent):
    return Rotation.from_rotvec(tangent).as_matrix() @ matrices


def central(function, size, step=1e-6):
    return np.stack([(function(e * step) - function(-e * step)) / (2 * step) for e in np.eye(size)], -1)


def test_skinning_equals_a_plain_loop(case):
    body, landmarks, state = case.body, case.landmarks, case.state
    rest = body.rest_joints(state["betas"])
    for f in range(FRAMES):
        local = np.concatenate([state["global_orient"][f][None], state["local"][f], np.tile(np.eye(3), (2, 1, 1))])
        feature = (local[1:] - np.eye(3)).reshape(-1)
        G, p = [local[0]], [rest[0] + state["transl"][f]]
        for j in range(1, 24):
            k = SMPL.parents[j]
            p.append(p[k] + G[k] @ (rest[j] - rest[k]))
            G.append(G[k] @ local[j])
        mixed = np.zeros((POINTS, 3))
        for i in range(POINTS):
            x = case.rest[i] + case.shapedirs[i] @ state["betas"] + case.posedirs[i] @ feature
            mixed[i] = sum(case.weights[i, b] * (p[b] + G[b] @ (x - rest[b])) for b in range(24))
        blend = np.einsum("lp,pb,bij->lij", case.mix, case.weights, np.stack(G))
        expected = case.mix @ mixed + np.einsum("lij,lj->li", blend, state["offsets"])
        np.testing.assert_allclose(points(body, landmarks, state)[f], expected, atol=1e-12)


def test_jacobians_equal_central_differences(case):
    body, landmarks, state = case.body, case.landmarks, case.state
    posed = pose_landmarks(body, landmarks, **state, jacobian=True)
    for k in range(22):

        def move(d, k=k):
            if k == 0:
                return points(body, landmarks, {**state, "global_orient": turned(state["global_orient"], d)})
            local = state["local"].copy()
            local[:, k - 1] = turned(local[:, k - 1], d)
            return points(body, landmarks, {**state, "local": local})

        numeric = central(move, 3)
        np.testing.assert_allclose(
            posed.by_rotations[..., 3 * k : 3 * k + 3], numeric, atol=1e-7 * max(1, np.abs(numeric).max())
        )
    numeric = central(lambda d: points(body, landmarks, {**state, "betas": state["betas"] + d}), 10)
    np.testing.assert_allclose(posed.by_betas, numeric, atol=1e-8)
    for mark in range(len(landmarks)):

        def shift(d, mark=mark):
            offsets = state["offsets"].copy()
            offsets[mark] += d
            return points(body, landmarks, {**state, "offsets": offsets})[:, mark]

        np.testing.assert_allclose(posed.by_offsets[:, mark], central(shift, 3), atol=1e-8)


def test_torch_equals_numpy(case):
    torch = pytest.importorskip("torch")
    body, landmarks, state = case.body, case.landmarks, case.state
    posed = pose_landmarks(body, landmarks, **state, jacobian=True)
    other = pose_landmarks(body, landmarks, **{k: torch.as_tensor(v) for k, v in state.items()}, jacobian=True)
    for name in ("points", "by_rotations", "by_betas", "by_offsets"):
        np.testing.assert_allclose(getattr(other, name).numpy(), getattr(posed, name), atol=1e-12)


def test_batch_equals_frame_by_frame(case):
    body, landmarks, state = case.body, case.landmarks, case.state
    whole = points(body, landmarks, state)
    for f in range(FRAMES):
        one = {k: (v[f : f + 1] if k in ("global_orient", "local", "transl") else v) for k, v in state.items()}
        np.testing.assert_allclose(points(body, landmarks, one)[0], whole[f], atol=1e-13)


def test_long_takes_equal_their_parts(case):
    """More frames than are computed at a time, the last part shorter."""
    state = {
        k: np.concatenate([v] * 60) if k in ("global_orient", "local", "transl") else v for k, v in case.state.items()
    }
    posed = pose_landmarks(case.body, case.landmarks, **state, jacobian=True)
    part = pose_landmarks(case.body, case.landmarks, **case.state, jacobian=True)
    np.testing.assert_allclose(posed.by_rotations[177:], part.by_rotations, atol=1e-12)


def test_fewer_rotations_are_the_first_columns(case):
    whole = pose_landmarks(case.body, case.landmarks, **case.state, jacobian=True)
    few = pose_landmarks(case.body, case.landmarks, **case.state, jacobian=True, num_rotations=5)
    np.testing.assert_allclose(few.by_rotations, whole.by_rotations[..., :15], atol=1e-13)


def test_mixed_points_have_no_correctives():
    skin = make_case("skin")
    with pytest.raises(ValueError, match="between bones cannot have pose correctives"):
        Landmarks.of_points(("a",), skin.rest, skin.shapedirs, skin.weights, np.full((1, 7), 1 / 7), skin.posedirs)
