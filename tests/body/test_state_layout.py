"""Blocks of tangents follow one another, some of them make a layout of their own, and joints keep their columns."""

import numpy as np
import pytest

from solver_backend.body.state_layout import CODE, RESIDUAL, ROOT, TRANSL, UNCOVERED, StateLayout
from tests.support.layouts import POSE

BLOCKS = (CODE, ROOT, TRANSL, UNCOVERED, RESIDUAL)


@pytest.mark.parametrize(("code_dof", "joints", "uncovered"), [(30, 21, ()), (32, 21, ()), (7, 39, (3, 38))])
def test_blocks_of_a_state_follow_one_another_and_fill_it(code_dof, joints, uncovered):
    layout = StateLayout.of(code_dof, joints, uncovered)
    columns = [column for name in BLOCKS for column in range(500)[layout[name]]]
    assert columns == list(range(layout.dof)) == list(range(code_dof + 6 + 3 * joints))
    assert sorted(layout.turned) == list(range(joints)) and layout.turned[: len(uncovered)] == uncovered
    assert layout.turns == slice(layout.dof - 3 * joints, layout.dof)


@pytest.mark.parametrize("free", [(ROOT, TRANSL), (RESIDUAL, ROOT), (TRANSL,), BLOCKS])
def test_free_blocks_are_a_layout_that_lies_in_the_whole_one(free):
    whole = StateLayout.of(30, 21, (20,))
    some, columns = whole.only(free), whole.columns(free)
    assert some == whole.without(*(name for name in BLOCKS if name not in free))
    assert some.dof == len(columns) and all(name in some for name in free)
    for name in free:
        np.testing.assert_array_equal(columns[some[name]], np.arange(whole.dof)[whole[name]])
    for name in set(BLOCKS) - set(free):
        assert name not in some
        with pytest.raises(KeyError):
            some[name]


def test_parts_of_a_pose_follow_one_another_and_fill_it():
    joints = [POSE.joint(j) for j in range(21)]
    for parts in (
        (POSE.root, POSE.joints, POSE.transl),
        (POSE.rotations, POSE.transl),
    ):
        assert [column for part in parts for column in range(200)[part]] == list(range(POSE.dof))
    assert [column for part in joints for column in range(200)[part]] == list(range(200)[POSE.joints])
