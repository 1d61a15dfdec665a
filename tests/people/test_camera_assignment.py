"""Which calibrated camera each recorded one is: found where the views clearly say, else left open."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.explain import assigned_by_views
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.camera_names import counted_order
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, Capture, Detections
from tests.support.calibration_files import toml_text
from tests.support.trial_files import write_detections
from tests.support.words import words


@pytest.fixture(scope="module")
def demo() -> Capture:
    return demo_capture(40)


def detections_of(capture: Capture, order: list[int]) -> Detections:
    keypoints = capture.keypoints
    return Detections(
        tuple(f"view{i}" for i in range(len(order))), keypoints.xy[order][:, :, None],
        keypoints.confidence[order][:, :, None], keypoints.joint_set,
    )  # fmt: skip


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [1, 0, 2, 3], [3, 0, 1, 2], [2, 0, 3]])
def test_cameras_are_found_by_what_they_see(order, demo):
    assert assigned_by_views(demo.cameras, detections_of(demo, order), None) == order


def test_two_views_say_too_little(demo):
    assert assigned_by_views(demo.cameras, detections_of(demo, [1, 3]), None) is None


def test_the_calibration_of_another_place_is_none(demo):
    turns = exp_so3(np.random.default_rng(2).normal(0, 0.5, (4, 3)))
    elsewhere = replace(demo.cameras, R=turns @ demo.cameras.R)
    assert assigned_by_views(elsewhere, detections_of(demo, [0, 1, 2, 3]), [0, 1, 2, 3]) is None


def _ring(demo: Capture) -> tuple[Cameras, Detections]:
    """Return four cameras alike around a person, of which each sees what the first does, turned with it."""
    R0, t0 = demo.cameras.R[0], demo.cameras.t[0]
    turns = exp_so3(np.outer(np.arange(4) * np.pi / 2, [0, 0, 1.0]))
    cameras = Cameras(
        demo.cameras.names, np.repeat(demo.cameras.K[:1], 4, 0), np.repeat(demo.cameras.distortion[:1], 4, 0),
        R0 @ turns,
        np.repeat(t0[None], 4, 0), demo.cameras.image_size, demo.cameras.models,
    )  # fmt: skip
    points = demo.truth["keypoints3d"] - demo.truth["keypoints3d"].mean((0, 1)) + [0, 0, 0.9]
    seen = np.einsum("cij,fkj->cfki", cameras.R, points) + cameras.t[:, None, None]
    pixels = np.einsum("cij,cfkj->cfki", cameras.K, seen)
    xy = (pixels[..., :2] / pixels[..., 2:]).astype(np.float32)
    return cameras, Detections(
        demo.cameras.names,
        xy[:, :, None],
        np.ones((*xy.shape[:2], 1, xy.shape[2]), np.float32),
        demo.keypoints.joint_set,
    )


def test_a_ring_of_cameras_alike_is_left_open_unless_names_count(demo):
    cameras, detections = _ring(demo)
    assert assigned_by_views(cameras, detections, None) is None
    assert assigned_by_views(cameras, detections, [0, 1, 2, 3]) == [0, 1, 2, 3]
    assert assigned_by_views(cameras, detections, [0, 2, 1, 3]) is None


def test_names_that_count():
    assert counted_order(["cam0", "cam2", "cam1"], ["cam01", "cam02", "cam03"]) == [0, 2, 1]
    assert counted_order(["front", "left"], ["cam01", "cam02"]) is None
    assert counted_order(["cam0"], ["cam01", "cam02"]) is None


@pytest.mark.slow
def test_other_names_and_exchanged_names_are_found_and_reported(tmp_path, demo):
    cameras, keypoints = demo.require_multiview()
    names = ["front", "left", "back", "right"]
    write_detections(tmp_path / "other" / "pose", names, [(keypoints.xy, keypoints.confidence)])
    (tmp_path / "other" / "calibration.toml").write_text(toml_text(cameras))
    other = load_capture(tmp_path / "other", fps=60.0)
    assert set(other.cameras.names) == set(cameras.names)
    (assigned,) = [item for item in other.problems if item.code == "cameras_assigned_by_views"]
    assert set(assigned.where.cameras) == set(names)
    said = words([assigned])[0]
    assert "back is cam03, front is cam01, left is cam02, right is cam04" in said and "--camera RECORDED" in said
    swapped = keypoints.xy[[1, 0, 2, 3]], keypoints.confidence[[1, 0, 2, 3]]
    write_detections(tmp_path / "swapped" / "pose", cameras.names, [swapped])
    (tmp_path / "swapped" / "calibration.toml").write_text(toml_text(cameras))
    found = load_capture(tmp_path / "swapped", fps=60.0)
    (exchanged,) = [item for item in found.problems if item.code == "camera_names_exchanged"]
    assert set(exchanged.where.cameras) == set(cameras.names[:2])
    assert "cam01 is the calibration's cam02" in words([exchanged])[0] and "--as-calibrated" in words([exchanged])[0]
    np.testing.assert_allclose(found.cameras.t[0], cameras.t[1], atol=1e-6)
    kept = load_capture(tmp_path / "swapped", fps=60.0, as_calibrated=True)
    np.testing.assert_allclose(kept.cameras.t[0], cameras.t[0], atol=1e-6)
