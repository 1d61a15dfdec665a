"""A lifted take: people have no side that the lifter prefers."""

from dataclasses import replace

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.rest_skeleton import MIRROR
from solver_backend.priors.lifted_take import bridge_gaps, lift_take
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Cameras, Keypoints2D
from tests.support.limb_errors import LIMBS
from tests.support.one_view_situations import filmed_walk

SIDEWAYS = np.array([-1.0, 1.0, 1.0])


def lifted_joints(camera: Cameras, keypoints: Keypoints2D, up: np.ndarray) -> np.ndarray:
    """Return (F, 24, 3) joints about the pelvis in the camera's axes."""
    body = load_body()
    take = lift_take(camera, keypoints, body, prior_on_body(load_sposer(), body.layout), up)
    still = np.zeros((len(take.local), 3))
    joints = np.asarray(forward_kinematics(body, np.zeros(10), take.view.root, take.local, still).joints)
    return joints - joints[:, :1]


def test_a_mirrored_picture_is_lifted_to_the_mirrored_pose() -> None:
    cameras, keypoints = filmed_walk(24).require_views()
    camera = replace(cameras.subset([0]), distortion=np.zeros((1, 8)))
    seen, up = keypoints.views([0]), camera.R[0, :, 2]
    columns = list(seen.joint_set.mirrored(seen.xy.shape[2]))
    xy = [2.0 * camera.K[0, 0, 2], 0.0] + seen.xy[:, :, columns] * [-1.0, 1.0]
    mirrored = replace(seen, xy=xy, confidence=seen.confidence[:, :, columns])
    first = lifted_joints(camera, seen, up)
    second = (lifted_joints(camera, mirrored, SIDEWAYS * up) * SIDEWAYS)[:, list(MIRROR)]
    off = np.linalg.norm(first - second, axis=-1)[:, LIMBS]
    assert 1000.0 * off.mean() < 5.0


def test_short_gaps_are_bridged_and_long_ones_and_ends_stay() -> None:
    frames = np.arange(12.0)
    image = np.stack([frames, 2.0 * frames], axis=1)[:, None] * np.ones((1, 3, 1))
    confidence = np.ones((12, 3))
    confidence[4:6, 0] = confidence[2:9, 1] = confidence[:2, 2] = confidence[10:, 2] = 0.0
    found, sure = bridge_gaps(np.where(confidence[..., None] > 0, image, np.nan), confidence, 3)
    np.testing.assert_allclose(found[:, 0], image[:, 0])
    assert (sure[4:6, 0] > 0).all() and (sure[4:6, 0] < 1).all()
    assert (sure[:, 1:] == confidence[:, 1:]).all()
