"""A figure named and hung as Acclaim's skeletons are: the wrist's bone turns the lower forearm, the hand's flexes."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.rigs.skeleton import Skeleton

_MIDDLE = (
    ("root", "", (0.0, 0.0, 0.95)), ("lowerback", "root", (0.0, 0.0, 0.95)),
    ("upperback", "lowerback", (0.0, 0.0, 1.06)), ("thorax", "upperback", (0.0, 0.0, 1.17)),
    ("lowerneck", "thorax", (0.0, 0.0, 1.29)),
    ("upperneck", "lowerneck", (0.0, 0.01, 1.37)), ("head", "upperneck", (0.0, 0.01, 1.45)),
    ("head_end", "head", (0.0, 0.01, 1.53)),
)  # fmt: skip
_SIDE = (
    ("hipjoint", "root", (0.0, 0.0, 0.95)), ("femur", "hipjoint", (0.08, -0.02, 0.86)),
    ("tibia", "femur", (0.08, -0.02, 0.45)), ("foot", "tibia", (0.08, -0.02, 0.03)),
    ("toes", "foot", (0.09, -0.14, 0.0)), ("toes_end", "toes", (0.09, -0.2, 0.0)),
    ("clavicle", "thorax", (0.0, 0.0, 1.29)),
    ("humerus", "clavicle", (0.19, 0.0, 1.31)), ("radius", "humerus", (0.48, 0.0, 1.31)),
    ("wrist", "radius", (0.48, 0.0, 1.31)), ("hand", "wrist", (0.48, 0.0, 1.31)), ("thumb", "wrist", (0.48, 0.0, 1.31)),
    ("fingers", "hand", (0.05, 0.0, 0.0)), ("fingers_end", "fingers", (0.08, 0.0, 0.0)),
    ("thumb_end", "thumb", (0.03, -0.03, 0.0)),
)  # fmt: skip
"""Places on the left; those after the elbow are added to it along the arm, or to the hand."""
CMU, KINECT = (0.19, 0.285), (0.255, 0.32)
"""Metres from the elbow to the bones named wrist and hand: of CMU's skeletons, where marker pairs at the wrist stand
beside the hand's bone, and of depth cameras, whose hand is the middle of the palm."""


def acclaim_skeleton(
    after_elbow: tuple[float, float] = CMU, *, splay_deg: float = 0.0, side: tuple[str, str] = ("l", "r")
) -> Skeleton:
    """Return the skeleton at rest; metres, Z up, it faces -Y.

    Args:
        after_elbow: metres from the elbow to the bones named wrist and hand.
        splay_deg: how far the legs are spread, as in the zero pose of CMU's files.
        side: what left and right are called before the part.
    """
    heads = {name: np.array(place) for name, _, place in _MIDDLE}
    parents = {name: parent for name, parent, _ in _MIDDLE if parent}
    wrist, hand = after_elbow
    for letter, sign in zip(side, (1.0, -1.0), strict=True):
        for part, parent, place in _SIDE:
            along = {"wrist": wrist, "hand": hand, "thumb": hand}.get(part, 0.0)
            base = {"fingers": "hand", "fingers_end": "hand", "thumb_end": "thumb"}.get(part)
            start = heads[f"{letter}{base}"] * [sign, 1.0, 1.0] if base else np.zeros(3)
            heads[f"{letter}{part}"] = (start + place + [along, 0.0, 0.0]) * [sign, 1.0, 1.0]
            parents[f"{letter}{part}"] = parent if parent in ("root", "thorax") else f"{letter}{parent}"
        c, s = np.cos(np.radians(splay_deg)), np.sin(np.radians(splay_deg))
        hip = heads[f"{letter}femur"].copy()
        for part in ("tibia", "foot", "toes", "toes_end"):
            x, y, z = heads[f"{letter}{part}"] - hip
            heads[f"{letter}{part}"] = hip + [c * x - sign * s * z, y, sign * s * x + c * z]
    return Skeleton(heads, parents)


ASF = """:version 1.10
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name thigh
     direction 0 -1 0
     length 8
     axis 0 0 20  XYZ
     dof rx ry rz
     limits (-160.0 20.0)
            (-70.0 70.0)
            (-60.0 70.0)
  end
  begin
     id 2
     name shin
     direction 0 -1 0
     length 7
     axis 0 0 20  XYZ
     dof rx
  end
:hierarchy
  begin
    root thigh
    thigh shin
  end
"""
AMC = """#!OML:ASF x.ASF
:FULLY-SPECIFIED
:DEGREES
1
root 1 20 3 0 90 0
thigh 0 0 0
shin 0
2
root 1 20 3 0 90 0
thigh 30 -10 5
shin 60
"""
"""A leg of two bones as files of both formats."""
