"""A skeleton with a short bone between pelvis and thigh is recognised by DAZ's names, as SAM3DBody-cpp writes it."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.rigs.skeleton import Skeleton
from solver_backend.exchange.rigs.structure import recognise

ROWS = """
    hip - 0 0 0, abdomen hip 0 13 -2, chest abdomen 0 29 -2, neck chest 0 9 4, neck1 neck 0 5 2, head neck1 0 4 1,
    crown head 0 18 0, *Collar chest 2 6 2, *Shldr *Collar 12 0 -6, *ForeArm *Shldr 28 0 0, *Hand *ForeArm 26 0 0,
    *finger2-1 *Hand 9 0 1, *finger2-2 *finger2-1 4 0 0, *finger3-1 *Hand 9 0 -1, *finger3-2 *finger3-1 4 0 0,
    *Buttock hip 9 4 1, *Thigh *Buttock -0.6 -6.2 -0.7, *Shin *Thigh 5 -41.6 -2.4, *Foot *Shin 4.8 -41.6 -4.3,
    toe1-1.* *Foot -2.5 -4 13, toe1-2.* toe1-1.* 0 -1 2.4
"""


def test_a_buttock_bone_leaves_the_legs_clear() -> None:
    places, parents = dict[str, np.ndarray](), dict[str, str]()
    for row in (text.split() for text in ROWS.split(",")):
        for side, sign in (("l", 1.0), ("r", -1.0)) if "*" in row[0] else (("", 1.0),):
            name, parent = (word.replace(".*", f".{side.upper()}").replace("*", side) for word in row[:2])
            offset = np.array([sign, 1.0, 1.0]) * np.array(row[2:], float)
            places[name] = offset + places.get(parent, 0.0)
            if parent in places:
                parents[name] = parent
    guess = recognise(Skeleton(places, parents))
    assert not guess.doubts
    legs = [guess.roles[f"left_{part}"] for part in ("thigh", "shin", "foot", "upper_arm", "clavicle")]
    assert legs == ["lThigh", "lShin", "lFoot", "lShldr", "lCollar"]
