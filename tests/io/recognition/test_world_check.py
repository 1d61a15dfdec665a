"""A world whose up axis is a camera's is told from the person; one that the user stated stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.io.recognition.up_axis import UP_AXES, rotation_to_z_up
from solver_backend.io.recognition.world_check import placed
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=40)


@pytest.mark.parametrize("axis", sorted(UP_AXES))
def test_the_person_tells_which_axis_points_up(capture: Capture, axis: str) -> None:
    turned = replace(capture.cameras, R=capture.cameras.R @ rotation_to_z_up(axis))
    cameras, world, said = placed(turned, capture.keypoints)
    np.testing.assert_allclose(cameras.R, capture.cameras.R, atol=1e-12)
    assert world.upright[2] > 0.9
    assert bool(said) == (axis != "z")
    assert axis == "z" or f"{axis.upper()} is taken as up" in said[0]


def test_what_the_user_stated_stays_and_is_doubted(capture: Capture) -> None:
    turned = replace(capture.cameras, R=capture.cameras.R @ rotation_to_z_up("-y"))
    cameras, world, said = placed(turned, capture.keypoints, "z")
    np.testing.assert_array_equal(cameras.R, turned.R)
    assert said == ()
    assert "stands along -Y" in world.problems()[0]
