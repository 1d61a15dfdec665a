"""The trunk: how its bones, few or many, share the bends of another's."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ..._exchange.body_layout import SMPL
from ..._exchange.rigs.roles import SIDES
from ..._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from .figures import Actor, Target, Trunk

_SPINE, _HIPS = SMPL.numbers("pelvis", "spine1", "spine2", "spine3"), SMPL.both("hip")
(_NECK,) = SMPL.numbers("neck")


def trunk_of(actor: Actor) -> Trunk:
    """Return the trunk of an actor that has our joints: pelvis and three joints of the spine."""
    hips = actor.rest[list(_HIPS)].mean(0)
    points = actor.rest[[*_SPINE, _NECK]]
    heights = _heights((points[:-1] + points[1:]) / 2, hips, actor.rest[_NECK])
    return Trunk(heights, np.stack([actor.turns[:, joint] for joint in _SPINE]))


def rig_trunk(rest: Target, turns: np.ndarray) -> Trunk:
    """Return the trunk of a rig that plays.

    Args:
        rest: N bones at rest.
        turns: (N, F, 3, 3) their rotations from rest.
    """
    line = [rest.index("pelvis"), *_spine(rest)]
    points = np.stack([*rest.heads[line], _top(rest, line[-1])])
    return Trunk(_heights((points[:-1] + points[1:]) / 2, _base(rest), points[-1]), turns[line])


def spine_heights(target: Target) -> Iterator[tuple[int, float]]:
    """Yield each bone of a spine and the height of its middle, infinite of the topmost, which turns as the chest."""
    spine = _spine(target)
    if not spine:
        return
    end = _top(target, spine[-1])
    for bone, after in pairwise(spine):
        middle = (target.heads[bone] + target.heads[after]) / 2
        yield bone, float(_heights(middle[None], _base(target), end)[0])
    yield spine[-1], np.inf


def trunk_ends(target: Target) -> tuple[np.ndarray, np.ndarray, int]:
    """Return where a trunk begins and ends at rest (3,), and the control that turns its chest."""
    chest = (_spine(target) or [target.index("pelvis")])[-1]
    return _base(target), _top(target, chest), chest


def turn_at(trunk: Trunk, height: float) -> np.ndarray:
    """Return the (F, 3, 3) rotation of a trunk at a height, by the geodesic between neighbours."""
    nodes = trunk.heights
    if len(nodes) == 1 or not height < nodes[-1]:
        return trunk.turns[-1]
    upper = int(np.clip(np.searchsorted(nodes, height), 1, len(nodes) - 1))
    share = np.clip((height - nodes[upper - 1]) / max(nodes[upper] - nodes[upper - 1], 1e-9), 0.0, 1.0)
    return between(trunk.turns[upper - 1], trunk.turns[upper], float(share))


def between(R0: np.ndarray, R1: np.ndarray, share: float) -> np.ndarray:
    """Return ``R0 exp(w log(R0^T R1))``."""
    return R0 @ matrix_from_rotvec(share * rotvec_from_matrix(R0.swapaxes(-1, -2) @ R1))


def _heights(points: np.ndarray, base: np.ndarray, end: np.ndarray) -> np.ndarray:
    axis = end - base
    return (points - base) @ axis / (axis @ axis)


def _spine(target: Target) -> list[int]:
    spine = [c for c, role in enumerate(target.roles) if role.startswith("spine_")]
    return sorted(spine, key=lambda c: int(target.roles[c].rpartition("_")[2]))


def _base(target: Target) -> np.ndarray:
    thighs = [target.index(f"{side}_thigh") for side in SIDES]
    return target.heads[thighs].mean(0) if min(thighs) >= 0 else target.heads[target.index("pelvis")]


def _top(target: Target, chest: int) -> np.ndarray:
    """Return the (3,) place where the trunk ends: neck, head or the middle of the shoulders."""
    for role in ("neck_1", "head"):
        if (top := target.index(role)) >= 0:
            return target.heads[top]
    arms = [c for c in (target.index(f"{side}_upper_arm") for side in SIDES) if c >= 0]
    return target.heads[arms].mean(0) if arms else target.heads[chest] + [0.0, 0.0, 1e-3]
