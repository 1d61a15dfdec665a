"""Own points on bones: a solve finds their places, and a body that keypoints alone leave open."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.diagnostics import Diagnostic, read_diagnostics, sentence
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.pipeline import solve
from solver_backend.io.native.motion_file import read_motion
from solver_backend.types import Capture, Motion
from tests.support.own_points import PLACES, own_capture, write_own_points

BENT = ("left_elbow", "right_elbow", "left_knee", "right_knee")  # Joints that the eight keypoints leave to the prior.


@cache
def solved(*, with_own: bool) -> Motion:
    capture = own_capture()
    assert capture.keypoints is not None
    keypoints = capture.keypoints if with_own else capture.keypoints.named
    return solve(replace(capture, keypoints=keypoints, truth={})).motion


def error_mm(motion: Motion, names: tuple[str, ...] = ()) -> float:
    """Return the mean distance of joints from the truth, of all or of these."""
    joints = motion.body_layout.joints
    chosen = [joints.index(name) for name in names or joints]
    truth = own_capture().truth["joints"][:, [joints.index(name) for name in joints]]
    return 1000 * float(np.linalg.norm(motion.joints - truth, axis=-1)[:, chosen].mean())


def found_in(motion: Motion, code: str) -> list[Diagnostic]:
    return [item for item in read_diagnostics(motion.provenance["diagnostics"]) if item.code == code]


@pytest.mark.slow
def test_own_points_make_the_solve_better() -> None:
    alone, helped = solved(with_own=False), solved(with_own=True)
    assert error_mm(helped) < 0.8 * error_mm(alone)
    assert error_mm(helped, BENT) < 0.6 * error_mm(alone, BENT)
    assert helped.keypoints3d is not None and alone.keypoints3d is not None
    assert helped.keypoints3d.shape == alone.keypoints3d.shape, "a motion holds the keypoints of the joint set"


@pytest.mark.slow
def test_places_on_bones_are_found_and_reported() -> None:
    placed = found_in(solved(with_own=True), "own_point_placed")
    assert [item.values["bone"] for item in placed] == list(PLACES)
    found = np.array([[float(v) for v in item.values["offset_mm"]] for item in placed])
    off = np.linalg.norm(found - 1000 * np.array([*PLACES.values()]), axis=-1)
    assert np.median(off) < 15.0 and off.max() < 25.0, off.round(1).tolist()
    residual = np.array([item.values["size"] for item in placed])
    # The median length of a Gaussian in two dimensions is 1.18 standard deviations: 3.5 px for 3.
    assert (residual > 3.0).all() and (residual < 5.0).all(), residual.tolist()
    assert "left_upper_arm" in sentence(placed[0]) and "median error of this point is" in sentence(placed[0])


@pytest.mark.slow
def test_a_point_on_the_wrong_bone_and_one_that_is_not_seen_are_left_out() -> None:
    capture = own_capture(120)
    keypoints = capture.keypoints
    assert keypoints is not None
    own = (replace(keypoints.own[0], bone="left_shin"), *keypoints.own[1:])
    confidence = keypoints.confidence.copy()
    confidence[1:, :, -1] = 0.0
    wrong: Capture = replace(capture, keypoints=replace(keypoints, own=own, confidence=confidence), truth={})
    motion = solve(wrong, SolveSettings(method="frame")).motion
    unused = [item.where.joints for item in found_in(motion, "own_point_unused")]
    assert unused == [("mein_left_upper_arm",), ("mein_spine3",)]
    assert len(found_in(motion, "own_point_placed")) == len(PLACES) - 2


@pytest.mark.slow
def test_a_folder_of_own_points_is_read_solved_and_reported(tmp_path: Path) -> None:
    root = write_own_points(tmp_path / "take", own_capture(60))
    out, page = tmp_path / "m.npz", tmp_path / "m.html"
    assert main(["info", str(root), "--fps", "60", "--report", str(tmp_path / "i.html")]) == 0
    assert main(["cameras check", str(root), "--fps", "60"]) == 0
    assert main(["convert", str(root), "--fps", "60", "--out", str(tmp_path / "c.npz")]) == 0
    assert main(["solve", str(tmp_path / "c.npz"), "--out", str(out), "--report", str(page)]) == 0
    assert "mein_left_forearm" in page.read_text(encoding="utf-8")
    assert found_in(read_motion(out), "own_point_placed")
    again = ["--resolve", str(out), "--frames", "20", "40", "--out", str(tmp_path / "again.npz")]
    assert main(["solve", str(tmp_path / "c.npz"), *again]) == 0
