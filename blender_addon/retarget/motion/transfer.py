"""Transfer an actor's motion to the rotations and positions of a rig's controls, in stage coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._exchange.body_layout import SMPL
from ..._exchange.ground_path import ground_path
from ..._exchange.limb_bend import bend_to, longest_reach, shortest_reach, within_reach
from ..._exchange.rigs.rest_frames import anatomical_axis, limb_frame
from ..._exchange.rigs.skeleton import HELPER_OF, JOINT_OF, LIMB_OF_POLE, LIMBS, SIDES
from . import limbs
from .figures import Actor, Target, carried_places
from .foreign_actor import find_low_feet
from .limbs import hips_of
from .map_pose import length, measure_proportions, scale_of
from .touch import keep_hands_on_body, keep_hands_together

(_NECK, _HEAD), _HIPS = SMPL.numbers("neck", "head"), SMPL.both("hip")


@dataclass(frozen=True)
class TransferSettings:
    """Settings for the transfer of a motion to a rig."""

    in_place: bool = False  # Remove the travel over the ground.
    root_motion: bool = False  # Transfer the travel over the ground and the heading to the root bone.
    hold_contacts: bool = True
    """Lock planted feet, and keep hands in contact with the body and with each other."""
    scale: float = 0.0
    """Scale of travel and steps relative to the actor. 0 uses the ratio of the leg lengths, if it is plausible."""


@dataclass(frozen=True)
class Transferred:
    """Result of a transfer: the motion of a rig's N controls over F frames."""

    turns: np.ndarray  # (N, F, 3, 3) rotations from the rest pose, on the stage.
    places: np.ndarray  # (N, F, 3) bone heads, on the stage.
    carrier: int  # Index of the control that carries the body along its path.
    scale: float  # Leg length of the target relative to the actor's.
    goals: dict[str, np.ndarray]  # (F, 3) wrist and ankle positions, by the role of the hand or foot.
    beyond_m: float = 0.0  # Largest distance in metres by which a touching point was out of the arm's reach.

    def missed_m(self, target: Target) -> float:
        """Return the largest distance in metres between a hand or foot of this motion and its goal."""
        off = [self.places[target.index(role)] - goal for role, goal in self.goals.items()]
        return float(np.linalg.norm(off, axis=-1).max()) if off else 0.0


def transfer(actor: Actor, target: Target, A: np.ndarray, settings: TransferSettings) -> Transferred:
    """Transfer a motion by the rotations ``D_c = D_j A_c``, and scale the paths of feet and hands.

    D_j is the actor's rotation of the joint that rotates control c, and A_c is the map pose. The hips follow the
    actor's hips. If a leg is too short to reach its goal, the hips move. Finally, every limb is bent to reach its goal.
    """
    scale = settings.scale or scale_of(measure_proportions(actor, target))
    carrier = target.index("carrier") if "carrier" in target.roles else target.index("pelvis")
    root, path = target.index("root"), ground_path(scale * actor.joints[:, 0], actor.turns[:, 0], actor.fps)
    turns = _turns(actor, target, A)
    travels = settings.root_motion and not settings.in_place and root >= 0
    if travels:
        turns[root] = path.turns
    shift = -path.way if settings.in_place else 0.0
    goals = _foot_goals(actor, target, turns, scale, settings)
    goals = {role: goal + shift for role, goal in goals.items()}
    still = carried_places(target, turns, carrier, np.zeros((actor.num_frames, 3)))
    way = _hips_path(actor, target, scale) + shift - hips_of(target, still)
    way = way + _for_reach(target, turns, still + way * _carried(target, carrier)[:, None, None], goals)
    places = carried_places(target, turns, carrier, way)
    goals |= _hand_goals(actor, target, places)
    beyond = 0.0
    _bend_limbs(actor, target, turns, places, A, goals)
    places = carried_places(target, turns, carrier, way)
    if settings.hold_contacts:
        # Thighs and the other arm must be final before a hand is kept in contact with them.
        touching = keep_hands_on_body(actor, target, A, turns, places, goals, scale)
        touching = keep_hands_together(actor, target, turns, touching)
        goals, beyond = within_arms(target, turns, places, goals, touching)
        _bend_limbs(actor, target, turns, places, A, goals)
        places = carried_places(target, turns, carrier, way)
    if travels:
        places[root] = target.heads[root] + path.way
    _follow_limbs(actor, target, turns, places, A)
    return Transferred(turns, places, carrier, scale, goals, beyond)


def _turns(actor: Actor, target: Target, A: np.ndarray) -> np.ndarray:
    turns = np.broadcast_to(np.eye(3), (len(target.names), actor.num_frames, 3, 3)).copy()
    trunk, heights = actor.trunk or limbs.trunk_of(actor), dict(limbs.spine_heights(target))
    for c, role in enumerate(target.roles):
        if role == "carrier":
            turns[c] = actor.turns[:, 0]
        elif role.startswith("spine_"):
            turns[c] = limbs.turn_at(trunk, heights[c]) @ A[c]
        elif role.startswith("neck_"):
            necks = sum(other.startswith("neck_") for other in target.roles)
            share = (int(role.rpartition("_")[2]) - 1) / necks
            turns[c] = limbs.between(actor.turns[:, _NECK], actor.turns[:, _HEAD], share) @ A[c]
        elif role in JOINT_OF:
            turns[c] = actor.turns[:, JOINT_OF[role]] @ A[c]
    limbs.bend_fingers(actor, target, A, turns)
    return turns


def _foot_goals(
    actor: Actor, target: Target, turns: np.ndarray, scale: float, settings: TransferSettings
) -> dict[str, np.ndarray]:
    """Return ankle goals (F, 3) by role. With ``hold_contacts``, also rotate planted feet and toes in ``turns``."""
    low = find_low_feet(actor.rest, actor.joints, actor.contacts)
    goals = {}
    for path in limbs.foot_paths(actor, target, turns, scale):
        if settings.hold_contacts:
            path = limbs.steadied(path, low[:, int(path.role.startswith(SIDES[1]))], actor.fps)
            foot, toe = target.index(path.role), target.index(path.role.replace("foot", "toe"))
            if toe >= 0:
                turns[toe] = path.turns @ turns[foot].swapaxes(-1, -2) @ turns[toe]
            turns[foot] = path.turns
        goals[path.role] = path.ankle
    return goals


def _hips_path(actor: Actor, target: Target, scale: float) -> np.ndarray:
    """Return the target's hip path (F, 3): the actor's scaled path, plus the difference of the two ankle heights."""
    hips = scale * actor.joints[:, _HIPS].mean(1)
    feet = [c for c in (target.index(f"{side}_foot") for side in SIDES) if c >= 0]
    if not feet:
        return hips
    ankle = actor.rest[[JOINT_OF["left_foot"], JOINT_OF["right_foot"]], 2].mean()
    rise = target.heads[feet, 2].mean() - scale * ankle
    standing = scale * actor.rest[list(_HIPS), 2].mean()
    hips[:, 2] += rise * np.clip(hips[:, 2] / standing, 0.0, 1.0)
    return hips


def _carried(target: Target, carrier: int) -> np.ndarray:
    carried = np.zeros(len(target.names), dtype=bool)
    for c, m in enumerate(target.moves_with):
        carried[c] = c == carrier or (m >= 0 and carried[m])
    return carried


def _for_reach(target: Target, turns: np.ndarray, places: np.ndarray, goals: dict[str, np.ndarray]) -> np.ndarray:
    legs = {side: [target.index(role) for role in LIMBS[f"{side}_leg"]] for side in SIDES}
    legs = {side: bones for side, bones in legs.items() if min(bones) >= 0}
    if not legs:
        return np.zeros(places.shape[1:])
    bones = [_bones_of(target, turns, leg) for leg in legs.values()]
    return within_reach(
        np.stack([places[leg[0]] for leg in legs.values()]),
        np.stack([goals[f"{side}_foot"] for side in legs]),
        np.stack([longest_reach(*leg) for leg in bones]),
        np.stack([shortest_reach(*leg) for leg in bones]),
    )


def _bones_of(target: Target, turns: np.ndarray, bones: list[int]) -> tuple[np.ndarray, np.ndarray]:
    upper, lower, end = bones
    heads = target.heads
    return turns[upper] @ (heads[lower] - heads[upper]), turns[lower] @ (heads[end] - heads[lower])


def _hand_goals(actor: Actor, target: Target, places: np.ndarray) -> dict[str, np.ndarray]:
    """Return wrist goals (F, 3): the actor's shoulder-to-wrist vectors, scaled by the ratio of the arm lengths."""
    goals = {}
    for side in SIDES:
        roles = LIMBS[f"{side}_arm"]
        bones = [target.index(role) for role in roles]
        if min(bones) >= 0:
            joints = [JOINT_OF[role] for role in roles]
            ratio = length(target.heads[bones]) / length(actor.rest[joints])
            goals[roles[-1]] = places[bones[0]] + ratio * (actor.joints[:, joints[-1]] - actor.joints[:, joints[0]])
    return goals


def within_arms(
    target: Target,
    turns: np.ndarray,
    places: np.ndarray,
    goals: dict[str, np.ndarray],
    touching: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], float]:
    """Move wrist goals (F, 3) of touching hands within the arm's reach. Also return the largest change in metres."""
    kept, beyond = dict(touching), 0.0
    for side in SIDES:
        *_, hand = roles = LIMBS[f"{side}_arm"]
        bones = [target.index(role) for role in roles]
        if min(bones) >= 0 and hand in goals:
            way = touching[hand] - places[bones[0]]
            distance = np.linalg.norm(way, axis=-1)
            planned = np.linalg.norm(goals[hand] - places[bones[0]], axis=-1)
            reach = np.maximum(longest_reach(*_bones_of(target, turns, bones)), planned)
            excess = np.maximum(distance - reach, 0.0)
            kept[hand] = touching[hand] - way * (excess / np.maximum(distance, 1e-9))[:, None]
            beyond = max(beyond, float(excess.max()))
    return kept, beyond


def _bend_limbs(
    actor: Actor, target: Target, turns: np.ndarray, places: np.ndarray, A: np.ndarray, goals: dict[str, np.ndarray]
) -> None:
    for limb, roles in LIMBS.items():
        upper, lower, end = (target.index(role) for role in roles)
        if min(upper, lower, end) >= 0:
            axis = turns[upper] @ A[upper].T @ _hinge_axis(actor, limb)
            bones = _bones_of(target, turns, [upper, lower, end])
            first, second = bend_to(goals[roles[-1]] - places[upper], *bones, axis)
            turns[upper], turns[lower] = first @ turns[upper], second @ turns[lower]


def _follow_limbs(actor: Actor, target: Target, turns: np.ndarray, places: np.ndarray, A: np.ndarray) -> None:
    for c, role in enumerate(target.roles):
        side, _, part = role.partition("_")
        if part not in HELPER_OF:
            continue
        followed, hinge = (target.index(f"{side}_{name}") for name in HELPER_OF[part])
        if min(followed, hinge) < 0:
            continue
        turns[c] = turns[followed]
        if part in LIMB_OF_POLE:
            limb = f"{side}_{LIMB_OF_POLE[part]}"
            bones = [target.index(name) for name in LIMBS[limb]]
            if min(bones) >= 0:
                places[c] = _pole(target, turns, places, c, bones, A, _hinge_axis(actor, limb))
        else:
            places[c] = places[hinge] + turns[followed] @ (target.heads[c] - target.heads[hinge])


def _pole(
    target: Target, turns: np.ndarray, places: np.ndarray, pole: int, bones: list[int], A: np.ndarray, axis: np.ndarray
) -> np.ndarray:
    """Return the positions (F, 3) of an IK pole, which keeps its rest position relative to the limb and its hinge."""
    upper, _, end = bones
    rest = target.heads
    own = limb_frame(rest[end] - rest[upper], A[upper].T @ axis)
    share = own.T @ (rest[pole] - rest[upper]) / [np.linalg.norm(rest[end] - rest[upper]), 1.0, 1.0]
    line = places[end] - places[upper]
    hinges = turns[upper] @ A[upper].T @ axis
    reach = np.stack([share[0] * np.linalg.norm(line, axis=1), *np.broadcast_to(share[1:, None], (2, len(line)))], 1)
    return places[upper] + (limb_frame(line, hinges) @ reach[..., None])[..., 0]


def _hinge_axis(actor: Actor, limb: str) -> np.ndarray:
    start, middle = (actor.rest[JOINT_OF[role]] for role in LIMBS[limb][:2])
    return limb_frame(middle - start, anatomical_axis(middle - start, limb.endswith("arm")))[:, 1]
