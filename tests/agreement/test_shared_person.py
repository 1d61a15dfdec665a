"""Of several people, all views compare the same one in each frame."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.agreement.evidence import keep_shared
from solver_backend.agreement.explain import explain
from solver_backend.cameras.projection import project
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, Detections
from tests.support.scenes import ring_of_cameras


def dancers(cameras: Cameras) -> Detections:
    """Return noisy detections of two people close together."""
    demo = demo_capture()
    points = demo.truth["keypoints3d"]
    pair = [points - points.mean((0, 1)) * [1, 1, 0], points[::-1] - points.mean((0, 1)) * [1, 1, 0] + [0.7, 0.7, 0]]
    xy = np.stack([project(cameras, person) for person in pair], axis=2)
    xy += np.random.default_rng(0).normal(0, 5.0, xy.shape)
    return Detections(cameras.names, xy, np.ones(xy.shape[:-1]), demo.require_multiview()[1].joint_set)


@pytest.mark.parametrize("moved", [False, True])
def test_views_keep_one_person_of_two_dancers(moved: bool) -> None:
    cameras = ring_of_cameras(4)
    seen = dancers(cameras)
    if moved:
        seen.xy[3] += [150.0, 90.0]
    kept = (keep_shared(cameras, seen).confidence > 0).any(-1)[: 3 if moved else 4]
    same = (kept.sum(2) == 1).all(0) & (kept == kept[:1]).all((0, 2))
    assert same.mean() > 0.9


@pytest.mark.parametrize(
    ("order", "turned", "codes"),
    [
        ([0, 2, 1, 3], [], ["camera_names_exchanged"]),
        ([0, 1, 2, 3], [1], ["calibration_corrected"]),
        ([0, 1, 2, 3], [0, 1, 2, 3], ["calibration_corrected"]),
    ],
    ids=["names", "one rotated", "all rotated"],
)
def test_wrong_files_of_two_dancers_are_corrected(order: list[int], turned: list[int], codes: list[str]) -> None:
    """While the files are wrong, the largest person of one view may be another one than that of the next view."""
    cameras = ring_of_cameras(4)
    seen = dancers(cameras)
    seen.xy[:] = seen.xy[order]
    seen.xy[turned] = cameras.image_size[0] - 1 - seen.xy[turned]
    found = explain(cameras, seen)
    assert [applied.code for applied in found.applied] == codes and found.agrees
    assert [view for view in range(4) if found.reading.pictures[view].turn == 2] == turned
    assert list(found.reading.owners) == order


@pytest.mark.parametrize(("scale", "left"), [(1.0, 40), (1.0, 200), (0.9, 0)])
def test_cropped_and_squeezed_images_of_two_dancers_are_corrected(scale: float, left: int) -> None:
    """A crop is fitted to several people, because nothing else shows which of them all views have in common."""
    cameras = ring_of_cameras(4)
    seen = dancers(cameras)
    seen.xy[:] = seen.xy * [scale, 1.0] - [left, 0]
    found = explain(cameras, seen)
    expected = (scale, -left / cameras.image_size[0, 1], 0.0)
    assert [applied.code for applied in found.applied] == ["calibration_corrected"]
    np.testing.assert_allclose(found.reading.pictures[0].window, expected, atol=0.012)


@pytest.mark.parametrize("view", [1, 3])
def test_a_moved_camera_among_others_that_show_two_dancers_is_found(view: int) -> None:
    cameras = ring_of_cameras(4)
    seen = dancers(cameras)
    seen.xy[view] -= [60, 0]
    assert [(applied.code, applied.views) for applied in explain(cameras, seen).applied] == [("camera_placed", (view,))]
