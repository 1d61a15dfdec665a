"""Motions of foreign skeletons that cannot be are refused by name, whatever file they come from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import MotionInvalid
from solver_backend.types import SkeletonMotion

_SOUND = SkeletonMotion(
    "clip", ("hips", "knee"), (-1, 0), np.zeros((2, 3)), np.zeros((4, 2, 3)), np.tile(np.eye(3), (4, 2, 1, 1)), 30.0
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"names": ("neck", "neck")}, "Several joints are called 'neck'"),
        ({"turns": _SOUND.turns + 1e6}, "matrices of the joint 'hips' are not rotations"),
        ({"turns": _SOUND.turns * 1e300}, "are not rotations"),
        ({"turns": -_SOUND.turns}, "are not rotations"),
        ({"turns": np.full((4, 2, 3, 3), np.nan)}, "are not rotations"),
        ({"fps": 1e-300}, "frame rate must be 0.01 to 30000"),
        ({"joints": np.zeros((0, 2, 3)), "turns": np.zeros((0, 2, 3, 3))}, "no frames"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(MotionInvalid, match=message):
        replace(_SOUND, **change)
