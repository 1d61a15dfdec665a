"""Stabilise the solution from one camera: smooth its depth, and put planted feet on the floor."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.exchange.rigs.rest_frames import swing
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.fitters.one_view.shape import foot_vertices
from solver_backend.fitters.problem import SolvedFrames
from solver_backend.geometry.arrays import constant, nearest_true, to_numpy, true_runs
from solver_backend.geometry.interpolation import smooth
from solver_backend.geometry.rotations import exp_so3

if TYPE_CHECKING:
    from solver_backend.fitters.one_view.depth import OneView

DEPTH_S, ACROSS_S = 0.067, 0.023
"""Standard deviations of the temporal Gaussian filters along and across the line of sight, in seconds. For a bone
nearly parallel to the image, pixel noise becomes centimetres of depth. 0.05 and 0.1 s change joint errors by < 0.3
mm."""
_LEAST = 1e-6  # Regularises joints without bones, and sigmas of 0.


def steady_depth(solved: SolvedFrames, one: OneView, fps: float) -> SolvedFrames:
    """Smooth bone directions and body position over time, mainly in depth.

    A bone with direction u is rotated to ``G_d (u·s) s + G_a (u - (u·s) s)``, where s is the line of sight, and G_d and
    G_a are Gaussian filters along and across it. A joint with several bones gets the smallest rotation that fits all
    these bones. The root's distance and direction are also smoothed. Bone lengths do not change.
    """
    body, frames, sight = solved.subject.body, solved.frames, one.sight
    if len(sight) < 3:
        return solved
    root, local, transl = (to_numpy(part) for part in (frames.root, frames.local, frames.transl))
    rest = np.asarray(body.rest_joints(to_numpy(solved.subject.betas)))[: local.shape[1] + 1]
    parents = np.array(body.parents[: local.shape[1] + 1])
    G = np.empty((len(root), len(parents), 3, 3))
    G[:, 0] = root
    for j in range(1, len(parents)):  # over the tree
        G[:, j] = G[:, parents[j]] @ local[:, j - 1]
    turned = exp_so3(_turns(G, rest, parents, sight, fps)) @ G
    local = np.swapaxes(turned[:, parents[1:]], -1, -2) @ turned[:, 1:]
    away = transl + rest[0] - one.centre
    distance = np.linalg.norm(away, axis=1)
    way = smooth(away / distance[:, None], ACROSS_S * fps)
    way *= (smooth(distance[:, None], DEPTH_S * fps)[:, 0] / np.linalg.norm(way, axis=1))[:, None]
    like = frames.transl
    calm = PosedFrames(*(constant(part, like) for part in (turned[:, 0], local, way + one.centre - rest[0])))
    return replace(solved, frames=calm)


def _turns(G: np.ndarray, rest: np.ndarray, parents: np.ndarray, sight: np.ndarray, fps: float) -> np.ndarray:
    """Return the rotation vectors (F, J, 3) from bones u to smoothed bones u': ``(Σ 1 - u uᵀ)⁺ Σ u × u'``."""
    children = np.arange(1, len(parents))
    bones = rest[children] - rest[parents[children]]
    u = np.einsum("fjab,jb->fja", G[:, parents[children]], bones / np.linalg.norm(bones, axis=1, keepdims=True))
    along = np.einsum("fja,fa->fj", u, sight)[..., None]
    wanted = smooth(along, DEPTH_S * fps) * sight[:, None] + smooth(u - along * sight[:, None], ACROSS_S * fps)
    wanted /= np.linalg.norm(wanted, axis=-1, keepdims=True)
    hangs = (parents[children] == np.arange(len(parents))[:, None]).astype(float)
    H = np.einsum("jc,fcab->fjab", hangs, np.eye(3) - u[..., :, None] * u[..., None, :])
    g = np.einsum("jc,fca->fja", hangs, np.cross(u, wanted))
    return np.einsum("fjab,fjb->fja", np.linalg.inv(H + _LEAST * np.eye(3)), g)


UNDER_M = 0.03  # Foot vertices up to this height above the foot's lowest one at rest may touch the floor.
TOUCH_M = 0.005  # Decay of a vertex's contact weight with its height above the foot's lowest vertex, metres.
BODY_S = 0.05  # Standard deviation in time of the body's vertical correction. The legs take up the rest.
FLIGHT_M_S2 = 9.81 / 8.0
"""A flight of T seconds rises by ``g (T / 2)² / 2``. Feet that rise by less than 1/4 of this during T seconds without a
contact count as planted. A jump is therefore recognised if at least half of this time is flight."""
SLOW_S, DEEPER = 0.25, 3.5
"""Correlation time of a depth error in seconds, and ratio of its size to the error across the line of sight."""
UP = np.array([0.0, 0.0, 1.0])
RELEASE_S = 0.15  # Time in seconds over which a foot's correction fades after a contact.
MOST_M = 0.08  # Largest correction of a foot. Larger slides are treated as intentional.
_SIDES = ("left", "right")


def stand_on_floor(solved: SolvedFrames, sight: np.ndarray, fps: float) -> SolvedFrames:
    """Put the lowest points of planted feet on the floor z = 0, and remove foot sliding.

    The body moves by the mean height of its planted feet, smoothed in time. In frames without a contact, the lower foot
    is used, unless its height suggests a jump. Slow height errors come from depth errors. Therefore, the slow part of
    the height error moves the body by the most likely shift ``C e / (eᵀ C e)`` with ``C = 1 + (k² - 1) d dᵀ``, where e
    points up, d is along ``sight`` (F, 3) and k is ``DEEPER``. The rest of the height error moves the body vertically.

    Then the legs bend until each planted foot is on the floor at its mean position. Feet keep their orientation. Feet
    below the floor are also lifted. No foot moves by more than ``MOST_M`` relative to the body.
    """
    body, stands = solved.subject.body, solved.contacts
    chains = legs(body)
    if stands is None or not stands.any() or len(stands) < 3 or len(chains) < len(_SIDES):
        return solved
    root, local, transl = (to_numpy(part) for part in (solved.frames.root, solved.frames.local, solved.frames.transl))
    betas = to_numpy(solved.subject.betas)
    points = _sole_points(body, betas, root, local, transl)
    low = np.stack([foot[..., 2].min(axis=1) for foot in points], axis=1)
    stands = stands & (np.abs(low) < MOST_M)
    if not stands.any():
        return solved
    frames, standing = np.arange(len(low)), stands.any(axis=1)
    drop = np.where(stands, -low, 0.0).sum(axis=1) / np.maximum(stands.sum(axis=1), 1)
    lower = np.where(standing, drop, -low.min(axis=1))
    above, grounded = np.interp(frames, frames[standing], drop[standing]) - lower, ~standing
    for first, last in true_runs(~standing):
        run, inside = slice(first, last + 1), first > 0 and last < len(low) - 1
        half_s = (last - first + 2) / fps / (2.0 if inside else 1.0)  # the take may show only half of a flight
        grounded[run] = above[run].max() < FLIGHT_M_S2 * half_s**2
    known = standing | (grounded & (np.abs(lower) < MOST_M))  # nobody stands in a handstand
    rise = smooth(np.interp(frames, frames[known], lower[known])[:, None], BODY_S * fps)[:, 0]
    slow = smooth(rise[:, None], SLOW_S * fps)
    likely = UP + (DEEPER**2 - 1.0) * sight[:, 2:] * sight
    shift = (rise[:, None] - slow) * UP + slow * likely / likely[:, 2:]
    moves = np.zeros((len(low), len(_SIDES), 3))
    for side, foot in enumerate(points):
        runs = true_runs(stands[:, side])
        moves[:, side, :2] = -_slides(foot + shift[:, None], runs)
        moves[:, side, 2] = -low[:, side] - rise
        moves[:, side] = released(moves[:, side], stands[:, side], round(RELEASE_S * fps))
        moves[:, side, 2] = np.maximum(moves[:, side, 2], -low[:, side] - rise)
    transl = transl + shift
    rest = np.asarray(body.rest_joints(betas))
    length = np.linalg.norm(moves, axis=-1, keepdims=True)
    moves *= np.minimum(1.0, MOST_M / np.maximum(length, 1e-9))
    for side, chain in enumerate(chains):
        local = with_ankle_moved(root, local, rest, body.parents, chain, moves[:, side])
    like = solved.frames.transl
    return replace(solved, frames=PosedFrames(*(constant(part, like) for part in (root, local, transl))))


def legs(body: Body) -> list[tuple[int, int, int]]:
    """Return the joints (hip, knee, ankle) of each leg that the body has."""
    names = body.layout.joints
    wanted = [[f"{side}_{part}" for part in ("hip", "knee", "ankle")] for side in _SIDES]
    return [(names.index(a), names.index(b), names.index(c)) for a, b, c in wanted if {a, b, c} <= set(names)]


def _sole_points(
    body: Body, betas: np.ndarray, root: np.ndarray, local: np.ndarray, transl: np.ndarray
) -> list[np.ndarray]:
    """Return the positions (F, V, 3) of the sole vertices of the left and right foot in metres."""
    found = []
    for side in _SIDES:
        foot = foot_vertices(body, side)
        foot = foot[body.v_template[foot, 1] < body.v_template[foot, 1].min() + UNDER_M]
        names = tuple(str(vertex) for vertex in foot)
        skin = Landmarks.of_points(names, body.v_template[foot], body.shapedirs[foot], body.weights[foot])
        found.append(np.asarray(pose_landmarks(body, skin, betas, root, local, transl).points))
    return found


def _slides(foot: np.ndarray, runs: list[tuple[int, int]]) -> np.ndarray:
    """Return the horizontal offset (F, 2) in metres of a foot's sole from its mean position in each contact."""
    height = foot[..., 2] - foot[..., 2].min(axis=1, keepdims=True)
    touch = np.exp(-height / TOUCH_M)
    hold = touch[1:] * touch[:-1]
    hold /= hold.sum(axis=1, keepdims=True)
    way = np.zeros((len(foot), 2))
    way[1:] = np.cumsum(np.einsum("fv,fva->fa", hold, np.diff(foot[..., :2], axis=0)), axis=0)
    slides = np.zeros_like(way)
    for first, last in runs:
        slides[first : last + 1] = way[first : last + 1] - way[first : last + 1].mean(axis=0)
    return slides


def released(moves: np.ndarray, stands: np.ndarray, frames: int) -> np.ndarray:
    """Extend corrections (F, 3) of planted feet. They fade out over ``frames`` before and after each contact."""
    number, count = np.arange(len(moves)), len(moves)
    before, after = nearest_true(stands)
    total = np.zeros_like(moves)
    for at, known in ((before, before >= 0), (after, after < count)):
        share = np.clip(1.0 - np.abs(number - at) / max(frames, 1), 0.0, 1.0)
        share = np.where(known, share * share * (3.0 - 2.0 * share), 0.0)
        total += share[:, None] * moves[np.clip(at, 0, count - 1)]
    return np.where(stands[:, None], moves, total)


def with_ankle_moved(
    root: np.ndarray,
    local: np.ndarray,
    rest: np.ndarray,
    parents: tuple[int, ...] | np.ndarray,
    chain: tuple[int, int, int],
    move: np.ndarray,
) -> np.ndarray:
    """Move one ankle, and return adjusted leg rotations (F, J, 3, 3). The foot does not rotate.

    The knee bends to match the new distance between hip and ankle. Then the smallest rotation of the hip aims the leg
    at the new position of the ankle.
    """
    hip, knee, ankle = chain
    above = root
    for joint in _path(parents, hip):
        above = above @ local[:, joint - 1]
    thigh = above @ local[:, hip - 1]
    shin = thigh @ local[:, knee - 1]
    foot = shin @ local[:, ankle - 1]
    u, v = thigh @ (rest[knee] - rest[hip]), shin @ (rest[ankle] - rest[knee])
    a, b, now = (np.linalg.norm(part, axis=-1) for part in (u, v, u + v))
    wanted = u + v + move
    # The leg is not straightened beyond its previous extension, or beyond 99.9 % of its length.
    distance = np.clip(np.linalg.norm(wanted, axis=-1), 1.001 * np.abs(a - b), np.maximum(now, 0.999 * (a + b)))
    axis = np.cross(u, v) / (a * b)[:, None] + _CLEAR * thigh[..., 0]
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    bend = _angle(a, b, distance) - _angle(a, b, now)
    bent = exp_so3(bend[:, None] * axis)
    turn = swing(u + (bent @ v[..., None])[..., 0], wanted)
    thigh, shin = turn @ thigh, turn @ bent @ shin
    local = local.copy()
    local[:, hip - 1] = np.swapaxes(above, -1, -2) @ thigh
    local[:, knee - 1] = np.swapaxes(thigh, -1, -2) @ shin
    local[:, ankle - 1] = np.swapaxes(shin, -1, -2) @ foot
    return local


_CLEAR = 0.05  # Sine of the bend at which the knee's axis and the normal of the leg's plane have equal weight.


def _path(parents: tuple[int, ...] | np.ndarray, joint: int) -> list[int]:
    """Return the joints between the root and a joint, without these two, ordered from the root outwards."""
    path = list[int]()
    while parents[joint] > 0:
        joint = int(parents[joint])
        path.append(joint)
    return path[::-1]


def _angle(a: np.ndarray, b: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Return a knee's bend in radians, given bone lengths and the distance from hip to ankle."""
    return np.arccos(np.clip((distance**2 - a**2 - b**2) / (2.0 * a * b), -1.0, 1.0))
