"""How well a rig plays an actor, measured from what its bones show in Blender and from nothing else of the retarget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from blender_addon._exchange.motion_file import MotionFile
from blender_addon._exchange.so3 import quat_from_matrix, rotvec_from_matrix
from blender_addon.body.body_file import BodyFile, pose_joints
from blender_addon.conventions.timing import go_to_frame
from blender_addon.retarget.recognition import map_rig
from solver_backend.exchange.stands import standing_runs, steps
from solver_backend.metrics import foot_skating_cm_per_frame

FORWARD = np.array([0.0, -1.0, 0.0])
_R = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
JOINTS = {
    "left_arm": (16, 18, 20), "right_arm": (17, 19, 21), "left_leg": (1, 4, 7), "right_leg": (2, 5, 8),
}  # fmt: skip
_ENDS, _HEAD = ("leg", "arm"), 15  # Limbs that begin at the lower and upper end of the trunk, and SMPL's head.
BALLS = {"left_leg": 10, "right_leg": 11}
_SLOW_M_S, _NEXT_S, _LEG_M = 0.32, 0.2, 0.81
"""Speed of a standing sole at a person's size that no lock exceeds, seconds until a lock has faded, a person's leg."""


@dataclass(frozen=True)
class Limb:
    """The bones that show a limb: upper, lower, end and, of legs, the toe."""

    bones: tuple[str, ...]
    hinge: np.ndarray | None = None
    """(3,) the axis it bends about at rest in the world; the anatomical one where left out."""


@dataclass(frozen=True)
class Shown:
    """Bones in the world, metres."""

    rest: dict[str, np.ndarray]  # (3,) heads at rest.
    heads: dict[str, np.ndarray]  # (F, 3) heads.
    turns: dict[str, np.ndarray]  # (F, 3, 3) rotations from rest.


@dataclass(frozen=True)
class Score:
    """Largest deviations over all frames."""

    hands_mm: float
    feet_mm: float
    """Of soles, in stands up to what a lock may move them."""
    steps_mm: float
    """Of soles out of stands, and in the middle of each, where a lock leaves them: a wrong place shows in both."""
    twist_deg: float
    """Of elbows and knees: upper arms, forearms, thighs and shins about their own line, by their hinges."""
    wrists_deg: float
    """Twist of the hand against its forearm."""
    hips_deg: float
    """Twist of the thigh in the pelvis's axes."""
    pelvis_deg: float
    """Rotation of the pelvis in the world."""
    skating: float
    """Way of standing toes in cm a frame, at the actor's size."""
    skating_actor: float
    path_ratio: float
    """Way of the hips over the ground by the actor's, over the ratio of the legs."""
    trunk_deg: float
    """Mean angle between the directions from hips to shoulders in the world."""
    head_deg: float
    """Mean angle between the directions from shoulders to head in the world."""


def shown(rig: bpy.types.Object, names: Sequence[str], times: np.ndarray) -> Shown:
    """Play a rig and return some of its bones."""
    scene, world = bpy.context.scene, np.array(rig.matrix_world, np.float64)
    matrices = np.empty((len(times), len(names), 4, 4))
    for f, time in enumerate(times):
        go_to_frame(scene, float(time))
        bones = rig.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        matrices[f] = world @ np.array([bones[name].matrix for name in names])
    rest = world @ np.array([rig.data.bones[name].matrix_local for name in names])
    axes, rest_axes = (
        m[..., :3, :3] / np.linalg.norm(m[..., :3, :3], axis=-2, keepdims=True) for m in (matrices, rest)
    )
    turns = axes @ rest_axes.swapaxes(-1, -2)
    index = {name: i for i, name in enumerate(names)}
    return Shown(
        {name: rest[i, :3, 3] for name, i in index.items()}, {name: matrices[:, i, :3, 3] for name, i in index.items()},
        {name: turns[:, i] for name, i in index.items()},
    )  # fmt: skip


def score(
    rig: bpy.types.Object, limbs: dict[str, Limb], motion: MotionFile, body: BodyFile, times: np.ndarray
) -> Score:
    """Compare a rig that stands over the world's origin and faces -Y with the motion it plays."""
    rest = body.rest_joints(motion.betas)
    G, joints = pose_joints(rest, motion.rotvec, motion.transl)
    rest = rest @ _R.T - [0.0, 0.0, (body.shaped(motion.betas) @ _R.T)[:, 2].min()]
    turns = G @ _R.T
    pelvis = _common_parent(rig, *(limbs[key].bones[0] for key in BALLS))
    head = map_rig(rig).bones["head"]
    seen = shown(rig, [*(name for limb in limbs.values() for name in limb.bones), pelvis, head], times)
    scale = np.mean([_leg(np.stack([seen.rest[b] for b in limbs[k].bones[:3]])) for k in BALLS]) / np.mean(
        [_leg(rest[list(JOINTS[k])]) for k in BALLS]
    )
    hips = np.mean([seen.heads[limbs[key].bones[0]] for key in BALLS], axis=0)
    ways = [_length(points[:, :2]) for points in (hips, joints[:, [1, 2]].mean(1))]
    hands, feet, steps_off, twist, toes, own_toes = [], [], [], [], [], []
    size = scale * _leg(rest[list(JOINTS["left_leg"])]) / _LEG_M
    wrists, hips_twist = [], []
    for key, limb in limbs.items():
        j, b = JOINTS[key], limb.bones
        own_points, rig_points = joints[:, list(j)], np.stack([seen.heads[name] for name in b], axis=1)
        for part in range(2):
            own = _hinge_world(rest[j[part + 1]] - rest[j[part]], None, key)
            direction = seen.rest[b[part + 1]] - seen.rest[b[part]]
            hinge = _hinge_world(direction, limb.hinge, key)
            bone, other = (points[:, i + 1] - points[:, i] for points, i in ((own_points, part), (rig_points, part)))
            hinges = turns[:, j[part]] @ own, seen.turns[b[part]] @ hinge
            twist.append(twist_deg(bone, hinges[0], other, hinges[1]))
            if part == 0 and key in BALLS:
                # By directions and hinges of now: a twist since rest would count how much the thighs lean at rest.
                in_own, in_rig = (np.swapaxes(R, -1, -2) for R in (turns[:, 0], seen.turns[pelvis]))
                hips_twist.append(twist_deg(*_turned(in_own, bone, hinges[0]), *_turned(in_rig, other, hinges[1])))
        if key in BALLS:
            below, own_below = (p * [0, 0, -1] for p in (rest[BALLS[key]], seen.rest[b[3]]))
            sole = joints[:, BALLS[key]] + turns[:, j[2]] @ below
            own_sole = seen.heads[b[3]] + seen.turns[b[2]] @ own_below
            feet.append(np.linalg.norm(own_sole - scale * sole, axis=1))
            steps_off += _out_of_stands(own_sole - scale * sole, scale * sole, size, motion.fps)
            toes.append(sole)
            own_toes.append(own_sole / scale)
        else:
            ratio = _length(np.stack([seen.rest[n] for n in b])) / _length(rest[list(j)])
            way = seen.heads[b[2]] - seen.heads[b[0]] - ratio * (joints[:, j[2]] - joints[:, j[0]])
            hands.append(np.linalg.norm(way, axis=1))
            own_angle = twist_about(turns[:, j[1]], turns[:, j[2]], rest[j[2]] - rest[j[1]])
            angle = twist_about(seen.turns[b[1]], seen.turns[b[2]], seen.rest[b[2]] - seen.rest[b[1]])
            wrists.append(_apart_deg(own_angle, angle))
    between = np.swapaxes(turns[:, 0], -1, -2) @ seen.turns[pelvis]
    pelvis_deg = np.degrees(np.linalg.norm(rotvec_from_matrix(between), axis=-1))
    floor = float(np.percentile(np.stack(toes)[..., 2], 2))
    skating = [foot_skating_cm_per_frame(np.stack(points, axis=1), floor) for points in (own_toes, toes)]
    turned = (float(np.max(angles)) for angles in (twist, wrists, hips_twist, pelvis_deg))
    ends = [np.stack([seen.heads[limbs[f"{s}_{limb}"].bones[0]] for s in ("left", "right")]).mean(0) for limb in _ENDS]
    own_ends = [joints[:, [JOINTS[f"{s}_{limb}"][0] for s in ("left", "right")]].mean(1) for limb in _ENDS]
    lines = zip([*ends, seen.heads[head]], [*own_ends, joints[:, _HEAD]], strict=True)
    (hip, own_hip), (neck, own_neck), (top, own_top) = lines
    upright = _mean_deg(neck - hip, own_neck - own_hip), _mean_deg(top - neck, own_top - own_neck)
    path_ratio = ways[0] / ways[1] / scale
    return Score(
        1000 * np.max(hands), 1000 * np.max(feet), 1000 * max(steps_off), *turned, *skating, path_ratio, *upright
    )


def _out_of_stands(off: np.ndarray, meant: np.ndarray, size: float, fps: float) -> list[float]:
    """Return distances by the errors (F, 3) of a sole out of slow ranges of its meant path, and in their middle."""
    way, seconds = steps(meant[:, None], fps)
    runs = standing_runs(np.linalg.norm(way[:, 0], axis=-1) < _SLOW_M_S * size * seconds[:, 0], fps)
    free, margin = np.ones(len(off), dtype=bool), round(_NEXT_S * fps)
    for first, stop in runs:
        free[max(first - margin, 0) : stop + margin] = False
    middles = [float(np.linalg.norm(np.median(off[first:stop], axis=0))) for first, stop in runs]
    return [*middles, *np.linalg.norm(off[free], axis=1).tolist()]


def _mean_deg(a: np.ndarray, b: np.ndarray) -> float:
    cosine = (a * b).sum(-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).mean())


def twist_about(parent: np.ndarray, child: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Return the twist (F,) in radians of a bone against its parent about a direction of its rest: ``2 atan2(q·a, w)``.

    Args:
        parent: (F, 3, 3) rotations since rest.
        child: (F, 3, 3) the same of the bone.
        way: (3,) direction at rest.
    """
    q = quat_from_matrix(np.swapaxes(parent, -1, -2) @ child)
    return 2.0 * np.arctan2(q[..., 1:] @ (way / np.linalg.norm(way)), q[..., 0])


def _turned(R: np.ndarray, *vectors: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple((R @ v[..., None])[..., 0] for v in vectors)


def _apart_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.abs((a - b + np.pi) % (2 * np.pi) - np.pi))


def _common_parent(rig: bpy.types.Object, left: str, right: str) -> str:
    """Return the lowest bone that carries both."""
    others = {bone.name for bone in rig.data.bones[right].parent_recursive}
    return next(bone.name for bone in rig.data.bones[left].parent_recursive if bone.name in others)


def twist_deg(direction: np.ndarray, hinge: np.ndarray, other: np.ndarray, other_hinge: np.ndarray) -> np.ndarray:
    """Return by how many degrees (F,) two hinges differ about the limb, the limbs' directions made one."""
    a, b = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (direction, other))
    axis, cosine = np.cross(b, a), (a * b).sum(-1, keepdims=True)
    h = other_hinge
    swung = h * cosine + np.cross(axis, h) + axis * (axis * h).sum(-1, keepdims=True) / (1 + cosine)
    flat = [v - (v * a).sum(-1, keepdims=True) * a for v in (hinge, swung)]
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(*flat), axis=-1), (flat[0] * flat[1]).sum(-1)))


def bent_hinge(rig: bpy.types.Object, upper: str, lower: str) -> np.ndarray:
    """Return the axis about which a limb is bent at rest, in the world."""
    ways = [np.array(rig.data.bones[name].tail_local - rig.data.bones[name].head_local) for name in (upper, lower)]
    return np.array(rig.matrix_world)[:3, :3] @ np.cross(*ways)


def _hinge_world(direction: np.ndarray, given: np.ndarray | None, key: str) -> np.ndarray:
    hinge = given if given is not None else np.cross(direction, FORWARD) if key.endswith("arm") else np.eye(3)[0]
    d = direction / np.linalg.norm(direction)
    hinge = hinge - (hinge @ d) * d
    return hinge / np.linalg.norm(hinge)


def _rotation(matrices: np.ndarray) -> np.ndarray:
    return matrices[..., :3, :3] / np.linalg.norm(matrices[..., :3, :3], axis=-2, keepdims=True)


def _leg(points: np.ndarray) -> float:
    return _length(points)


def _length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
