"""People whose contacts are known: keyed clips laid on the floor, and generated steps with planted feet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks
from solver_backend.exchange.joint_sets import SMPL_JOINTS, JointSet
from solver_backend.fitters.one_view.shape import foot_vertices, with_soles
from solver_backend.geometry.interpolation import smooth
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.motions.recorded_clip import RecordedClip, body_rotations
from solver_backend.synthesis.simulation.cast import BETAS_SIGMA, TOUCH_S, UPRIGHT, Person
from training.data.sources.clips import KEYED_ARCHIVE, read_archive_clips, resample

FPS = 60.0
HOLD_M = 0.005  # Height above the lowest skin at which skin loses its hold of the floor.


@dataclass(frozen=True)
class FloorTake:
    """A person with known contacts."""

    name: str
    person: Person
    stands: np.ndarray | None = None  # (F, 2) bool: left and right foot stand, None where only the skin is known.
    fps: float = FPS


@lru_cache(maxsize=1)
def keyed_clips(data: Path) -> dict[str, RecordedClip]:
    """Return the animations of the archive of hand-keyed clips by name."""
    return {clip.name: clip for clip in read_archive_clips(data / KEYED_ARCHIVE)}


def random_betas(rng: np.random.Generator) -> np.ndarray:
    """Return a random shape."""
    return np.clip(BETAS_SIGMA * rng.normal(size=10), -2.0, 2.0)


def laid_on_floor(clip: RecordedClip, rng: np.random.Generator, frames: slice = slice(None)) -> FloorTake:
    """Return a clip on a random body. The lowest skin is on or just above the floor, and touching skin stays in place.

    The archive keeps rotations only, so the path follows from the contacts: heights are smoothed over ``TOUCH_S``, then
    raised until no skin is below the floor in any frame, and the mean way of the touching skin along it is zero.
    """
    body, rotations = load_body(), resample(body_rotations(clip), clip.fps, FPS)[frames]
    person = Person(body, random_betas(rng), UPRIGHT @ rotations[:, 0], rotations[:, 1:], np.zeros((len(rotations), 3)))
    skin = person.skin(np.arange(len(rotations)))
    heights = skin[..., 2].min(axis=1)
    lowest = smooth(heights[:, None], TOUCH_S * FPS)[:, 0]
    reach = round(3 * TOUCH_S * FPS)
    around = np.pad(np.maximum(lowest - heights, 0.0), reach, mode="edge")
    deepest = np.lib.stride_tricks.sliding_window_view(around, 2 * reach + 1).max(axis=1)
    lowest = np.minimum(lowest - smooth(deepest[:, None], TOUCH_S * FPS)[:, 0], heights)
    touch = np.exp(-np.maximum(skin[..., 2] - lowest[:, None], 0.0) / HOLD_M)
    hold = touch[1:] * touch[:-1]
    hold /= hold.sum(axis=1, keepdims=True)
    way = np.zeros((len(skin), 2))
    way[1:] = np.cumsum(np.einsum("fv,fva->fa", hold, np.diff(skin[..., :2], axis=0)), axis=0)
    return FloorTake(clip.name, replace(person, transl=-np.column_stack([smooth(way, 0.02 * FPS), lowest])))


@dataclass(frozen=True)
class Gait:
    """A way to step."""

    name: str
    length_m: float  # Of a step along the heading, negative backwards.
    step_s: float  # From one landing to the next.
    aside_m: float = 0.0  # Way to the left of every step of the left foot; the right one follows.
    turn: float = 0.0  # Radians of heading for each step.
    pause: int = 0  # Steps between pauses, 0 for none.
    lift_m: float = 0.05
    steps: int = 8


FITTED = (
    Gait("walk", 0.6, 0.55), Gait("slow", 0.4, 0.85), Gait("march", 0.0, 0.6, lift_m=0.12),
    Gait("stop and go", 0.5, 0.6, pause=2),
)  # fmt: skip
HELD_OUT = (
    Gait("brisk", 0.72, 0.48), Gait("turn", 0.45, 0.62, turn=0.3), Gait("sideways", 0.0, 0.7, aside_m=0.35),
    Gait("back and pause", -0.3, 0.7, pause=3),
)  # fmt: skip
SWING = 0.78  # Share of a step's time that the foot is in the air.
_SIDES = ("left", "right")


@dataclass(frozen=True)
class _Stance:
    land: float
    lift: float
    place: np.ndarray  # (2,) of the ball of the foot, metres.
    yaw: float


def _stances(gait: Gait, rng: np.random.Generator, width: float, end_s: float) -> list[list[_Stance]]:
    """Return the stances of the left and the right foot."""
    middle, yaw, time = np.zeros(2), 0.0, 0.8
    stances: list[list[_Stance]] = [[], []]
    standing = [(-1.0, width * np.array([0.5 * sign, 0.0]), 0.0) for sign in (1.0, -1.0)]
    for number in range(gait.steps):
        side = number % 2
        jitter = 1.0 + 0.08 * rng.normal(size=2)
        yaw += gait.turn
        ahead, left = np.array([np.sin(yaw), -np.cos(yaw)]), np.array([np.cos(yaw), np.sin(yaw)])
        middle = middle + gait.length_m * jitter[0] * ahead + (gait.aside_m * jitter[0] * left if side == 0 else 0.0)
        place = middle + 0.5 * width * (1.0, -1.0)[side] * left
        air = SWING * gait.step_s * jitter[1]
        land, old, old_yaw = standing[side]
        stances[side].append(_Stance(land, time, old, old_yaw))
        standing[side] = (time + air, place, yaw)
        time += gait.step_s * jitter[1]
        if gait.pause and number % gait.pause == gait.pause - 1:
            time += rng.uniform(0.4, 0.9)
    for side, (land, place, heading) in enumerate(standing):
        stances[side].append(_Stance(land, end_s + time, place, heading))
    return stances


def _turn_x(angle: np.ndarray) -> np.ndarray:
    return exp_so3(np.asarray(angle)[..., None] * np.array([1.0, 0.0, 0.0]))


def _turn_z(angle: np.ndarray) -> np.ndarray:
    return exp_so3(np.asarray(angle)[..., None] * np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True)
class _Foot:
    """Poses of a foot: its ankle, its turn in the world and the bend of its toes."""

    ankle: np.ndarray  # (F, 3)
    turn: np.ndarray  # (F, 3, 3)
    toes: np.ndarray  # (F,)
    stands: np.ndarray  # (F,) bool
    middle: np.ndarray  # (F, 2) place under the foot, for the body's path.
    yaw: np.ndarray  # (F,)


def _foot(gait: Gait, body: Body, rest: np.ndarray, side: str, stances: list[_Stance], t: np.ndarray) -> _Foot:
    """Return the foot at times (F,): heel rocker, flat, rise over the ball, swing (Perry 1992, "Gait Analysis")."""
    ankle, ball = (rest[SMPL_JOINTS.index(f"{side}_{part}")] for part in ("ankle", "foot"))
    skin = with_soles(body, keypoint_landmarks(body, JointSet.BODY_25))
    heel = skin.anchors[skin.names.index(f"{side}_sole_heel")].sum(axis=0)
    size = abs(gait.length_m)
    strike = np.radians(min(18.0, 32.0 * size)) if gait.length_m > 0 else 0.0
    push = np.radians(12.0 + 22.0 * min(1.0, size / 0.6))
    down_s, up_s = 0.16 * gait.step_s, 0.6 * gait.step_s

    def grounded(stance: _Stance, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ankle, pitch and bend of the toes in a stance. The ball is at the stance's place when flat."""
        up = np.clip((at - (stance.lift - up_s)) / up_s, 0.0, 1.0)
        rise = push * up**2.5
        fall = strike * np.clip(1.0 - (at - stance.land) / down_s, 0.0, 1.0) * (stance.land > 0)
        R = _turn_z(np.full(len(at), stance.yaw)) @ UPRIGHT
        flat = np.array([*stance.place, 0.0]) - (R @ np.array([ball[0], heel[1], ball[2]]))
        about = np.where((fall > 0)[:, None], heel, ball)
        tilted = _turn_x(rise - fall)
        return (
            flat + (R @ (about + (tilted @ (ankle - about)[..., None])[..., 0])[..., None])[..., 0],
            rise - fall,
            -rise,
        )

    F = len(t)
    place, pitch, toes, stands = np.zeros((F, 3)), np.zeros(F), np.zeros(F), np.zeros(F, bool)
    middle, yaw = np.zeros((F, 2)), np.zeros(F)
    for number, stance in enumerate(stances):
        here = (t >= stance.land) & (t < stance.lift)
        place[here], pitch[here], toes[here] = grounded(stance, t[here])
        stands[here], middle[here], yaw[here] = True, stance.place, stance.yaw
        if number + 1 == len(stances):
            continue
        after = stances[number + 1]
        air = (t >= stance.lift) & (t < after.land)
        span = after.land - stance.lift
        u = (t[air] - stance.lift) / span
        ends = np.array([stance.lift - 1e-3, stance.lift])
        (before, start), from_pitch, bent = grounded(stance, ends)
        goal, to_pitch, _ = grounded(after, np.array([after.land]))
        ahead = (after.place - stance.place) / span
        speeds = (start - before) / 1e-3 * span, np.array([*(0.3 * ahead), -0.25]) * span
        h = 2 * u**3 - 3 * u**2 + 1, u**3 - 2 * u**2 + u, 3 * u**2 - 2 * u**3, u**3 - u**2
        place[air] = sum(w[:, None] * v for w, v in zip(h, (start, speeds[0], goal[0], speeds[1]), strict=True))
        place[air, 2] += gait.lift_m * np.sin(np.pi * u)
        share = u**2 * (3 - 2 * u)
        pitch[air] = (1 - share) * from_pitch[1] + share * to_pitch[0]
        toes[air] = bent[1] * np.clip(1.0 - 2.5 * u, 0.0, 1.0) ** 2
        middle[air] = stance.place + share[:, None] * (after.place - stance.place)
        yaw[air] = (1 - share) * stance.yaw + share * after.yaw
    return _Foot(place, _turn_z(yaw) @ UPRIGHT @ _turn_x(pitch), toes, stands, middle, yaw)


def _frame(axis: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return (..., 3, 3) with the columns axis (made orthogonal), along and their product."""
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    axis = axis - (axis * along).sum(-1, keepdims=True) * along
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    return np.stack([axis, along, np.cross(axis, along)], axis=-1)


def planted_steps(gait: Gait, seed: int) -> FloorTake:
    """Return a person who steps: each foot lands, stays exactly in place and leaves at known times."""
    rng, body = np.random.default_rng(seed), load_body()
    betas = random_betas(rng)
    rest = body.rest_joints(betas)[: len(SMPL_JOINTS)]
    at = {name: SMPL_JOINTS.index(name) for name in SMPL_JOINTS}
    stances = _stances(gait, rng, 1.1 * float(np.ptp(rest[[at["left_hip"], at["right_hip"]], 0])), 0.8)
    t = np.arange(
        0.0, stances[0][-1].lift if stances[0][-1].lift < stances[1][-1].lift else stances[1][-1].lift, 1 / FPS
    )
    shaped = replace(body, v_template=body.v_template + body.shapedirs @ betas)
    feet = [_foot(gait, shaped, rest, side, part, t) for side, part in zip(_SIDES, stances, strict=True)]
    yaw = smooth(np.mean([foot.yaw for foot in feet], axis=0)[:, None], 0.15 * FPS)[:, 0]
    path = smooth(np.mean([foot.middle for foot in feet], axis=0), 0.12 * FPS)
    sway = 0.02 * rng.normal(size=2)
    root = _turn_z(yaw) @ UPRIGHT @ exp_so3(np.stack([0 * t + 0.03, sway[0] * np.sin(3 * t), 0 * t], axis=-1))
    lift = np.zeros((len(t), 2))
    for _ in range(3):
        person = _stepping(body, betas, rest, feet, lift, root, path, t, gait)
        for side, foot in enumerate(feet):
            low = _lowest(person, _SIDES[side])
            lift[:, side] -= np.where(foot.stands, low, np.minimum(low - 0.001, 0.0))
    return FloorTake(gait.name, person, np.stack([foot.stands for foot in feet], axis=1))


def _stepping(
    body: Body, betas: np.ndarray, rest: np.ndarray, feet: list[_Foot], lift: np.ndarray, root: np.ndarray,
    path: np.ndarray, t: np.ndarray, gait: Gait,
) -> Person:  # fmt: skip
    """Return the body above its feet, whose ankles are raised by ``lift`` (F, 2) metres."""
    at = {name: SMPL_JOINTS.index(name) for name in SMPL_JOINTS}
    ankles = [foot.ankle + lift[:, side, None] * [0.0, 0.0, 1.0] for side, foot in enumerate(feet)]
    reach = []
    hips = [np.einsum("fab,b->fa", root, rest[at[f"{side}_hip"]] - rest[0]) for side in _SIDES]
    bones = [
        [rest[at[f"{s}_{b}"]] - rest[at[f"{s}_{a}"]] for a, b in (("hip", "knee"), ("knee", "ankle"))] for s in _SIDES
    ]
    for ankle, hip, (u, v) in zip(ankles, hips, bones, strict=True):
        length = 0.985 * (np.linalg.norm(u) + np.linalg.norm(v))
        across = np.linalg.norm(ankle[:, :2] - path - hip[:, :2], axis=1)
        reach.append(ankle[:, 2] + np.sqrt(np.maximum(length**2 - across**2, 0.1)) - hip[:, 2])
    around = np.lib.stride_tricks.sliding_window_view(np.pad(np.min(reach, axis=0), 8, mode="edge"), 17)
    pelvis = np.column_stack([path, smooth(around.min(axis=1)[:, None], 0.06 * FPS)[:, 0]])
    local = np.tile(np.eye(3), (len(t), len(SMPL_JOINTS) - 3, 1, 1))
    for side, (name, foot) in enumerate(zip(_SIDES, feet, strict=True)):
        (u, v), hip = bones[side], pelvis + hips[side]
        way = ankles[side] - hip
        a, b = np.linalg.norm(u), np.linalg.norm(v)
        d = np.minimum(np.linalg.norm(way, axis=1), 0.9995 * (a + b))
        first = np.arccos(np.clip((a**2 + d**2 - b**2) / (2 * a * d), -1, 1))
        second = np.arccos(np.clip((b**2 + d**2 - a**2) / (2 * b * d), -1, 1))
        base, x = _frame(root[..., 0], way), np.array([1.0, 0.0, 0.0])
        thigh = base @ _turn_x(-first) @ _frame(x, u).T
        shin = base @ _turn_x(second) @ _frame(x, v).T
        local[:, at[f"{name}_hip"] - 1] = np.swapaxes(root, -1, -2) @ thigh
        local[:, at[f"{name}_knee"] - 1] = np.swapaxes(thigh, -1, -2) @ shin
        local[:, at[f"{name}_ankle"] - 1] = np.swapaxes(shin, -1, -2) @ foot.turn
        local[:, at[f"{name}_foot"] - 1] = _turn_x(foot.toes)
        sign = (1.0, -1.0)[side]
        arm = exp_so3(np.array([0.0, 0.0, -1.15 * sign]))
        swing = _turn_x(-0.35 * sign * np.sin(np.pi * t / gait.step_s))
        local[:, at[f"{name}_shoulder"] - 1] = swing @ arm
        local[:, at[f"{name}_elbow"] - 1] = exp_so3(np.array([0.0, -0.35 * sign, 0.0]))
    return Person(body, betas, root, local, pelvis - rest[0])


def _lowest(person: Person, side: str) -> np.ndarray:
    """Return the (F,) height of the lowest skin of a foot."""
    body = person.body
    foot = foot_vertices(body, side)
    foot = foot[body.v_template[foot, 1] < body.v_template[foot, 1].min() + 0.03]
    points = tuple(str(vertex) for vertex in foot)
    skin = Landmarks.of_points(points, body.v_template[foot], body.shapedirs[foot], body.weights[foot])
    return np.asarray(person.pose(skin).points)[..., 2].min(axis=1)


def kneeling(frames: int = 60, sway: float = 0.02) -> Person:
    """Return a person who kneels upright on both knees and sways."""
    t = np.arange(frames) / FPS
    local = np.tile(np.eye(3), (frames, 21, 1, 1))
    lean = sway * np.sin(2 * np.pi * t)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turns = {"hip": -lean, "knee": np.full(frames, 1.55), "ankle": np.full(frames, 1.4)}
        for name, angle in turns.items():
            local[:, SMPL_JOINTS.index(f"{side}_{name}") - 1] = exp_so3(angle[:, None] * [1.0, 0.0, 0.0])
        local[:, SMPL_JOINTS.index(f"{side}_shoulder") - 1] = exp_so3(np.array([0.0, 0.0, -1.1 * sign]))
    root = UPRIGHT @ exp_so3(lean[:, None] * [1.0, 0.0, 0.0])
    person = Person(load_body(), np.zeros(10), root, local, np.zeros((frames, 3)))
    lowest = person.skin(np.arange(frames))[..., 2].min(axis=1)
    return replace(person, transl=-lowest[:, None] * [0.0, 0.0, 1.0])
