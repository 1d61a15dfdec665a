"""The lifter: heading and place do not matter, what is missing is said, and it starts close to the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.lifter import DEFAULT_WEIGHTS, POINTS, load_lifter
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.weights import PriorWeights, read_weights, write_weights
from solver_backend.types import JointSet


@pytest.fixture(scope="module")
def body() -> Body:
    return load_body()


def people(body: Body, joint_set: JointSet, count: int = 40) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """Return points of a person in plausible poses, their names, and the true joints."""
    rng = np.random.default_rng(5)
    prior, landmarks = load_sposer(), keypoint_landmarks(body, joint_set)
    standing = prior.encode(np.broadcast_to(np.eye(3), (1, 21, 3, 3)))
    local = prior.decode(spherical_normalisation(standing + 0.1 * rng.standard_normal((count, 32))))
    root = exp_so3(rng.standard_normal((count, 3)))
    posed = pose_landmarks(body, landmarks, np.zeros(10), root, local, rng.standard_normal((count, 3)))
    return posed.points, landmarks.names, posed.skeleton.joints


def test_turned_and_moved_people_have_the_same_pose(body: Body) -> None:
    points, names, _ = people(body, JointSet.BODY_25)
    seen = np.ones(points.shape[:2], dtype=bool)
    R, t = exp_so3(np.array([0.4, -1.9, 0.7])), np.array([3.0, -8.0, 0.5])
    one, other = load_lifter()(points, seen, names), load_lifter()(points @ R.T + t, seen, names)
    np.testing.assert_allclose(other.z, one.z, atol=1e-9)
    np.testing.assert_allclose(other.root, R @ one.root, atol=1e-9)
    np.testing.assert_allclose(other.pelvis, one.pelvis @ R.T + t, atol=1e-9)
    np.testing.assert_allclose(other.betas, one.betas, atol=1e-9)


@pytest.mark.parametrize("joint_set", [JointSet.BODY_25, JointSet.COCO_17, JointSet.HALPE_26, JointSet.H36M_17])
def test_joints_are_near_the_truth(body: Body, joint_set: JointSet) -> None:
    points, names, joints = people(body, joint_set)
    lifted = load_lifter()(points, np.ones(points.shape[:2], dtype=bool), names)
    assert lifted.usable.all()
    local = load_sposer().decode(lifted.z)
    posed = pose_landmarks(
        body, keypoint_landmarks(body, joint_set), np.zeros(10), lifted.root, local,
        lifted.pelvis - body.rest_joints(np.zeros(10))[0],
    )  # fmt: skip
    assert np.linalg.norm(posed.skeleton.joints[:, :22] - joints[:, :22], axis=-1).mean() < 0.06


def test_a_person_without_shoulder_is_not_lifted(body: Body) -> None:
    points, names, _ = people(body, JointSet.BODY_25, 3)
    seen = np.ones(points.shape[:2], dtype=bool)
    seen[1, names.index("left_shoulder")] = False
    seen[2, names.index("left_wrist")] = False
    lifted = load_lifter()(points, seen, names)
    assert lifted.usable.tolist() == [True, False, True]
    assert np.isfinite(lifted.z).all() and np.isfinite(lifted.root).all()


def test_markers_without_keypoint_names_are_not_lifted(body: Body) -> None:
    points, _, _ = people(body, JointSet.BODY_25, 2)
    names = tuple(f"marker_{i}" for i in range(points.shape[1]))
    assert not load_lifter()(points, np.ones(points.shape[:2], dtype=bool), names).usable.any()


def test_torch_equals_numpy(body: Body) -> None:
    points, names, _ = people(body, JointSet.BODY_25, 4)
    seen = np.ones(points.shape[:2], dtype=bool)
    one = load_lifter()(points, seen, names)
    other = load_lifter()(torch.as_tensor(points), torch.as_tensor(seen), names)
    for name in ("z", "root", "pelvis", "betas"):
        np.testing.assert_allclose(np.asarray(getattr(other, name)), getattr(one, name), atol=1e-9)


@pytest.mark.parametrize("key", ["sposer_sha256", "points"])
def test_weights_for_other_codes_or_points_are_refused(tmp_path: Path, key: str) -> None:
    weights = read_weights(DEFAULT_WEIGHTS, "lifter")
    path = tmp_path / "other.npz"
    write_weights(path, PriorWeights("lifter", weights.arrays, {**weights.metadata, key: "another"}))
    with pytest.raises(WeightsInvalid, match="other codes or points"):
        load_lifter(path)


def test_every_vocabulary_has_a_trunk() -> None:
    for joint_set in JointSet:
        assert set(POINTS[:4]) <= set(joint_set.keypoints), joint_set
