"""The scale of a world by a stature: right in people who hang their arms, though bodies at rest spread them."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.errors import JobInvalid
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.recognition.person_scale import scale_from_stature
from solver_backend.synthesis.simulation.cast import cast_person
from solver_backend.types import JointSet
from tests.support.walking_take import walk

HANGING_RAD = 0.27  # By which collar bones turn down where arms hang: 0.23 to 0.28 in four of five recorded motions.


def scale_of(seed: int, joint_set: JointSet) -> float:
    """Return the scale that is found of somebody who walks, by the true one."""
    take = walk(20)
    take.rotations[:, 13], take.rotations[:, 14] = exp_so3(np.array([[0, 0, -HANGING_RAD], [0, 0, HANGING_RAD]]))
    person = cast_person(take, np.random.default_rng(seed))
    rest = person.body.v_template + person.body.shapedirs[..., :10] @ person.betas
    points = 3.3 * person.landmarks(joint_set).points
    return 3.3 * scale_from_stature(points, joint_set, float(np.ptp(rest[:, 1])))[0]


@pytest.mark.parametrize("joint_set", [JointSet.BODY_25, JointSet.COCO_17])
def test_walks_have_the_scale_of_their_statures(joint_set: JointSet) -> None:
    scales = np.array([scale_of(seed, joint_set) for seed in range(8)])
    assert abs(scales.mean() - 1) < 0.006
    assert np.abs(scales - 1).max() < 0.03


def test_a_person_in_one_place_has_no_scale() -> None:
    points = np.tile([0.3, 0.2, 1.0], (6, JointSet.COCO_17.num_keypoints, 1))
    with pytest.raises(JobInvalid, match="are at one point"):
        scale_from_stature(points, JointSet.COCO_17, 1.75)
