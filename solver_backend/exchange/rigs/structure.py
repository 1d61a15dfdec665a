"""Recognise bone roles from the structure of a skeleton: tree, symmetry, lengths, and names."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .names import finger_roles, guess_roles, names_part, side_of_name
from .skeleton import FINGERS, LIMBS, SIDES, Skeleton, is_plausible

_SKIPPED, _OFF_LINE = 0.4, 0.04
"""Cost of an extra bone within a segment, such as a twist bone, and tolerated distance from the segment (relative)."""
_HOPELESS = 60.0  # Cost above which a branch cannot be a limb, so that measuring stops.
_PALM = 0.4
"""Largest distance from the wrist to the middle of the hand, in forearm lengths. Depth cameras have 0.25 to 0.3. In
CMU's files, the bones called wrist and hand are 0.5 apart."""
_LONGEST = 14  # Largest number of bones examined along a branch. Longer branches are hair or ropes.


@dataclass(frozen=True)
class LimbFit:
    """Three joints of a branch, interpreted as a limb."""

    cost: float
    path: tuple[int, ...]
    places: tuple[int, int, int]  # Indices of the joints: hip, knee, ankle or shoulder, elbow, wrist.

    @property
    def joints(self) -> tuple[int, int, int]:
        """Indices of the three bones of the limb, from the trunk outwards."""
        i, j, k = self.places
        return self.path[i], self.path[j], self.path[k]


def _limb_fits(skeleton: Skeleton, branch: int, limb: str, named: float) -> list[LimbFit]:
    parts, cost = LIMBS[f"left_{limb}"], _leg_cost if limb == "leg" else _arm_cost
    path = skeleton.main_path(branch)[:_LONGEST]
    bear = [[names_part(skeleton.names[bone], part.removeprefix("left_")) for bone in path] for part in parts]
    found = []
    for places in _triples(len(path)):
        own = cost(skeleton, path, places)
        if np.isfinite(own):
            fitting = sum(bears[p] for p, bears in zip(places, bear, strict=True))
            fitting -= bear[2][places[2]] and places[2] != _joint_of_names(skeleton, path, places[1], bear[2])
            found.append(LimbFit(own - named * fitting, tuple(path), places))
    return sorted(found, key=lambda fit: fit.cost)


def _joint_of_names(skeleton: Skeleton, path: list[int], middle: int, bears: list[bool]) -> int:
    """Choose the wrist or ankle among the bones below a limb's middle joint that have a matching name.

    The first of these bones is preferred, because depth cameras track the middle of the palm as a second hand joint. If
    the next of these bones is further away than a palm's length, it is chosen instead. For example, the wrist in
    Acclaim skeletons rotates the lower forearm, and the hand bone starts at the anatomical wrist.
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
    # A bone above the thigh leads sideways from the middle to the hip.
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
    """Return a cost for bones between a and b that are off the line from a to b, or out of order."""
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


_LEAST_REACH = 0.15  # Smallest size of a limb relative to the skeleton.
_MOST, _MARGIN = 16.0, 2.0
"""Largest cost of a limb, and smallest cost difference to the next interpretation for a certain result."""
_NAMED, _NAMED_CLEARLY = 1.0, 10.0
"""Cost reduction for a matching name: among mixed names, and if names alone identify all limbs."""
_SAME_PLACE = 0.06  # Distance relative to the limb below which two bones are the same joint.
_CANDIDATES = 8  # Largest number of interpretations of a branch that are compared.
_PAIRS = 40  # Largest number of leg or arm pairs that are combined. Rigs with hundreds of bones have many other pairs.
_LEG, _ARM = ("thigh", "shin", "foot", "toe"), ("clavicle", "upper_arm", "forearm", "hand")
_PARALLEL = 0.9  # Smallest cosine between hip and shoulder axes at which positions determine the sides of the arms.
_MIDDLE = 0.04
"""Largest distance of a bone from the midplane, relative to the skeleton's size."""


@dataclass(frozen=True)
class StructureGuess:
    """Roles indicated by the structure of a skeleton."""

    roles: dict[str, str]  # Bone for each role. Empty if there is no humanoid.
    doubts: tuple[str, ...]  # One sentence per uncertainty. Uncertain roles are omitted.


@dataclass(frozen=True)
class _Limbs:
    cost: float
    legs: tuple[LimbFit, LimbFit]
    arms: tuple[LimbFit, LimbFit]


def recognise(skeleton: Skeleton) -> StructureGuess:
    """Recognise a person's bones by the structure of the skeleton. Return only the certain roles.

    Legs and arms are the two cheapest pairs of similar branches. The cost depends on segment ratios, the angle between
    foot and shin, the fingers of a hand, and the direction of the legs relative to the trunk.
    """
    ranked = _ranked_limbs(skeleton)
    if not ranked or ranked[0].cost > 2 * _MOST:
        return StructureGuess({}, ())
    best = ranked[0]
    if _is_quadruped(skeleton, best):
        return StructureGuess({}, ("All four limbs stand on the floor, so the rig is not a person.",))
    up = _middle(skeleton, best.arms, 0) - _middle(skeleton, best.legs, 0)
    left, doubts = _left_first(skeleton, best, up / np.linalg.norm(up))
    if doubts:
        return StructureGuess({}, tuple(doubts))
    roles: dict[str, int] = {}
    for s, side in enumerate(SIDES):
        _add_leg(roles, skeleton, best.legs[s if left else 1 - s], side)
        _add_arm(roles, skeleton, best.arms[s if left else 1 - s], side)
    doubts = _unsure(skeleton, roles, best, ranked[1:])
    doubts += _add_trunk(roles, skeleton, best, up)
    return StructureGuess({role: skeleton.names[bone] for role, bone in roles.items()}, tuple(doubts))


def _ranked_limbs(skeleton: Skeleton) -> list[_Limbs]:
    pairs = [pair for pair in skeleton.pairs() if skeleton.reach[pair[0]] > _LEAST_REACH * skeleton.size]
    named = _NAMED_CLEARLY if _is_named(skeleton) else _NAMED
    legs = [fit for pair in pairs for fit in _paired(*(_limb_fits(skeleton, branch, "leg", named) for branch in pair))]
    arms = [fit for pair in pairs for fit in _paired(*(_limb_fits(skeleton, branch, "arm", named) for branch in pair))]
    found = []
    for leg in sorted(legs, key=_pair_cost)[:_PAIRS]:
        for arm in sorted(arms, key=_pair_cost)[:_PAIRS]:
            if leg[0].path[0] != arm[0].path[0]:
                cost = _together(skeleton, leg, arm)
                if np.isfinite(cost):
                    found.append(_Limbs(cost, leg, _on_the_same_sides(skeleton, leg, arm)))
    return sorted(found, key=lambda limbs: limbs.cost)


def _pair_cost(pair: tuple[LimbFit, LimbFit]) -> float:
    return pair[0].cost + pair[1].cost


def _is_named(skeleton: Skeleton) -> bool:
    parents = {name: skeleton.names[p] for name, p in zip(skeleton.names, skeleton.parents, strict=True) if p >= 0}
    found = guess_roles(skeleton.names, parents)
    return {role for roles in LIMBS.values() for role in roles} <= found.keys() and is_plausible(found, skeleton)


def _on_the_same_sides(
    skeleton: Skeleton, legs: tuple[LimbFit, LimbFit], arms: tuple[LimbFit, LimbFit]
) -> tuple[LimbFit, LimbFit]:
    """Order the arms like the legs, for example left before right.

    The positions of the limbs determine the order. If the positions are ambiguous, clear names determine it.
    """
    ways = [skeleton.heads[a.joints[0]] - skeleton.heads[b.joints[0]] for a, b in (legs, arms)]
    cosine = float(ways[0] @ ways[1]) / max(float(np.prod(np.linalg.norm(ways, axis=1))), 1e-12)
    votes = [_side_votes(skeleton, pair[0].path[0], pair[1].path[0]) for pair in (legs, arms)]
    named = [left - right for left, right in votes]
    if abs(cosine) < _PARALLEL and all(
        abs(n) >= 2 and abs(n) >= 0.9 * sum(v) for n, v in zip(named, votes, strict=True)
    ):
        cosine = float(named[0] * named[1])
    return arms if cosine > 0 else (arms[1], arms[0])


def _paired(left: list[LimbFit], right: list[LimbFit]) -> list[tuple[LimbFit, LimbFit]]:
    others = {fit.places: fit for fit in right}
    return [(fit, others[fit.places]) for fit in left[:_CANDIDATES] if fit.places in others and fit.cost < _MOST]


def _together(skeleton: Skeleton, legs: tuple[LimbFit, LimbFit], arms: tuple[LimbFit, LimbFit]) -> float:
    """Return the cost of the assumption that legs and arms belong to one person, inf if they cannot."""
    hang_legs, hang_arms = (skeleton.above(pair[0].path[0])[1:] for pair in (legs, arms))
    if set(legs[0].path) & set(hang_arms) or set(arms[0].path) & set(hang_legs):
        return np.inf
    hips, shoulders = _middle(skeleton, legs, 0), _middle(skeleton, arms, 0)
    leg, arm = (sum(skeleton.distance(*fit.joints[k : k + 2]) for k in (0, 1)) for fit in (legs[0], arms[0]))
    trunk = shoulders - hips
    size = float(np.linalg.norm(trunk))
    if size < 1e-6 * skeleton.size:
        return np.inf
    cost = (np.log(size / leg / 0.62) / 0.35) ** 2 + (np.log(arm / leg / 0.64) / 0.3) ** 2
    # The further the arms are from the legs along the tree, the more likely there is a trunk between them.
    between = len(set(hang_arms) - set(hang_legs))
    cost += 4.0 if between == 0 else 0.0
    return float(cost + (legs[0].cost + legs[1].cost + arms[0].cost + arms[1].cost) / 2)


def _middle(skeleton: Skeleton, pair: tuple[LimbFit, LimbFit], joint: int) -> np.ndarray:
    return skeleton.heads[[fit.joints[joint] for fit in pair]].mean(0)


def _is_quadruped(skeleton: Skeleton, limbs: _Limbs) -> bool:
    trunk = _middle(skeleton, limbs.arms, 0) - _middle(skeleton, limbs.legs, 0)
    ways = [_middle(skeleton, pair, 2) - _middle(skeleton, pair, 0) for pair in (limbs.legs, limbs.arms)]
    trunk, leg, arm = (v / max(float(np.linalg.norm(v)), 1e-12) for v in (trunk, *ways))
    return bool(abs(leg @ trunk) < 0.5 and leg @ arm > 0.75)


def _left_first(skeleton: Skeleton, limbs: _Limbs, up: np.ndarray) -> tuple[bool, list[str]]:
    """Return whether the first limb of each pair is the left one, and warnings.

    The direction of the toes determines the sides. If it is unclear, the bone names determine them.
    """
    apart = skeleton.heads[limbs.legs[0].joints[0]] - skeleton.heads[limbs.legs[1].joints[0]]
    ahead = np.zeros(3)
    for fit in limbs.legs:
        toe = _toe(skeleton, fit)
        if toe is not None:
            ahead += skeleton.heads[toe] - skeleton.heads[fit.joints[2]]
    votes = [_side_votes(skeleton, pair[0].path[0], pair[1].path[0]) for pair in (limbs.legs, limbs.arms)]
    votes_left = sum(vote[0] for vote in votes) - sum(vote[1] for vote in votes)
    unanimous = abs(votes_left) >= 0.9 * sum(map(sum, votes)) and abs(votes_left) >= 4
    shown = float(np.cross(up, ahead) @ apart)
    clear = abs(shown) > 0.02 * np.linalg.norm(apart) * skeleton.size
    if clear and unanimous and (shown > 0) != (votes_left > 0):
        return True, ["The names and the toes disagree about left and right. Correct the table."]
    if clear:
        return shown > 0, []
    return votes_left > 0, [] if unanimous else ["Neither the toes nor the names show which side is left."]


def _side_votes(skeleton: Skeleton, a: int, b: int) -> tuple[int, int]:
    counts = [0, 0]
    for branch, side in ((a, 0), (b, 1)):
        for bone in skeleton.below(branch):
            name = side_of_name(skeleton.names[bone])
            if name:
                counts[side if name == SIDES[0] else 1 - side] += 1
    return counts[0], counts[1]


def _toe(skeleton: Skeleton, fit: LimbFit) -> int | None:
    """Return the most likely toe bone, whose distance from the ankle is about a third of the shin, or None."""
    _, knee, ankle = fit.joints
    shin = skeleton.distance(knee, ankle)
    after = [bone for bone in skeleton.below(ankle)[1:] if 0.15 < skeleton.distance(bone, ankle) / shin < 0.9]

    def cost(bone: int) -> float:
        off = np.log(skeleton.distance(bone, ankle) / shin / 0.33) / 0.4
        return float(off**2) - _NAMED * names_part(skeleton.names[bone], "toe")

    return min(after, key=cost, default=None)


def _add_leg(roles: dict[str, int], skeleton: Skeleton, fit: LimbFit, side: str) -> None:
    roles |= {f"{side}_{part}": bone for part, bone in zip(("thigh", "shin", "foot"), fit.joints, strict=True)}
    if (toe := _toe(skeleton, fit)) is not None:
        roles[f"{side}_toe"] = toe


def _add_arm(roles: dict[str, int], skeleton: Skeleton, fit: LimbFit, side: str) -> None:
    roles |= {f"{side}_{part}": bone for part, bone in zip(("upper_arm", "forearm", "hand"), fit.joints, strict=True)}
    if fit.places[0] > 0:
        roles[f"{side}_clavicle"] = fit.path[fit.places[0] - 1]
    fingers = finger_roles(skeleton, fit.joints[2], skeleton.distance(fit.joints[1], fit.joints[2]))
    roles |= {f"{side}_{role}": bone for role, bone in fingers.items()}


def _differ(skeleton: Skeleton, one: tuple[LimbFit, LimbFit], other: tuple[LimbFit, LimbFit]) -> bool:
    sides = [{fit.joints for fit in pair} for pair in (one, other)]
    if {fit.path[0] for fit in one} != {fit.path[0] for fit in other}:
        return sides[0] != sides[1]
    size = skeleton.distance(one[0].joints[0], one[0].joints[1]) + skeleton.distance(*one[0].joints[1:])
    same = next(fit for fit in other if fit.path[0] == one[0].path[0])
    return any(skeleton.distance(a, b) > _SAME_PLACE * size for a, b in zip(one[0].joints, same.joints, strict=True))


def _unsure(skeleton: Skeleton, roles: dict[str, int], best: _Limbs, others: list[_Limbs]) -> list[str]:
    """Remove the roles of legs or arms if another interpretation is almost as likely. Return messages."""
    doubts = []
    for limb, parts in (("legs", _LEG), ("arms", (*_ARM, *FINGERS))):
        own = getattr(best, limb)
        rival = next((o for o in others if _differ(skeleton, own, getattr(o, limb))), None)
        if rival is not None and rival.cost - best.cost < _MARGIN:
            doubts.append(f"The bones of the {limb} are ambiguous. Choose them in the table.")
            for role in [r for r in roles if r.partition("_")[2].rstrip("_123") in parts]:
                del roles[role]
    return doubts


def _add_trunk(roles: dict[str, int], skeleton: Skeleton, limbs: _Limbs, up: np.ndarray) -> list[str]:
    from_legs = skeleton.above(limbs.legs[0].path[0])[1:]
    from_arms = skeleton.above(limbs.arms[0].path[0])[1:]
    common = next((bone for bone in from_legs if bone in from_arms), None)
    if common is None:
        return ["Legs and arms have different root bones. Choose the bones in the table."]
    leg = sum(skeleton.distance(*limbs.legs[0].joints[k : k + 2]) for k in (0, 1))
    hips = _middle(skeleton, limbs.legs, 0)
    if np.linalg.norm(skeleton.heads[common] - hips) > 0.5 * leg:
        return ["Pelvis and trunk are separate children of one root. Choose the pelvis in the table."]
    roles["pelvis"] = common
    if (root := skeleton.above(common)[-1]) != common:
        roles["root"] = root
    spine = from_arms[: from_arms.index(common)][::-1]
    roles |= {f"spine_{i + 1}": bone for i, bone in enumerate(spine)}
    return _add_head(roles, skeleton, limbs, [*spine[::-1], common], up)


def _add_named_head(roles: dict[str, int], skeleton: Skeleton, trunk: list[int]) -> list[str]:
    """Add the roles of head and neck if exactly one bone is named as a head. Otherwise, return a message."""
    heads = [bone for bone in skeleton.below(trunk[0]) if names_part(skeleton.names[bone], "head")]
    if len(heads) != 1:
        return ["No head was found."]
    neck = [bone for bone in skeleton.above(heads[0])[1:][::-1] if bone not in skeleton.above(trunk[0])]
    roles |= {"head": heads[0]} | {f"neck_{i + 1}": bone for i, bone in enumerate(neck)}
    return []


def _add_head(roles: dict[str, int], skeleton: Skeleton, limbs: _Limbs, trunk: list[int], up: np.ndarray) -> list[str]:
    side = skeleton.heads[limbs.arms[0].joints[0]] - skeleton.heads[limbs.arms[1].joints[0]]
    side = side / np.linalg.norm(side)
    shoulders, length = _middle(skeleton, limbs.arms, 0), float(up @ up)

    def height(bone: int) -> float:
        return float((skeleton.heads[bone] - shoulders) @ up / length)

    def in_middle(bone: int) -> bool:
        return abs((skeleton.heads[bone] - shoulders) @ side) < _MIDDLE * skeleton.size

    taken = {limbs.arms[0].path[0], limbs.arms[1].path[0], *trunk}
    starts = [c for bone in trunk[:2] for c in skeleton.children[bone] if c not in taken and in_middle(c)]
    starts = [c for c in starts if max(height(b) for b in skeleton.below(c) if in_middle(b)) > 0.1]
    if not starts:
        return _add_named_head(roles, skeleton, trunk)
    line = [max(starts, key=lambda c: (max(height(b) for b in skeleton.below(c)), skeleton.counts[c]))]
    while inner := [c for c in skeleton.children[line[-1]] if in_middle(c) and height(c) > height(line[-1]) - 0.02]:
        line.append(max(inner, key=lambda c: (skeleton.counts[c], height(c))))

    def cost(bone: int) -> float:
        named = {part: names_part(skeleton.names[bone], part) for part in ("head", "neck")}
        high = ((height(bone) - 0.3) / 0.12) ** 2
        return high - 2.0 * named["head"] - 1.0 * (len(skeleton.children[bone]) >= 2) + 0.5 * named["neck"]

    head = int(np.argmin([cost(bone) for bone in line]))
    roles["head"] = line[head]
    roles |= {f"neck_{i + 1}": bone for i, bone in enumerate(line[:head])}
    return []
