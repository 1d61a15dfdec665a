"""Every whole layout informs every part; what is left out of one does not."""

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.body.resting_posture import PARTS
from solver_backend.fitters.rest_parts import PartShares, resting_shares
from solver_backend.types import JointSet

FPS = 50.0
LOWER_BODY = (
    "LASI", "RASI", "LPSI", "RPSI", "LTHI", "LKNE", "LTIB", "LANK", "LTOE", "RTHI", "RKNE", "RTIB", "RANK", "RTOE",
)  # fmt: skip
TORSO = ("C7", "T10", "CLAV", "STRN", "LSHO", "RSHO", "LASI", "RASI", "LPSI", "RPSI")


def shares(landmarks, located=None, seen=None) -> dict[str, np.ndarray]:
    return parts(landmarks, located, seen).rest


def parts(landmarks, located=None, seen=None) -> PartShares:
    located = np.ones((200, len(landmarks)), bool) if located is None else located
    seen = np.ones(len(located), bool) if seen is None else seen
    return resting_shares(load_body(), landmarks, np.zeros((len(landmarks), 3)), located, seen, FPS)


@pytest.mark.parametrize("joint_set", [*JointSet])
def test_every_set_of_keypoints_informs_every_part(joint_set):
    assert not shares(keypoint_landmarks(load_body(), joint_set))


@pytest.mark.parametrize("layout", [*load_layouts().layouts])
def test_every_layout_informs_every_part(layout):
    assert not shares(marker_landmarks(load_body(), marker_layout(layout)))


def test_markers_of_the_legs_inform_no_more_than_them():
    found = shares(marker_landmarks(load_body(), LOWER_BODY))
    assert set(found) == {part for part in PARTS if "thigh" not in part and "shank" not in part}
    assert all((share == 1.0).all() for share in found.values())


def test_the_shoulders_are_no_arms_and_the_neck_is_no_head():
    found = shares(marker_landmarks(load_body(), TORSO))
    assert set(found) == set(PARTS) - {"trunk"}


def test_an_elbow_informs_the_upper_arm_alone():
    found = shares(marker_landmarks(load_body(), (*TORSO, "LELB")))
    assert "left_upper_arm" not in found and "left_forearm" in found


def test_an_arm_that_is_seen_for_a_second_comes_to_rest_smoothly():
    landmarks = marker_landmarks(load_body(), (*TORSO, "LELB", "LWRA"))
    located = np.ones((300, len(landmarks)), bool)
    located[:, -2:] = False
    located[100:150, -2:] = True
    share = shares(landmarks, located)["left_upper_arm"]
    assert (share[75:175] == 0).all() and (share[:50] == 1).all() and (share[201:] == 1).all()
    assert np.abs(np.diff(share, 2)).max() < 0.02


def test_what_nothing_leads_back_to_is_soon_as_little_known_as_what_rests():
    """The pose follows the fit for half a second; its deviation rises at once, less and slower between seen frames."""
    landmarks = marker_landmarks(load_body(), (*TORSO, "LELB", "LWRA", "RELB", "RWRA", "LFHD", *LOWER_BODY[4:]))
    located, arm = np.ones((100, len(landmarks)), bool), slice(len(TORSO), len(TORSO) + 2)
    located[80:, arm] = located[40:50, arm] = False
    found = parts(landmarks, located)
    assert not found.rest and set(found.spread) == {"left_upper_arm", "left_forearm"}
    np.testing.assert_allclose(found.spread["left_forearm"][78:81], [0.0, 0.0, (0.02 / 0.5) ** 2], atol=1e-12)
    assert not found.spread["left_forearm"][[*range(40), *range(50, 80)]].any()
    assert found.spread["left_forearm"][44] == pytest.approx((0.1 / 0.5) ** 3)
    assert found.spread["left_forearm"][-1] == pytest.approx((0.4 / 0.5) ** 2)


def test_gaps_up_to_a_second_are_bridged_as_ever():
    landmarks = marker_landmarks(load_body(), (*TORSO, "LELB", "LWRA", "RELB", "RWRA", "LFHD", *LOWER_BODY[4:]))
    located = np.ones((300, len(landmarks)), bool)
    located[100:149] = False
    assert not shares(landmarks, located)


def test_frames_without_anybody_say_nothing_of_parts():
    landmarks = marker_landmarks(load_body(), LOWER_BODY)
    located, seen = np.ones((300, len(landmarks)), bool), np.ones(300, bool)
    located[100:250] = seen[100:250] = False
    found = shares(landmarks, located, seen)
    assert set(found) == {part for part in PARTS if "thigh" not in part and "shank" not in part}
    assert (found["head"] == 1.0).all()
