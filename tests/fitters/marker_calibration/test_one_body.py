"""Two halves of bodies that stand apart are refused with that reason, before anything is fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.exchange.errors import MarkersUnknown
from solver_backend.fitters import solve
from solver_backend.fitters.marker_calibration.person_doubts import check_one_body
from solver_backend.types import Capture
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("CMU_41")
LEGS = np.array([label[1:] in ("FWT", "BWT", "THI", "KNE", "SHN", "ANK", "HEE", "MT5", "TOE") for label in LABELS])
ARMS = np.array([label[1:] in ("UPA", "ELB", "FRM", "WRA", "WRB", "FIN") for label in LABELS])
ARM = np.array([label in ("LELB", "LFRM", "LWRA", "LWRB", "LFIN") for label in LABELS])


@pytest.fixture(scope="module")
def cloud():
    return worn_markers(LABELS, 20).cloud


def test_two_half_bodies_are_refused_with_their_distance(cloud):
    halves = replace(cloud, positions=cloud.positions + np.where(LEGS, 0.0, 1.5)[:, None] * [1.0, 0.5, 0.0])
    with pytest.raises(MarkersUnknown, match=r"Two groups of markers are 1\.\d\d m apart, too far for one body"):
        solve(Capture("halves", markers=halves))


@pytest.mark.parametrize("scale", [0.6, 1.0, 1.3])
def test_one_body_of_any_size_or_in_part_is_one(cloud, scale):
    landmarks = marker_landmarks(load_body(), LABELS)
    points = scale * cloud.positions
    check_one_body(points, landmarks, load_body())
    points[:, (LEGS | ARM) == 0] = np.nan  # legs and one arm, with nothing between
    check_one_body(points, landmarks, load_body())


def test_an_arm_of_somebody_else_is_no_part(cloud):
    points = cloud.positions + np.where(ARM, 1.4, 0.0)[:, None] * [0.0, 1.0, 0.0]
    with pytest.raises(MarkersUnknown, match="LELB, LFRM, LWRA, LWRB, LFIN and LFHD.* and 30 more"):
        check_one_body(points, marker_landmarks(load_body(), LABELS), load_body())


def test_markers_that_are_known_by_their_bone_alone_are_where_they_are(cloud):
    """As of a running laboratory, whose waist and back are known by the bone: joints 0.1 m apart, markers 0.4."""
    body, places = load_body(), marker_landmarks(load_body(), LABELS)
    bones = {"LFWT": "@pelvis", "RFWT": "@pelvis", "LBWT": "@pelvis", "RBWT": "@pelvis", "C7": "@spine1",
             "CLAV": "@spine1"}  # fmt: skip
    landmarks = marker_landmarks(body, tuple(bones.get(label, label) for label in LABELS))
    offsets = places.anchors.sum(axis=1) - landmarks.anchors.sum(axis=1)
    points = cloud.positions.copy()
    points[:, [label in ("T10", "STRN", "RBAC") or label in np.array(LABELS)[ARMS] for label in LABELS]] = np.nan
    check_one_body(points, landmarks, body, offsets)
    far = points.copy()
    far[:, [label in bones for label in LABELS]] += 1.5
    with pytest.raises(MarkersUnknown):
        check_one_body(far, landmarks, body, offsets)
    check_one_body(points, landmarks, body)  # Without offsets, nothing is known about the distance.
