"""How well the bones of a branch are an arm or a leg: costs by lengths, bends and branching, names beside.

Costs are squares of standard deviations, as of independent Gaussians; a name that fits takes off what names are worth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .names import names_part
from .skeleton import Skeleton

_SKIPPED, _OFF_LINE = 0.4, 0.04
"""Cost of a bone inside a segment, as a twist bone is, and how far off the line it may lie, by the segment."""
_HOPELESS = 60.0
"""Cost that neither names nor fingers bring below that of a limb: nothing more is measured then."""
_PALM = 0.4
"""Distance of a hand's middle from the wrist by the forearm, at most; depth cameras have 0.25 to 0.3, CMU's files 0.5
between the bones that they call wrist and hand."""
_LONGEST = 14
"""Bones of a branch that are looked at, from its beginning on: more are hair or rope."""


@dataclass(frozen=True)
class LimbFit:
    """Three joints of a branch as a limb."""

    cost: float
    path: tuple[int, ...]
    """The whole branch along its longest way."""
    places: tuple[int, int, int]
    """Where in it the joints are: hip, knee, ankle or shoulder, elbow, wrist."""

    @property
    def joints(self) -> tuple[int, int, int]:
        """The three bones."""
        i, j, k = self.places
        return self.path[i], self.path[j], self.path[k]


def leg_fits(skeleton: Skeleton, branch: int, named: float) -> list[LimbFit]:
    """Return all ways in which a branch is a leg, the best first; a name that fits takes ``named`` off the cost."""
    return _fits(skeleton, branch, _leg_cost, ("thigh", "shin", "foot"), named)


def arm_fits(skeleton: Skeleton, branch: int, named: float) -> list[LimbFit]:
    """Return all ways in which a branch is an arm, the best first; a name that fits takes ``named`` off the cost."""
    return _fits(skeleton, branch, _arm_cost, ("upper_arm", "forearm", "hand"), named)


def _fits(
    skeleton: Skeleton, branch: int, cost: Callable[[Skeleton, list[int], tuple[int, int, int]], float],
    parts: tuple[str, str, str], named: float,
) -> list[LimbFit]:  # fmt: skip
    path = skeleton.main_path(branch)[:_LONGEST]
    bear = [[names_part(skeleton.names[bone], part) for bone in path] for part in parts]
    found = []
    for places in _triples(len(path)):
        own = cost(skeleton, path, places)
        if np.isfinite(own):
            fitting = sum(bears[p] for p, bears in zip(places, bear, strict=True))
            fitting -= bear[2][places[2]] and places[2] != _joint_of_names(skeleton, path, places[1], bear[2])
            found.append(LimbFit(own - named * fitting, tuple(path), places))
    return sorted(found, key=lambda fit: fit.cost)


def _joint_of_names(skeleton: Skeleton, path: list[int], middle: int, bears: list[bool]) -> int:
    """Return where a limb ends, of the bones after its middle joint that all bear the name of its end.

    It is the first one, unless the next lies farther on than a palm reaches: of depth cameras, the hand is the middle
    of the palm; in Acclaim's skeletons the wrist turns the lower forearm, and the hand's bone begins at the joint.
    """
    joint, *others = (k for k in range(middle + 1, len(path)) if bears[k])
    for k in others:
        if skeleton.distance(path[joint], path[k]) > _PALM * skeleton.distance(path[middle], path[joint]):
            joint = k
    return joint


def _triples(count: int) -> Iterator[tuple[int, int, int]]:
    for i in range(min(count, 5)):
        for j in range(i + 1, count):
            for k in range(j + 1, count):
                yield i, j, k


def _leg_cost(skeleton: Skeleton, path: list[int], places: tuple[int, int, int]) -> float:
    points, (i, j, k) = skeleton.heads[path], places
    thigh, shin = _apart(points, i, j), _apart(points, j, k)
    if min(thigh, shin) < 1e-3 * skeleton.size:
        return np.inf
    # A bone before the thigh leads from the middle to the hip: across the leg, not along it.
    along = float((points[i] - points[0]) @ (points[j] - points[i])) / thigh**2
    cost = _log_cost(shin / thigh, 0.95, 0.15) + (along / 0.1) ** 2 + (_apart(points, 0, i) / (0.5 * thigh)) ** 2
    if cost > _HOPELESS:
        return np.inf
    cost += 0.3 * i + _line_cost(points, i, j) + _line_cost(points, j, k)
    if k + 1 >= len(path):
        return cost + 4.0
    ahead = points[k + 1 :] - points[k]
    far = np.linalg.norm(ahead, axis=1)
    toe = int(np.abs(np.log(np.maximum(far, 1e-9) / (0.33 * shin))).argmin())
    if far[toe] < 1e-6 * skeleton.size:
        return cost + 4.0
    bend = _angle_deg(ahead[toe], points[k] - points[j])
    return cost + _log_cost(far[toe] / shin, 0.33, 0.4) + ((bend - 65.0) / 30.0) ** 2


def _arm_cost(skeleton: Skeleton, path: list[int], places: tuple[int, int, int]) -> float:
    points, (i, j, k) = skeleton.heads[path], places
    upper, fore = _apart(points, i, j), _apart(points, j, k)
    if min(upper, fore) < 1e-3 * skeleton.size:
        return np.inf
    clavicle = _apart(points, 0, i)
    cost = _log_cost(fore / upper, 0.92, 0.2)
    cost += _log_cost(clavicle / upper, 0.5, 0.4) + (i - 1) if clavicle > 0.02 * upper else 1.5 + i
    if cost > _HOPELESS:
        return np.inf
    cost += _line_cost(points, i, j) + _line_cost(points, j, k)
    hand = path[k]
    rest = skeleton.reach[hand]
    cost += min(_log_cost(rest / fore, 0.65, 0.5), 2.0 if rest < fore else np.inf) if rest > 0.02 * fore else 1.5
    fingers = sum(skeleton.distance(hand, c) + skeleton.reach[c] > 0.03 * fore for c in skeleton.children[hand])
    return cost - (4.0 if fingers >= 3 else 2.0 if fingers == 2 else 0.0)


def _line_cost(points: np.ndarray, a: int, b: int) -> float:
    """Return what the bones inside a segment cost: they lie on it, one after the other."""
    if b == a + 1:
        return 0.0
    between, way = points[a + 1 : b] - points[a], points[b] - points[a]
    along = between @ way / (way @ way)
    off = between - along[:, None] * way
    off2 = float((off * off).sum()) / float(way @ way)
    ordered = all(after - before > -1e-6 for before, after in pairwise((0.0, *along, 1.0)))
    return _SKIPPED * len(between) + off2 / _OFF_LINE**2 + (0.0 if ordered else 20.0)


def _apart(points: np.ndarray, a: int, b: int) -> float:
    return math.dist(points[a], points[b])


def _log_cost(ratio: float, usual: float, sigma: float) -> float:
    return (math.log(max(ratio, 1e-6) / usual) / sigma) ** 2


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1.0, 1.0))))
