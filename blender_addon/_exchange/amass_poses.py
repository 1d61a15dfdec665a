"""AMASS's ``poses``: how wide they are, and where fingers are in them."""

from __future__ import annotations

import numpy as np

from .body_layout import SMPL
from .errors import MotionInvalid
from .schema import Fields

AMASS_POSE_WIDTH = 156
"""SMPL-H: root, 21 body joints, 2 x 15 finger joints, 3 numbers each (Mahmood et al. 2019)."""
AMASS_WIDTHS = (AMASS_POSE_WIDTH, 165)
"""The same, and SMPL-X: jaw and eyes are before the fingers."""
BODY_COLUMNS = 3 + 3 * SMPL.num_solved
"""Columns of root and body joints, the first."""
FINGER_COLUMNS = 90
"""Columns of the fingers, the last."""


def has_amass_fingers(fields: Fields) -> bool:
    """Return whether a file is AMASS's and turns fingers.

    Raises:
        MotionInvalid: ``poses`` are no numbers.
    """
    if "format" in fields:
        return False
    poses = fields.floats("poses", MotionInvalid)
    return poses.ndim == 2 and poses.shape[1] in AMASS_WIDTHS and bool(poses[:, -FINGER_COLUMNS:].any())


def body_and_fingers(poses: np.ndarray) -> np.ndarray:
    """Return (F, 52, 3) axis-angles of AMASS's (F, 156 or 165) ``poses``; jaw and eyes are left out."""
    chosen = np.concatenate([poses[:, :BODY_COLUMNS], poses[:, -FINGER_COLUMNS:]], axis=1)
    return chosen.reshape(len(poses), -1, 3)
