"""Layouts of bodies: the SMPL family, what can be read off a layout, and layouts that are none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from solver_backend.exchange.body_layout import FAMILY, SMPL, SMPL_H, SMPL_X, BodyLayout
from solver_backend.exchange.errors import BodyInvalid

ONE_ARM = SMPL.without(("right_shoulder",), "one arm")


def test_the_family_shares_the_body_and_differs_in_hands_and_face():
    assert [(layout.name, count) for count, layout in FAMILY.items()] == [("SMPL", 24), ("SMPL-H", 52), ("SMPL-X", 55)]
    for layout in FAMILY.values():
        assert layout.solved == SMPL.joints[1:22] and layout.recorded is SMPL
        assert layout.parents[:22] == SMPL.parents[:22]
    assert SMPL.standing_for(SMPL) == tuple(range(24))
    # smplx (Pavlakos et al. 2019), joint_names.py: left_middle1 and right_middle1.
    assert SMPL_H.standing_for(SMPL)[22:] == (25, 40) and SMPL_X.standing_for(SMPL)[22:] == (28, 43)


@pytest.mark.parametrize("layout", [*FAMILY.values(), ONE_ARM], ids=lambda layout: layout.name)
def test_sides_mirror_and_a_bone_ends_at_a_child(layout):
    assert [layout.mirror[j] for j in layout.mirror] == list(range(layout.num_joints)) or layout is ONE_ARM
    for joint, other in enumerate(layout.mirror):
        swapped = layout.joints[joint].replace("left_", "*").replace("right_", "left_").replace("*", "right_")
        assert layout.joints[other] == (swapped if swapped in layout.joints else layout.joints[joint])
    for joint, child in layout.main_child.items():
        assert layout.parents[child] == joint
    assert [layout.joints[layout.main_child[layout.joints.index(name)]] for name in ("pelvis", "spine3")] == [
        "spine1", "neck",
    ]  # fmt: skip


def test_a_body_without_an_arm_keeps_the_rest_of_the_tree():
    lost = {"right_shoulder", "right_elbow", "right_wrist", "right_hand"}
    assert set(SMPL.joints) - set(ONE_ARM.joints) == lost
    for joint, parent in enumerate(ONE_ARM.parents[1:], 1):
        old = SMPL.joints.index(ONE_ARM.joints[joint])
        assert ONE_ARM.joints[parent] == SMPL.joints[SMPL.parents[old]]
    assert ONE_ARM.num_solved == 18 and ONE_ARM.recorded is ONE_ARM
    with pytest.raises(BodyInvalid, match="one arm has no right_shoulder, .* which SMPL has"):
        ONE_ARM.standing_for(SMPL)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parents": (-1, 0)}, "2 parents"),
        ({"joints": ("a", "b", "a")}, "are not a valid layout"),
        ({"parents": (-1, 2, 0)}, "not a tree"),
        ({"parents": (-1, -1, 0)}, "not a tree"),
    ],
)
def test_what_is_no_tree_of_named_joints_is_refused(change, message):
    good = BodyLayout("three", ("a", "b", "c"), (-1, 0, 1), ("x", "x", "y"), resting=("y",))
    assert good.solved == ("b",) and good.group("x") == (0, 1)
    with pytest.raises(BodyInvalid, match=message):
        replace(good, **change)


def test_limits_are_the_layouts_and_follow_its_joints() -> None:
    assert set(SMPL.limits) == set(SMPL.solved) and SMPL_H.limits == SMPL.limits
    for j, joint in enumerate(SMPL.joints):
        if joint in SMPL.limits:
            assert SMPL.limits[joint] == SMPL.limits[SMPL.joints[SMPL.mirror[j]]].mirrored or SMPL.mirror[j] == j
    knee = SMPL.limits["left_knee"]
    assert knee.low_deg[0] < 0 < 140 < knee.high_deg[0], "a knee bends backwards"
    one_arm = SMPL.without(("right_shoulder",), "one arm")
    assert set(SMPL.limits) - set(one_arm.limits) == {"right_shoulder", "right_elbow", "right_wrist"}
