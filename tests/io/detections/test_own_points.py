"""Points of a user's own that bones carry: read from ``keypoints.json``, kept with their person and in files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_addon._exchange.capture_file import read_capture as read_in_blender
from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.types import Capture, PersonInViews
from tests.support.own_points import BODY, PLACES, own_capture, write_own_points


@pytest.fixture(scope="module")
def demo() -> Capture:
    return own_capture(30)


def rewrite(root: Path, **values: Any) -> None:
    path = root / "keypoints.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_seventeen_points_of_deeplabcut_are_read(tmp_path: Path, demo: Capture) -> None:
    capture = load_capture(write_own_points(tmp_path / "take", demo), fps=60.0)
    found, given = capture.require_multiview()[1], demo.require_multiview()[1]
    assert [point.bone for point in found.own] == list(PLACES)
    count = found.joint_set.num_keypoints
    np.testing.assert_allclose(found.xy[:, :, count:], given.xy[:, :, -len(PLACES) :], atol=1e-2)
    assert set(BODY.values()) <= set(found.joint_set.keypoints)
    named = (found.confidence[:, :, :count] > 0).any((0, 1))
    assert named.sum() == 8, "a point on a bone is no landmark"


def test_a_name_like_a_landmarks_stays_a_point_on_its_bone(tmp_path: Path, demo: Capture) -> None:
    keypoints = demo.require_multiview()[1]
    own = (replace(keypoints.own[0], name="left_knee"), *keypoints.own[1:])
    like = replace(demo, keypoints=replace(keypoints, own=own))
    found = load_capture(write_own_points(tmp_path / "take", like), fps=60.0).require_multiview()[1]
    knee = found.joint_set.keypoints.index("left_knee")
    assert found.own[0].name == "left_knee" and not found.confidence[:, :, knee].any()


def test_a_point_that_no_file_names_is_reported(tmp_path: Path, demo: Capture) -> None:
    root = write_own_points(tmp_path / "take", demo)
    rewrite(root, points={"uhr": {"bone": "left_forearm"}, "mein_spine3": {"bone": "spine3"}})
    capture = load_capture(root, fps=60.0)
    assert [item.where.joints for item in capture.problems if item.code == "own_points_absent"] == [("uhr",)]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ({"mein_spine3": {"bone": "tail"}}, r"no such bone: 'mein_spine3' is on 'tail'"),
        ({"mein_spine3": "spine3"}, r"no such bone: 'mein_spine3' is on 'None'"),
        ({"pulsL": {"bone": "left_forearm"}}, r"Both a landmark and a point on a bone: pulsL"),
        (["mein_spine3"], "does not define the keypoints"),
    ],
)
def test_a_bad_file_is_named(tmp_path: Path, demo: Capture, points: Any, message: str) -> None:
    root = write_own_points(tmp_path / "take", demo)
    rewrite(root, points=points)
    with pytest.raises(FileDamaged, match=message):
        load_capture(root)


def test_a_capture_file_keeps_own_points_of_everybody(tmp_path: Path, demo: Capture) -> None:
    keypoints = demo.require_multiview()[1]
    other = replace(keypoints, xy=keypoints.xy + 5.0)
    people = (PersonInViews("Anna", keypoints), PersonInViews("Bo", other))
    path = write_capture(tmp_path / "capture.npz", replace(demo, people=people, person="Anna"))
    again = read_capture(path)
    assert again.keypoints is not None and again.keypoints.own == keypoints.own
    for found, given in ((again.keypoints, keypoints), (again.people[1].keypoints, other)):
        np.testing.assert_allclose(found.xy, given.xy, atol=1e-2)
        np.testing.assert_allclose(found.confidence, given.confidence, atol=1e-5)
    assert read_in_blender(path).num_frames == 30, "Blender shows the keypoints of the joint set"
    arrays = dict(np.load(path))
    np.savez(path, **{**arrays, "own_bones": np.array(["tail"] * len(PLACES))})
    with pytest.raises(FileDamaged, match="tail"):
        read_capture(path)


def test_one_camera_reports_that_they_are_not_used(tmp_path: Path, demo: Capture) -> None:
    root = write_own_points(tmp_path / "take", demo)
    first, *others = sorted(root.glob("*.csv"))
    for path in others:
        path.unlink()
    capture = load_capture(root, fps=60.0)
    assert capture.keypoints is not None and not capture.keypoints.own, first
    assert "own_point_unused" in [item.code for item in capture.problems]
