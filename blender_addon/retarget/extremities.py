"""Where feet and hands end at rest: soles from the skin, balls and knuckles from the heads of other bones.

The tail of a bone is no place of a body: files of other programs keep none, and importers make them up.
"""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.rigs.roles import FINGERS, SIDES
from .skin import skin_points

_NEAR = 0.05
"""Share of a shin within which a bone that begins at the ankle is the foot's, as control and skinned bone are."""
_SOLE_SHARE = 0.095
"""Height of the ankle over the sole by the leg's length where no skin shows it (ANSUR II: 0.08 of it for the malleolus
barefoot, and the sole of a shoe)."""
_BELOW_BALL = 0.02
"""The same of the ball of the foot: by so much of the leg at least the sole lies below the toe's joint."""
_LIKELY_SOLE = (0.01, 0.45)
"""Heights of the ankle over the sole by the leg's length that a foot can have; 0.45 is a platform with a high heel."""
_LIKELY_END = (0.08, 0.9)
"""Distance of ball and knuckles from ankle and wrist by the shin or forearm."""


def measure_sole(armature: bpy.types.Object, leg: dict[str, str], heads: np.ndarray, up: np.ndarray) -> float | None:
    """Return the height along ``up`` of a foot's lowest skin, None where no skin is plausible.

    Args:
        armature: the rig.
        leg: names of ``thigh``, ``shin``, ``foot`` and, if there is one, ``toe``.
        heads: (3, 3) of thigh, shin and foot.
        up: (3,) unit vector of the armature's space.
    """
    shin, reach = (float(np.linalg.norm(heads[k + 1] - heads[k])) for k in (1, 0))
    bones = _bones_of_foot(armature, leg, _NEAR * shin)
    points = skin_points(armature, bones, heads[2], shin)
    if not len(points):
        return None
    sole = float((points @ up).min())
    low, high = _LIKELY_SOLE
    return sole if low <= (heads[2] @ up - sole) / (shin + reach) <= high else None


def estimate_sole(heads: np.ndarray, toe: np.ndarray | None, up: np.ndarray) -> float:
    """Return the height of a sole from joints alone: below the ankle by the leg's length, and below the toe's joint."""
    leg = float(np.linalg.norm(np.diff(heads, axis=0), axis=1).sum())
    below_ankle = heads[2] @ up - _SOLE_SHARE * leg
    return float(below_ankle if toe is None else min(below_ankle, toe @ up - _BELOW_BALL * leg))


def end_of(armature: bpy.types.Object, bones: dict[str, str], role: str, before: float) -> np.ndarray:
    """Return the (3,) place where a hand or foot goes on: toe, knuckles, or whatever hangs on it; NaN without any.

    A hand points to the middle finger's knuckle, as our body's does; without one, to the middle of those it has.

    Args:
        armature: the rig.
        bones: by role, fingers included.
        role: of the hand or foot.
        before: length of the forearm or shin.
    """
    side, _, part = role.partition("_")
    knuckle = f"{side}_middle_1"
    knuckles = [knuckle] if knuckle in bones else [f"{side}_{finger}_1" for finger in FINGERS[1:]]
    roles = [f"{side}_toe"] if part == "foot" else knuckles
    data, start = armature.data.bones, np.array(armature.data.bones[bones[role]].head_local, np.float64)
    named = [np.array(data[bones[other]].head_local, np.float64) for other in roles if other in bones]
    if named:
        return np.mean(named, axis=0)
    low, high = _LIKELY_END
    below = np.array([child.head_local for child in data[bones[role]].children], np.float64).reshape(-1, 3)
    far = np.linalg.norm(below - start, axis=1)
    below = below[(far > low * before) & (far < high * before)]
    return below.mean(0) if len(below) else np.full(3, np.nan)


def legs_of(bones: dict[str, str]) -> list[dict[str, str]]:
    """Return the bones of each whole leg by part."""
    parts = ("thigh", "shin", "foot", "toe")
    legs = [{part: bones[f"{side}_{part}"] for part in parts if f"{side}_{part}" in bones} for side in SIDES]
    return [leg for leg in legs if {"thigh", "shin", "foot"} <= leg.keys()]


def _bones_of_foot(armature: bpy.types.Object, leg: dict[str, str], near: float) -> set[str]:
    """Return foot and toe, whatever begins where one of them does, and all that hangs on these."""
    data = armature.data.bones
    starts = [data[leg[part]].head_local for part in ("foot", "toe") if part in leg]
    seeds = {leg["foot"], leg.get("toe", leg["foot"])}
    seeds |= {bone.name for bone in data if any((bone.head_local - start).length < near for start in starts)}
    return {below.name for seed in seeds for below in (data[seed], *data[seed].children_recursive)}
