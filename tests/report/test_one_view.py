"""The page of a take of one camera: drawn from the side too, as wide as it is open, with open limbs marked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.geometry.small_matrices import packed
from solver_backend.report.body_sections import MOMENTS, one_view_section, open_limbs, sight_sigma_m
from solver_backend.report.page import report_html
from solver_backend.types import Capture, Motion
from tests.support.html_page import Strict
from tests.support.solved import solved

ALONG_M, ACROSS_M = 0.3, 0.02


@pytest.fixture
def take() -> tuple[Capture, Motion]:
    """Return a take of one camera whose joints are open along the line of sight."""
    capture, motion = solved(faults=False, views=1)
    assert capture.cameras is not None
    sight = motion.joints - capture.cameras.centres[0]
    sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
    covariance = ACROSS_M**2 * np.eye(3) + (ALONG_M**2 - ACROSS_M**2) * sight[..., :, None] * sight[..., None, :]
    found = diagnostic("limb_depth_open", frames=[(10, 19)], joints=["left_wrist"], part="left arm")
    record = {**motion.provenance, "diagnostics": [found.as_dict()]}
    return capture, replace(motion, joint_covariance=packed(covariance), provenance=record)


def test_deviations_are_as_long_as_they_are_and_seen_from_the_side(take: tuple[Capture, Motion]) -> None:
    capture, motion = take
    assert capture.cameras is not None
    np.testing.assert_allclose(sight_sigma_m(motion, capture.cameras.centres[[0]]), ALONG_M, rtol=1e-5)
    ellipses = [item for tag, item in Strict(one_view_section(capture, motion)).seen if tag == "ellipse"]
    assert len(ellipses) == MOMENTS * 2 * 6
    half = np.array([[float(item[key] or 0) for key in ("rx", "ry")] for item in ellipses])
    long, short = np.moveaxis(half.reshape(MOMENTS, 2, 6, 2), -1, 0)
    assert np.median(long[:, 1] / short[:, 1]) > 5.0 and (long[:, 0] < 0.5 * long[:, 1]).all()


def test_open_limbs_are_dashed_where_they_were_reported(take: tuple[Capture, Motion]) -> None:
    capture, motion = take
    flags = open_limbs(motion)
    assert np.flatnonzero(flags["left arm"]).tolist() == list(range(10, 20)) and not flags["right leg"].any()
    assert motion.joint_covariance is not None
    for widest, dashed in ((5, 0), (15, 2 * 3)):  # each part of the take is drawn where it is widest
        wide = np.array(motion.joint_covariance)
        wide[widest] *= 4.0
        drawn = Strict(one_view_section(capture, replace(motion, joint_covariance=wide))).seen
        kinds = [(item.get("class") or "").split() for tag, item in drawn if tag == "line"]
        assert [kind for kind in kinds if "open" in kind] == [["bone", "a", "open"]] * dashed


def test_the_page_speaks_of_one_camera_where_there_is_one(take: tuple[Capture, Motion]) -> None:
    text = "".join(Strict(report_html(*take)).words)
    assert "From the camera and from the side" in text and "Seen by the camera" in text
    assert "two cameras" not in text and "two or more" not in text
    several = "".join(Strict(report_html(*solved())).words)
    assert "From the camera and from the side" not in several and "two or more" in several
