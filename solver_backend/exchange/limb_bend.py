"""Bend limbs towards goals, move the body within reach of its feet, and fade offsets over time."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from .so3 import matrix_from_rotvec

_STRAIGHTEST = 0.9995  # Largest extension relative to a limb's length, unless the actor's limb is straighter.
_MOST_FOLDED = 1.001  # Smallest distance between a folded limb's ends, relative to the bones' length difference.
_REACHED_M, _HOPELESS_M = 1e-6, 1e3  # Tolerance in metres for reaching a distance, and a cost above that of any offset.
_CLEAR_BEND = 0.05  # Sine of the bend at which the plane of the bones and the anatomical axis have equal weight.


def bend_to(reach: np.ndarray, upper: np.ndarray, lower: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotate the two bones of a limb so that its end reaches a goal.

    First, the lower bone rotates about the hinge n until the ends of the limb have the distance d. If u and v are the
    bones, a bar denotes the part perpendicular to n, and φ is the angle between these parts, the law of cosines gives
    ``|ū| |v̄| cos φ = (d² - |u|² - |v|²)/2 - (u·n)(v·n)``. Then the whole limb swings by the smallest rotation.

    Args:
        reach: (F, 3) vectors from the start of the limb to its goal in metres. If a goal is out of reach, the limb ends
            as close to it as possible.
        upper: (F, 3) vectors along the actor's upper bone with the length of the rig's bone.
        lower: (F, 3) vectors along the lower bone.
        axis: (F, 3) unit vectors along the hinge's anatomical axis, about which bend angles are positive.

    Returns:
        (F, 3, 3) rotations of the upper and of the lower bone.
    """
    a, b = np.linalg.norm(upper, axis=-1), np.linalg.norm(lower, axis=-1)
    distance = np.clip(np.linalg.norm(reach, axis=-1), shortest_reach(upper, lower), longest_reach(upper, lower))
    n = _bend_axis(upper, lower, axis)
    un, vn = _dot(upper, n), _dot(lower, n)
    u, v = upper - un[:, None] * n, lower - vn[:, None] * n
    lengths = np.maximum(np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1), 1e-12)
    cosine = ((distance**2 - a**2 - b**2) / 2 - un * vn) / lengths
    now = np.arctan2(_dot(np.cross(u, v), n), _dot(u, v))
    bend = matrix_from_rotvec((np.arccos(np.clip(cosine, -1.0, 1.0)) - now)[:, None] * n)
    whole = swing(upper + (bend @ lower[..., None])[..., 0], reach)
    return whole, whole @ bend


def longest_reach(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Return the longest reach (...) in metres of limbs with the bones ``upper`` and ``lower`` (..., 3).

    The reach is slightly less than the sum of the bone lengths. If the given bones are straighter than this limit, the
    distance between their ends is returned.
    """
    a, b = np.linalg.norm(upper, axis=-1), np.linalg.norm(lower, axis=-1)
    return np.maximum(_STRAIGHTEST * (a + b), np.linalg.norm(upper + lower, axis=-1))


def shortest_reach(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Return the (...) distance in metres between the ends of fully folded limbs with (..., 3) bones."""
    return _MOST_FOLDED * np.abs(np.linalg.norm(upper, axis=-1) - np.linalg.norm(lower, axis=-1))


def _bend_axis(upper: np.ndarray, lower: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the (F, 3) bend axis ``n ∝ u × v / (|u| |v|) + ε a``, where a is the anatomical axis."""
    along = _unit(upper + lower)
    square = _unit(axis - _dot(axis, along)[:, None] * along)
    n = np.cross(_unit(upper), _unit(lower)) + _CLEAR_BEND * square
    return np.where(np.linalg.norm(n, axis=-1, keepdims=True) > 0.4 * _CLEAR_BEND, _unit(n), square)


def swing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest (F, 3, 3) rotations that map (F, 3) directions a to b."""
    a, b = _unit(a), _unit(b)
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, _dot(a, b)[:, None])
    return matrix_from_rotvec(axis * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 0.0))


_ON_AXIS_M = 1e-9  # Distance from the axis in metres below which a direction is undefined.


def within_reach(
    hips: np.ndarray, ankles: np.ndarray, reaches: np.ndarray, folded: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return the smallest (F, 3) body offset in metres that lets all L legs reach their feet.

    If c is the vector from a hip to its ankle, the offset w satisfies ``folded <= |c - w| <= reaches``. The smallest w
    is 0, or is on a sphere around one c, or on the circle where two spheres intersect. If no offset suits all legs, the
    offset with the smallest remaining error is returned.

    Args:
        hips, ankles: (L, F, 3) positions in metres.
        reaches: (L, F) longest distances from hip to ankle in metres.
        folded: (L, F) shortest distances, which are the length differences between thigh and shin.
    """
    ways = ankles - hips
    spheres = [[(way, far), (way, near)] for way, far, near in zip(ways, reaches, folded + 0.0 * reaches, strict=True)]
    tried = [np.zeros_like(ways[0]), *(way - r[:, None] * _unit(way) for leg in spheres for way, r in leg)]
    for one, other in combinations(spheres, 2):
        tried += [_on_circle(*a, *b) for a in one for b in other]
    offsets = np.stack(tried)
    apart = np.linalg.norm(ways[:, None] - offsets, axis=-1)
    off = np.maximum(apart - reaches[:, None], (folded + 0.0 * reaches)[:, None] - apart).max(axis=0)
    cost = np.where(off < _REACHED_M, np.linalg.norm(offsets, axis=-1), _HOPELESS_M + off)
    return np.take_along_axis(offsets, cost.argmin(axis=0)[None, :, None], axis=0)[0]


def _on_circle(a: np.ndarray, r: np.ndarray, b: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the (F, 3) points nearest to the origin that are on two spheres (centres a, b, radii r, q).

    If the spheres do not touch, points in the gap between them are returned.
    """
    distance = np.linalg.norm(b - a, axis=-1)
    along = _unit(b - a)
    share = np.where(
        distance > r + q, (distance + r - q) / 2, (distance**2 + r**2 - q**2) / (2 * np.maximum(distance, 1e-9))
    )
    centre = a + share[:, None] * along
    radius = np.sqrt(np.maximum(r**2 - share**2, 0.0))
    across = _dot(centre, along)[:, None] * along - centre
    if (on_axis := np.linalg.norm(across, axis=-1) < _ON_AXIS_M).any():  # all points on the circle are equally near
        across[on_axis] = np.cross(along, np.eye(3)[np.abs(along).argmin(-1)])[on_axis]
    return centre + radius[:, None] * _unit(across)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1)


def eased(held: np.ndarray, fixed: np.ndarray, frames: float) -> np.ndarray:
    """Return offsets (F, n) that equal ``held`` in the fixed frames, and fade to 0 within ``frames`` frames."""
    if not len(fixed):
        return np.zeros_like(held)
    index = np.arange(len(held))
    after = np.searchsorted(fixed, index, side="left").clip(max=len(fixed) - 1)
    before = (np.searchsorted(fixed, index, side="right") - 1).clip(min=0)
    share = [fade(1.0 - np.abs(index - fixed[near]) / (frames + 1), 0.0, 1.0) for near in (before, after)]
    total = np.maximum(share[0] + share[1], 1.0)
    faded = (share[0] / total)[:, None] * held[fixed[before]] + (share[1] / total)[:, None] * held[fixed[after]]
    faded[fixed] = held[fixed]
    return faded


def fade(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return the smooth step ``3 x^2 - 2 x^3``, which is 0 below ``low`` and 1 above ``high``."""
    x = np.clip((value - low) / (high - low), 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
