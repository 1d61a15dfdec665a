"""The SMPL tree: 24 joints, their parents, and the child a bone points to."""

from .._exchange.joint_sets import NUM_BETAS, NUM_JOINTS
from .._exchange.joint_sets import SMPL_JOINTS as JOINTS
from .._exchange.joint_sets import SMPL_PARENTS as PARENTS

__all__ = ["JOINTS", "MAIN_CHILD", "MIRROR_JOINT", "NUM_BETAS", "NUM_JOINTS", "PARENTS"]

MAIN_CHILD: dict[int, int] = {
    0: 3, 1: 4, 2: 5, 3: 6, 4: 7, 5: 8, 6: 9, 7: 10, 8: 11, 9: 12, 12: 15, 13: 16, 14: 17, 16: 18, 17: 19, 18: 20,
    19: 21, 20: 22, 21: 23,
}  # fmt: skip
"""The child at which a bone ends; feet, head and hands have none."""

MIRROR_JOINT = tuple(
    JOINTS.index(n.replace("left", "right") if n.startswith("left") else n.replace("right", "left")) for n in JOINTS
)
"""The joint on the other side; joints of the midline are their own."""
