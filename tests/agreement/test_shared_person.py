"""Of several people, all views compare the same one in each frame."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.agreement.evidence import keep_shared
from solver_backend.cameras.projection import project
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Detections
from tests.support.scenes import ring_of_cameras


@pytest.mark.parametrize("moved", [False, True])
def test_views_keep_one_person_of_two_dancers(moved: bool) -> None:
    demo, cameras = demo_capture(), ring_of_cameras(4)
    points = demo.truth["keypoints3d"]
    dancers = [points - points.mean((0, 1)) * [1, 1, 0], points[::-1] - points.mean((0, 1)) * [1, 1, 0] + [0.7, 0.7, 0]]
    xy = np.stack([project(cameras, dancer) for dancer in dancers], axis=2)
    xy += np.random.default_rng(0).normal(0, 5.0, xy.shape)
    if moved:
        xy[3] += [150.0, 90.0]
    seen = Detections(cameras.names, xy, np.ones(xy.shape[:-1]), demo.require_multiview()[1].joint_set)
    kept = (keep_shared(cameras, seen).confidence > 0).any(-1)[: 3 if moved else 4]
    same = (kept.sum(2) == 1).all(0) & (kept == kept[:1]).all((0, 2))
    assert same.mean() > 0.9
