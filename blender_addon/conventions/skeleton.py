"""The skeleton of every character here: SMPL's joints, their parents, and the child a bone points to."""

from .._exchange.body_layout import SMPL
from .._exchange.joint_sets import NUM_BETAS, NUM_JOINTS
from .._exchange.joint_sets import SMPL_JOINTS as JOINTS
from .._exchange.joint_sets import SMPL_PARENTS as PARENTS

__all__ = ["JOINTS", "MAIN_CHILD", "MIRROR_JOINT", "NUM_BETAS", "NUM_JOINTS", "PARENTS"]

MAIN_CHILD = SMPL.main_child
"""The child at which a bone ends; feet, head and hands have none."""
MIRROR_JOINT = SMPL.mirror
"""The joint on the other side; joints of the midline are their own."""
