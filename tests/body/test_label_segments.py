"""Labels that name a bone and no place on it."""

import pytest

from solver_backend.body.marker_names import named_bone


@pytest.mark.parametrize(
    ("label", "bone"),
    [
        ("ArmL:Marker1", "left_shoulder"), ("ForearmR:3", "right_elbow"), ("R_Thigh_Cluster_3", "right_hip"),
        ("LTHI1", "left_hip"), ("Oberschenkel_li:2", "left_hip"), ("Right Upper Arm:Marker 2", "right_shoulder"),
        ("Head:3", "head"), ("ThighPlateR1", "right_hip"), ("L.Shank.Upper", "left_knee"),
    ],
)  # fmt: skip
def test_a_bone_is_named_by_the_label_or_its_prefix(label, bone):
    assert named_bone(label) == bone


@pytest.mark.parametrize(
    "label",
    ["Marker1", "WheelchairL:Marker1", "Sync:Sync", "rFArm2", "knee_R_thigh", "Thigh_3", "HeadThighL:1", "Anna:LTH2"],
)
def test_what_names_no_bone_or_several_says_nothing(label):
    assert named_bone(label) is None
