"""Random points in front of cameras, their noisy pixels and confidences, some missing."""

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.synthesis.embedded.demo import tripods
from solver_backend.types import JointSet, Keypoints2D

FRAMES, POINTS = 3, 17


def reprojection(seed=0):
    rng = np.random.default_rng(seed)
    cameras = tripods(np.array([0.0, 0.0, 1.0]))
    points = rng.uniform([-0.5, -0.5, 0.2], [0.5, 0.5, 1.8], (FRAMES, POINTS, 3))
    px = project(cameras, points)
    confidence = rng.uniform(0.2, 1.0, px.shape[:-1])
    confidence[0, 1, 4] = confidence[2, 2, 5] = 0
    keypoints = Keypoints2D(px + rng.normal(size=px.shape) * 6, confidence, JointSet.COCO_17, 60.0)
    return cameras, keypoints, points + 0.01 * rng.normal(size=points.shape)
