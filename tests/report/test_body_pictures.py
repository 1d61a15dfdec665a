"""The pictures of the solved body in the report."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.report.body_pictures import POSE_CELL_M, POSES, SurfaceView, poses_section
from solver_backend.types import Motion
from tests.support.solved import solved

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 0.5)])
FRONT = np.array([[1, 5, 7], [1, 7, 3]])  # The side at z = 0.5.


@pytest.fixture(scope="module")
def motion() -> Motion:
    return replace(solved()[1], body=load_body().id)


def heights(html: str) -> list[float]:
    """Return the offsets of the drawings from the top."""
    return [float(y) for y in re.findall(r"translate\([\d.-]+ ([\d.-]+)\)", html)]


def test_a_surface_has_its_size_and_no_holes() -> None:
    view = SurfaceView.of("", 1.0, CUBE, FRONT, cell_m=0.01)
    there = np.isfinite(view.depth)
    assert there.sum() == pytest.approx(100 * 200, rel=0.03)
    rows, columns = np.flatnonzero(there.any(axis=1)), np.flatnonzero(there.any(axis=0))
    assert there[rows[0] : rows[-1], columns[0] : columns[-1]].all()
    np.testing.assert_allclose(view.depth[there], 0.5)
    assert view.tone[there].min() == pytest.approx(1.0)


def test_the_body_is_drawn_once_per_moment_and_rises_with_the_person(motion: Motion) -> None:
    low = poses_section(motion)
    count = min(POSES, motion.num_frames)
    assert low.count("<g ") == count
    higher = np.zeros((motion.num_frames, 3))
    higher[motion.num_frames // 2 :, 2] = 1.0
    raised = replace(motion, transl=motion.transl + higher, joints=motion.joints + higher[:, None])
    before, after = (np.array(heights(poses_section(one))) for one in (motion, raised))
    up = (after - after[0]) - (before - before[0])
    assert (up[: count // 2 - 1] > -5.0).all()
    assert up[-1] < -0.2 / POSE_CELL_M


def test_a_body_far_from_the_floor_has_pictures_of_its_own_size(motion: Motion) -> None:
    up = np.array([0.0, 0.0, 20.0])
    far = poses_section(replace(motion, transl=motion.transl + up, joints=motion.joints + up))
    sizes = [float(re.search(r'viewBox="0 0 \S+ ([0-9.]+)"', page)[1]) for page in (poses_section(motion), far)]
    assert sizes[1] < 1.5 * sizes[0] and "The line is the floor" not in far and "height of" in far


def test_another_body_has_no_picture(motion: Motion) -> None:
    assert poses_section(replace(motion, body="another")) == ""
