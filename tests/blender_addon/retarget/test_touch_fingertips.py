"""Fingertips that touch the body or each other do so on a broader figure, where motion and rig have fingers."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from scipy.optimize import least_squares

from blender_addon._exchange.motion_file import MotionFile
from blender_addon.body.body_file import BodyFile, default_body_path, pose_joints, read_body
from blender_addon.conventions.coordinates import R_ARMATURE_BODY
from blender_addon.conventions.skeleton import SMPL_HANDS
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.motion.transfer import TransferSettings
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import RetargetSettings, retarget
from tests.support.own_character import own_character

BROADER, FRAMES, PULP_M = 1.2, 15, 0.008
JOINTS = SMPL_HANDS.joints
ARM = tuple(JOINTS.index(f"right_{part}") for part in ("shoulder", "elbow", "wrist"))
INDEX = tuple(JOINTS.index(f"right_index{bone}") for bone in (2, 3))
CLOSED = [JOINTS.index(f"right_{finger}{bone}") for finger in ("middle", "ring", "pinky") for bone in (1, 2, 3)]
ROOT = np.array([np.pi / 2, 0.0, 0.0])
OTHER_ARM = [JOINTS.index(f"left_{part}") for part in ("shoulder", "elbow", "wrist")]


@pytest.fixture(scope="module")
def body() -> BodyFile:
    return read_body(default_body_path(), SMPL_HANDS)


def tip(joints: np.ndarray, bones: tuple[int, ...] = INDEX) -> np.ndarray:
    """Return the tip of the index finger, half a centimetre beyond its last bone."""
    return joints[..., bones[1], :] + 0.9 * (joints[..., bones[1], :] - joints[..., bones[0], :])


def joints_of(body: BodyFile, pose: np.ndarray) -> np.ndarray:
    return pose_joints(body.rest_joints(np.zeros(10)), pose[None], np.array([[0.0, 0.0, 0.95]]))[1][0]


def pointing(body: BodyFile, place: np.ndarray) -> np.ndarray:
    """Return the pose (J, 3) whose right index finger, the other fingers closed, has its tip at a place."""
    closed = np.zeros((len(JOINTS), 3))
    closed[0] = ROOT
    closed[CLOSED, 2] = 1.4
    start = np.array([0.0, 0.6, 0.9, 0.0, 1.4, 0.0, 0.0, 0.3, 0.0])

    def turned(x: np.ndarray) -> np.ndarray:
        pose = closed.copy()
        pose[list(ARM)] = x.reshape(3, 3)
        return pose

    def off(x: np.ndarray) -> np.ndarray:
        return np.r_[tip(joints_of(body, turned(x))) - place, 0.003 * (x - start)]

    return turned(least_squares(off, start, max_nfev=80).x)


def mirrored(pose: np.ndarray) -> np.ndarray:
    """Return a pose whose left arm and hand do what the right ones do."""
    both = pose.copy()
    for j, name in enumerate(JOINTS):
        other = name.replace("left_", "right_")
        if other != name:
            both[j] = pose[JOINTS.index(other)] * [1.0, -1.0, -1.0]
    return both


def motion_of(pose: np.ndarray) -> MotionFile:
    """Return a motion whose arms come from the sides, touch for a third of the time, and leave."""
    share = np.clip(1.5 * np.sin(np.linspace(0.0, np.pi, FRAMES)), 0.0, 1.0)[:, None]
    poses = np.tile(pose, (FRAMES, 1, 1))
    for joint in (*ARM, *OTHER_ARM):
        poses[:, joint] = share * pose[joint]
    transl = np.tile([0.0, 0.0, 0.95], (FRAMES, 1))
    return MotionFile("point", poses, transl, np.zeros(10), 30.0, body_layout=SMPL_HANDS)


def shown_tips(rig: bpy.types.Object) -> np.ndarray:
    """Return the (F, 2, 3) tips of both index fingers as Blender shows them."""
    found = np.empty((FRAMES, 2, 3))
    for f in range(FRAMES):
        bpy.context.scene.frame_set(1 + f)
        bones = rig.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        for side, name in enumerate(("Left", "Right")):
            ends = np.array([bones[f"mixamorig:{name}HandIndex{bone}"].head for bone in (2, 3)])
            found[f, side] = tip(ends, (0, 1))
    return found


def played(body: BodyFile, pose: np.ndarray, *, held: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the tips (F, 2, 3) on a broader figure, and its skin (V, 3) at rest, which the trunk keeps."""
    rig = own_character(body, BROADER, BROADER)
    settings = RetargetSettings(transfer=TransferSettings(hold_contacts=held))
    bpy.context.scene.render.fps = 30
    retarget(
        actor_of_motion(motion_of(pose), body), rig, bpy.context.scene, map_rig(rig), TakeTiming(1, 30.0), settings
    )
    mesh = next(o for o in bpy.data.objects if o.type == "MESH")
    points = np.empty(3 * len(mesh.data.vertices), np.float32)
    mesh.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices.foreach_get("co", points)
    tips = shown_tips(rig)
    for thing in tuple(bpy.data.objects):
        bpy.data.objects.remove(thing)
    return tips, points.reshape(-1, 3).astype(float)


def trunk_of(body: BodyFile) -> np.ndarray:
    """Return which vertices (V,) are the trunk's."""
    return np.isin(body.weights.argmax(axis=1), (0, 3, 6, 9))


def before(skin: np.ndarray, place: np.ndarray) -> float:
    """Return how far a place lies before the skin (V, 3) of a front, which faces -Y; negative behind it."""
    ways = place - skin
    nearest = int(np.linalg.norm(ways, axis=1).argmin())
    return float(np.linalg.norm(ways[nearest]) * -np.sign(ways[nearest, 1]))


def test_a_fingertip_on_the_chest_stays_on_it(scene: bpy.types.Scene, body: BodyFile) -> None:
    trunk = trunk_of(body)
    joints = joints_of(body, np.r_[[ROOT], np.zeros((len(JOINTS) - 1, 3))])
    skin = body.shaped(np.zeros(10)) @ R_ARMATURE_BODY.T
    skin = skin - (body.rest_joints(np.zeros(10))[0] @ R_ARMATURE_BODY.T - joints[0])
    height = joints[9, 2] - 0.05
    front = skin[trunk & (np.abs(skin[:, 2] - height) < 0.02) & (np.abs(skin[:, 0] + 0.06) < 0.03)]
    place = front[front[:, 1].argmin()] + [0.0, -PULP_M, 0.0]
    pose = pointing(body, place)
    own = before(skin[trunk], tip(joints_of(body, pose)))
    assert 0.0 < own < 0.02
    off = []
    for held in (False, True):
        tips, points = played(body, pose, held=held)
        off.append(before(points[trunk], tips[FRAMES // 2, 1]))
    assert abs(off[1] - own) < 0.005 and off[0] < -0.010, (own, off)


def test_fingertips_that_meet_meet_on_broader_shoulders(scene: bpy.types.Scene, body: BodyFile) -> None:
    pose = mirrored(pointing(body, np.array([-PULP_M, -0.35, 1.25])))
    joints = joints_of(body, pose)
    left = tuple(JOINTS.index(f"left_index{bone}") for bone in (2, 3))
    own = float(np.linalg.norm(tip(joints) - tip(joints, left)))
    assert own < 0.03 and np.linalg.norm(joints[ARM[2]] - joints[OTHER_ARM[2]]) > 0.15, "palms are apart"
    apart = {}
    for held in (False, True):
        tips, _ = played(body, pose, held=held)
        apart[held] = np.linalg.norm(tips[:, 0] - tips[:, 1], axis=1)
    middle = FRAMES // 2
    assert abs(apart[True][middle] - own) < 0.010 < 0.05 < apart[False][middle], (own, apart)
    assert np.allclose(apart[True][0], apart[False][0], atol=1e-3), "hands that touch nothing are left alone"
