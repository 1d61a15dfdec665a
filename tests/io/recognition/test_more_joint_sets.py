"""Sets of other data and models are recognised, and an order that none has is doubted."""

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.io.recognition.joint_sets import choose_joint_set
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import JointSet

SETS = (
    JointSet.MPII_16, JointSet.LSP_14, JointSet.CROWDPOSE_14, JointSet.AIC_14, JointSet.PANOPTIC_19,
    JointSet.COCO_WHOLEBODY_133,
)  # fmt: skip


def seen(joint_set: JointSet) -> np.ndarray:
    """Return (N, K, 2) pixels of a person in a T-pose, where the demo's stands, in its views, with noise."""
    demo = demo_capture(12)
    rest = keypoint_landmarks(load_body(), joint_set).anchors.sum(axis=1)
    upright = np.stack([rest[:, 0], -rest[:, 2], rest[:, 1]], axis=-1)
    places = demo.truth["joints"][:, :1] + upright - upright.mean(0)
    cameras = demo.cameras
    pixels = project(cameras, places.reshape(-1, 3))
    pixels = pixels.reshape(-1, len(joint_set.keypoints), 2)
    return pixels + np.random.default_rng(0).normal(0, 4, pixels.shape)


@pytest.mark.parametrize("joint_set", SETS)
def test_a_set_is_recognised(joint_set):
    xy = seen(joint_set)
    chosen, _, problems = choose_joint_set(xy, np.ones(xy.shape[:2]), None, None)
    assert (chosen, problems) == (joint_set, ())


@pytest.mark.parametrize("joint_set", [JointSet.PANOPTIC_19, JointSet.MPII_16])
def test_another_order_of_as_many_points_is_doubted(joint_set):
    xy = seen(joint_set)
    order = np.random.default_rng(1).permutation(xy.shape[1])
    _, _, problems = choose_joint_set(xy[:, order], np.ones(xy.shape[:2]), None, None)
    assert problems == (diagnostic("joint_set_uncertain", joint_set=joint_set.value, reason="anatomy"),)
