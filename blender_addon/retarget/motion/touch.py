"""Keep hands in contact with each other and with the body, on a figure with different proportions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ..._exchange.limb_bend import fade
from ..._exchange.rigs.rest_frames import FORWARD, UP
from ..._exchange.rigs.skeleton import FINGERS, JOINT_OF, SIDES
from .figures import Actor, Hand, Target
from .limbs import trunk_ends

PALM = "palm"  # Name of the palm centre. All other names are fingers.
_HAND_AFTER_WRIST = 2  # SMPL joint number of a hand minus that of the wrist on the same side.
_BONES = 3  # Bones in a finger. A further bone begins at the tip.
_LAST_BONE = 0.9
"""Length of a finger's last bone including the pulp, relative to the bone before it. Bones have a ratio of 0.6 to 0.8
(Buryanov and Kotiuk 2010), and the pulp adds 4 mm."""


@dataclass(frozen=True)
class HandPlace:
    """Palm centre or fingertip of a hand over F frames, on the actor and on the target."""

    side: str
    name: str  # ``PALM`` or the name of the finger.
    place: np.ndarray  # (F, 3) point on the actor: the midpoint between wrist and knuckles, or the tip of a finger.
    size: float  # Metres from the actor's wrist to its knuckles.
    own: np.ndarray  # (F, 3) the same point on the target, with its wrist where it is now.
    own_size: float

    @property
    def role(self) -> str:
        """Role of the hand that this point belongs to."""
        return f"{self.side}_hand"

    @property
    def is_palm(self) -> bool:
        """True for the palm centre, False for a fingertip."""
        return self.name == PALM


def _hand_places(
    actor: Actor, target: Target, turns: np.ndarray, goals: Mapping[str, np.ndarray]
) -> Iterator[HandPlace]:
    """Yield the palm of each hand that has a goal and a known length, and the fingertips that both figures have."""
    fingers = {hand.roles[0].partition("_")[0]: hand for hand in actor.hands}
    for side in SIDES:
        role = f"{side}_hand"
        if role not in goals:
            continue
        wrist, control = JOINT_OF[role], target.index(role)
        reach = actor.rest[wrist + _HAND_AFTER_WRIST] - actor.rest[wrist]
        theirs = target.ends[control] - target.heads[control]
        size, own_size = float(np.linalg.norm(reach)), float(np.linalg.norm(theirs))
        if not (size > 0.0 and own_size > 0.0):  # NaN if nothing shows the knuckles
            continue
        middle = actor.joints[:, wrist] + actor.turns[:, wrist] @ (reach / 2)
        yield HandPlace(side, PALM, middle, size, goals[role] + turns[control] @ (theirs / 2), own_size)
        if side in fingers:
            own_tips = _tips_of_target(target, control, side, turns)
            for finger, tip in _tips_of_actor(fingers[side]).items():
                if finger in own_tips:
                    place = actor.joints[:, wrist] + (actor.turns[:, wrist] @ tip[..., None])[..., 0]
                    yield HandPlace(side, finger, place, size, goals[role] + own_tips[finger], own_size)


def _tips_of_actor(hand: Hand) -> dict[str, np.ndarray]:
    tips = {}
    for finger, rows in _rows_by_finger(hand.roles).items():
        start = np.broadcast_to(hand.starts[rows[0]], (hand.bends.shape[1], 3))
        tips[finger] = start + _reach(hand.starts[rows], hand.bends[rows])
    return tips


def _tips_of_target(target: Target, hand: int, side: str, turns: np.ndarray) -> dict[str, np.ndarray]:
    controls = np.array([c for c, role in enumerate(target.roles) if role.startswith(f"{side}_")])
    tips = {}
    for finger, rows in _rows_by_finger(tuple(target.roles[c] for c in controls)).items():
        bones = controls[rows]
        start = turns[hand] @ (target.heads[bones[0]] - target.heads[hand])
        tips[finger] = start + _reach(target.heads[bones], turns[bones])
    return tips


def _reach(starts: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return the (F, 3) vector in metres from a finger's knuckle to its tip."""
    ways = np.diff(starts, axis=0)
    if len(ways) < _BONES:
        ways = np.concatenate([ways, _LAST_BONE * ways[-1:]])
    return np.einsum("bfij,bj->fi", turns[: len(ways)], ways)


def _rows_by_finger(roles: tuple[str, ...]) -> dict[str, list[int]]:
    """Return the bone indices of each finger that has at least two bones, starting at the knuckle."""
    found = dict[str, list[int]]()
    for row in sorted(range(len(roles)), key=roles.__getitem__):
        finger = roles[row].rpartition("_")[0].partition("_")[2]
        if finger in FINGERS:
            found.setdefault(finger, []).append(row)
    return {finger: rows for finger, rows in found.items() if len(rows) > 1}


_TOUCH, _APART = (0.25, 0.45, 0.7), (0.5, 0.8, 1.1)
"""Distances, in palm lengths, below which two hand points touch and above which they do not: for two fingertips, for a
fingertip and a palm centre, and for two palms, which may be rotated and shifted against each other."""


def keep_hands_together(
    actor: Actor, target: Target, turns: np.ndarray, goals: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return wrist positions (F, 3) by role that keep the target's hands together while the actor's hands touch.

    Each hand moves by half of the mean gap between touching pairs of points. The correction fades out as the contact
    ends.
    """
    places = list(_hand_places(actor, target, turns, goals))
    lefts, rights = ([place for place in places if place.side == side] for side in SIDES)
    if not lefts or not rights:
        return goals
    way, total = np.zeros((actor.num_frames, 3)), np.zeros(actor.num_frames)
    for left in lefts:
        for right in rights:
            share, off = _apart(left, right)
            way += share[:, None] * off
            total += share
    way /= 2.0 * np.maximum(total, 1.0)[:, None]
    left, right = lefts[0].role, rights[0].role
    return goals | {left: goals[left] + way, right: goals[right] - way}


def _apart(left: HandPlace, right: HandPlace) -> tuple[np.ndarray, np.ndarray]:
    """Return how much two points touch (F,), from 0 to 1, and the vector (F, 3) that brings them together."""
    size, own_size = (left.size + right.size) / 2, (left.own_size + right.own_size) / 2
    palms = int(left.is_palm) + int(right.is_palm)
    between = left.place - right.place
    share = 1.0 - fade(np.linalg.norm(between, axis=-1) / size, _TOUCH[palms], _APART[palms])
    return share, own_size / size * between - (left.own - right.own)


CHEST, BASE, TOP = "chest", "base", "top"
"""Further points on the trunk's centre line: the top spine bone, the midpoint of the hips, and the neck."""
_SHARES, _ANGLES = 8, 12  # Table cells along the line and around it. The cells of a thigh are about 5 cm wide.
_OUTER = 0.75  # Quantile of a cell's distances that serves as its radius. It ignores stray hairs.
_LEAST_FILLED = 0.4  # Smallest fraction of cells that must contain skin.


@dataclass(frozen=True)
class Part:
    """A body part: its skin, the role that rotates it, its centre line and the section of the line to use."""

    skin: str
    turned_by: str
    start: str
    end: str  # "" means the highest point of the skin above the start.
    span: tuple[float, float] = (0.0, 1.0)
    table: tuple[float, float] = (0.0, 1.0)  # Section of the line for which the table stores radii.


_WHOLE_TRUNK = (-0.1, 1.0)  # Section from hips to neck. It starts at the lowest point of the seat.
PARTS = {
    "hips": Part("trunk", "pelvis", BASE, TOP, (-0.1, 0.5), _WHOLE_TRUNK),
    CHEST: Part("trunk", CHEST, BASE, TOP, (0.5, 1.0), _WHOLE_TRUNK),
    "head": Part("head", "head", "head", ""),
    **{
        f"{side}_{part}": Part(f"{side}_{part}", f"{side}_{part}", f"{side}_{part}", f"{side}_{after}")
        for side in SIDES
        for part, after in (("thigh", "shin"), ("shin", "foot"), ("upper_arm", "forearm"), ("forearm", "hand"))
    },
}
"""Body parts that hands can touch."""


@dataclass(frozen=True)
class Solid:
    """A body part as radii around a centre line, in the rest axes of the joint that rotates it."""

    origin: np.ndarray  # (3,) vector in metres from the joint to the start of the line.
    axes: np.ndarray  # (3, 3) unit vectors in columns: along the line, to the front, and normal to both.
    length: float
    table: tuple[float, float]
    radii: np.ndarray  # (K, M) metres from the line to the skin, by position along the line and angle from the front.

    def coordinates(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the position along the line, the angle and the distance, each (F,), of (F, 3) points."""
        x = (points - self.origin) @ self.axes
        return x[..., 0] / self.length, np.arctan2(x[..., 2], x[..., 1]), np.hypot(x[..., 1], x[..., 2])

    def place(self, share: np.ndarray, angle: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Convert a position along the line, an angle and a distance back to points (F, 3)."""
        x = np.stack([share * self.length, distance * np.cos(angle), distance * np.sin(angle)], axis=-1)
        return self.origin + x @ self.axes.T

    def radius(self, share: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the distance (F,) from the line to the skin, interpolated linearly between table cells."""
        low, high = self.table
        rows, columns = self.radii.shape
        k = np.clip((share - low) / (high - low) * rows - 0.5, 0.0, rows - 1.0)
        m = (angle / (2 * np.pi) * columns - 0.5) % columns
        k0, m0 = np.minimum(k.astype(int), rows - 2), m.astype(int)
        k1, m1, dk, dm = k0 + 1, (m0 + 1) % columns, k - k0, m - m0
        m0 = m0 % columns
        below = (1 - dm) * self.radii[k0, m0] + dm * self.radii[k0, m1]
        above = (1 - dm) * self.radii[k1, m0] + dm * self.radii[k1, m1]
        return (1 - dk) * below + dk * above


def _solids_of(
    heads: Mapping[str, np.ndarray], turns: Mapping[str, np.ndarray], skin: Mapping[str, np.ndarray]
) -> dict[str, Solid]:
    found = {}
    for name, part in PARTS.items():
        if not {part.turned_by, part.start, part.end or part.start} <= heads.keys() or part.skin not in skin:
            continue
        points, start = skin[part.skin], heads[part.start]
        end = heads[part.end] if part.end else start + UP * max(float(((points - start) @ UP).max()), 0.0)
        solid = _solid(part, points, start, end, heads[part.turned_by], turns.get(part.turned_by, np.eye(3)))
        if solid is not None:
            found[name] = solid
    return found


def _solid(
    part: Part, points: np.ndarray, start: np.ndarray, end: np.ndarray, joint: np.ndarray, turn: np.ndarray
) -> Solid | None:
    length = float(np.linalg.norm(end - start))
    if length < 1e-6:
        return None
    along = turn @ (end - start) / length
    front = FORWARD - (FORWARD @ along) * along
    if np.linalg.norm(front) < 1e-3:
        return None
    front = front / np.linalg.norm(front)
    axes = np.stack([along, front, np.cross(along, front)], axis=1)
    empty = Solid(turn @ (start - joint), axes, length, part.table, np.zeros((_SHARES, _ANGLES)))
    share, angle, distance = empty.coordinates((points - joint) @ turn.T)
    radii = _radii(share, angle, distance, part.table)
    return None if radii is None else Solid(empty.origin, axes, length, part.table, radii)


def _radii(share: np.ndarray, angle: np.ndarray, distance: np.ndarray, table: tuple[float, float]) -> np.ndarray | None:
    """Return a table of skin radii by position and angle, or None if too few cells have skin.

    Cells without skin use the radius of the nearest filled cell. ``table`` is the section of the centre line.
    """
    low, high = table
    k = np.floor((share - low) / (high - low) * _SHARES).astype(int)
    m = np.floor(angle / (2 * np.pi) * _ANGLES).astype(int) % _ANGLES
    inside = (k >= 0) & (k < _SHARES)
    cell, distance = (k * _ANGLES + m)[inside], distance[inside]
    order = np.lexsort((distance, cell))
    cells, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    if len(cells) < _LEAST_FILLED * _SHARES * _ANGLES:
        return None
    known = distance[order][first + np.floor(_OUTER * (count - 1)).astype(int)]
    rows, columns = np.divmod(np.arange(_SHARES * _ANGLES), _ANGLES)
    around = np.abs(columns[:, None] - columns[cells])
    far = np.hypot(rows[:, None] - rows[cells], np.minimum(around, _ANGLES - around))
    return known[far.argmin(axis=1)].reshape(_SHARES, _ANGLES)


_TOUCH_BODY, _APART_BODY = (0.2, 0.35), (0.4, 0.65)
"""Distances from the skin, in palm lengths, below which a hand touches and above which it does not: for a fingertip of
radius 0.1, and for the palm centre, which is 0.2 below the skin of the hand."""
_LIKELY = (0.4, 2.5)  # Plausible radii of the target, relative to the scaled actor's radii.
_CHEST_JOINT, _NECK, _HIPS = 9, 12, (1, 2)  # SMPL joint numbers.


def keep_hands_on_body(
    actor: Actor,
    target: Target,
    A: np.ndarray,
    turns: np.ndarray,
    places: np.ndarray,
    goals: dict[str, np.ndarray],
    scale: float,
) -> dict[str, np.ndarray]:
    """Return wrist positions that keep touching palms and fingertips as far from the skin as on the actor.

    A point has a relative position t along each part's centre line, an angle φ around it, and a distance d from it. The
    target uses the same t and φ, and a distance scaled by hand size: ``r'(t, φ) + (s'/s) (d - r(t, φ))``. The skin's
    radius is r and the hand's length is s on the actor, r' and s' on the target. The correction fades out as the
    contact ends. All touching parts and points of a hand have equal weights.

    Args:
        A: (N, 3, 3) map pose of the target.
        turns: (N, F, 3, 3) rotations of the controls after the limbs were bent to their goals.
        places: (N, F, 3) heads of the controls in metres.
        goals: maps roles, including hands, to (F, 3) goal positions in metres.
        scale: leg length of the target relative to the actor's.
    """
    own, theirs = _solids_of_actor(actor), _solids_of_target(target, A)
    both = [name for name in PARTS if name in own and name in theirs and _is_likely(own[name], theirs[name], scale)]
    ways, totals = dict[str, np.ndarray](), dict[str, np.ndarray]()
    for place in _hand_places(actor, target, turns, goals) if both else ():
        arm = tuple(f"{place.side}_{part}" for part in ("upper_arm", "forearm"))
        way = ways.setdefault(place.role, np.zeros_like(place.own))
        total = totals.setdefault(place.role, np.zeros(len(place.own)))
        for name in both:
            if name in arm:
                continue
            share, goal = _kept_on(actor, place, name, own[name], theirs[name])
            c = _control_of(target, name)
            way += share[:, None] * (places[c] + (turns[c] @ A[c].T @ goal[..., None])[..., 0] - place.own)
            total += share
    return goals | {role: goals[role] + way / np.maximum(totals[role], 1.0)[:, None] for role, way in ways.items()}


def _kept_on(actor: Actor, place: HandPlace, name: str, own: Solid, theirs: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Return a hand point's contact with a body part (F,), from 0 to 1, and its goal (F, 3) on the target's part."""
    joint, (low, high) = _joint_of(name), PARTS[name].span
    inner = np.swapaxes(actor.turns[:, joint], -1, -2) @ (place.place - actor.joints[:, joint])[..., None]
    share, angle, distance = own.coordinates(inner[..., 0])
    off = distance - own.radius(share, angle)
    beyond = own.length * np.maximum(np.maximum(low - share, share - high), 0.0)
    away = np.hypot(np.maximum(off, 0.0), beyond) / place.size
    touching = 1.0 - fade(away, _TOUCH_BODY[place.is_palm], _APART_BODY[place.is_palm])
    kept = theirs.radius(share, angle) + place.own_size / place.size * off
    return touching, theirs.place(share, angle, np.maximum(kept, 0.0))


def _is_likely(own: Solid, theirs: Solid, scale: float) -> bool:
    ratio = float(np.median(theirs.radii)) / max(float(np.median(own.radii)) * scale, 1e-9)
    return _LIKELY[0] < ratio < _LIKELY[1]


def _joint_of(name: str) -> int:
    turned_by = PARTS[name].turned_by
    return _CHEST_JOINT if turned_by == CHEST else JOINT_OF[turned_by]


def _control_of(target: Target, name: str) -> int:
    turned_by = PARTS[name].turned_by
    return trunk_ends(target)[2] if turned_by == CHEST else target.index(turned_by)


def _solids_of_actor(actor: Actor) -> dict[str, Solid]:
    heads = {role: actor.rest[joint] for role, joint in JOINT_OF.items()}
    trunk = {BASE: actor.rest[list(_HIPS)].mean(0), TOP: actor.rest[_NECK], CHEST: actor.rest[_CHEST_JOINT]}
    return _solids_of(heads | trunk, {}, actor.skin)


def _solids_of_target(target: Target, A: np.ndarray) -> dict[str, Solid]:
    base, top, chest = trunk_ends(target)
    heads = dict(zip(target.roles, target.heads, strict=True))
    turns = dict(zip(target.roles, A, strict=True))
    trunk = {BASE: base, TOP: top, CHEST: target.heads[chest]}
    return _solids_of(heads | trunk, turns | {CHEST: A[chest]}, target.skin)
