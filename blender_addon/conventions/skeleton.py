"""Skeletons of characters: SMPL's joints, with or without fingers."""

from __future__ import annotations

from collections.abc import Container

from .._exchange.body_layout import SMPL, SMPL_HANDS, BodyLayout
from .._exchange.joint_sets import NUM_BETAS, NUM_JOINTS
from .._exchange.joint_sets import SMPL_JOINTS as JOINTS
from .._exchange.joint_sets import SMPL_PARENTS as PARENTS

__all__ = ["JOINTS", "LAYOUTS", "NUM_BETAS", "NUM_JOINTS", "PARENTS", "SMPL", "SMPL_HANDS", "BodyLayout", "layout_of"]

LAYOUTS = (SMPL, SMPL_HANDS)  # Layouts of the add-on's bodies: 24 joints, or 52 joints with fingers.


def layout_of(bones: Container[str]) -> BodyLayout:
    """Return the body layout that these bone names belong to: with or without fingers."""
    return SMPL_HANDS if SMPL_HANDS.joints[-1] in bones else SMPL
