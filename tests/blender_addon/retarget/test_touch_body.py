"""Palms that touch the body stay on its skin on a broader figure, and hands that touch nothing are left alone."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from scipy.optimize import least_squares

from blender_addon._exchange.motion_file import MotionFile
from blender_addon.body.body_file import BodyFile, default_body_path, pose_joints, read_body
from blender_addon.conventions.coordinates import R_ARMATURE_BODY
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import Actor, actor_of_motion
from blender_addon.retarget.motion.transfer import TransferSettings
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import Retargeted, RetargetSettings, retarget
from tests.support.own_character import own_character

BROADER = 1.2
FRAMES = 21
PALM_M = 0.022
"""Distance of a palm's middle from the skin that it touches."""
LEFT, RIGHT = (16, 18, 20, 22), (17, 19, 21, 23)  # SMPL's joints of the arms.


@pytest.fixture(scope="module")
def contacts() -> dict[str, tuple[Actor, np.ndarray]]:
    """Return the actors who touch themselves that were found, by case, and how far their palms are outside."""
    return {}


@pytest.fixture(scope="module")
def body() -> BodyFile:
    return read_body(default_body_path())


def posed(body: BodyFile, pose: np.ndarray) -> Actor:
    """Return an upright actor with these rotations (F, 24, 3)."""
    pose = pose.copy()
    pose[:, 0] = [np.pi / 2, 0.0, 0.0]
    return actor_of_motion(MotionFile("t", pose, np.tile([0.0, 0.0, 0.95], (len(pose), 1)), np.zeros(10), 30.0), body)


def skin_of(body: BodyFile, actor: Actor, frame: int, without: tuple[int, ...]) -> np.ndarray:
    """Return the vertices of a frame, each as stiff as the joint that it follows most, without some joints'."""
    followed = body.weights.argmax(axis=1)
    points = body.shaped(np.zeros(10)) @ R_ARMATURE_BODY.T
    points = points - [0.0, 0.0, points[:, 2].min()]
    own = (actor.turns[frame, followed] @ (points - actor.rest[followed])[..., None])[..., 0]
    return (actor.joints[frame, followed] + own)[~np.isin(followed, without)]


def palm(joints: np.ndarray, arm: tuple[int, ...]) -> np.ndarray:
    return (joints[..., arm[2], :] + joints[..., arm[3], :]) / 2


def touching_pose(body: BodyFile, legs: np.ndarray, place: np.ndarray, arm: tuple[int, ...]) -> np.ndarray:
    """Return the pose (24, 3) whose palm is as near the skin about a place as one that lies on it."""
    sign = 1.0 if arm is LEFT else -1.0
    start = np.array([0.0, 0.0, -1.0 * sign, 0.0, -0.6 * sign, 0.0])
    rest = body.rest_joints(np.zeros(10))
    skin = skin_of(body, posed(body, legs[None]), 0, (*LEFT, *RIGHT, 13, 14))

    def turned(x: np.ndarray) -> np.ndarray:
        pose = legs.copy()
        pose[arm[0]], pose[arm[1]] = x[:3], x[3:]
        return pose

    def off(x: np.ndarray) -> np.ndarray:
        pose = turned(x)
        pose[0] = [np.pi / 2, 0.0, 0.0]
        middle = palm(pose_joints(rest, pose[None], np.array([[0.0, 0.0, 0.95]]))[1][0], arm)
        near = np.linalg.norm(skin - middle, axis=1).min()
        return np.array([5.0 * (near - PALM_M), *(middle - place), *(0.01 * (x - start))])

    return turned(least_squares(off, start, max_nfev=40).x)


def moving(body: BodyFile, contact: np.ndarray, arm: tuple[int, ...]) -> Actor:
    """Return an actor whose arm comes from the side, touches for a third of the time, and leaves."""
    share = np.clip(1.5 * np.sin(np.linspace(0.0, np.pi, FRAMES)), 0.0, 1.0)[:, None]
    pose = np.tile(contact, (FRAMES, 1, 1))
    for joint in arm[:2]:
        pose[:, joint] = share * contact[joint]
    return posed(body, pose)


def outside(points: np.ndarray, faces: np.ndarray, kept: np.ndarray, place: np.ndarray) -> float:
    """Return how far a place lies outside of the nearest of the kept vertices; negative inside."""
    candidates = np.flatnonzero(kept)
    ways = place - points[candidates]
    nearest = int(np.linalg.norm(ways, axis=1).argmin())
    corners = points[faces[(faces == candidates[nearest]).any(axis=1)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    return float(np.linalg.norm(ways[nearest]) * np.sign(ways[nearest] @ normal))


def of_actor(body: BodyFile, actor: Actor, arm: tuple[int, ...]) -> np.ndarray:
    """Return how far (F,) a palm is outside of the skin of what is not its arm."""
    kept = ~np.isin(body.weights.argmax(axis=1), (*arm, 13, 14))
    skins = (skin_of(body, actor, f, ()) for f in range(FRAMES))
    return np.array([outside(s, body.faces, kept, palm(actor.joints[f], arm)) for f, s in enumerate(skins)])


def of_rig(body: BodyFile, rig: bpy.types.Object, arm: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the same of a character as Blender shows it, and the wrists (F, 3)."""
    kept = ~np.isin(body.weights.argmax(axis=1), (*arm, 13, 14))
    side = "Left" if arm is LEFT else "Right"
    mesh = next(o for o in bpy.data.objects if o.type == "MESH")
    far, wrists = np.empty(FRAMES), np.empty((FRAMES, 3))
    for f in range(FRAMES):
        bpy.context.scene.frame_set(1 + f)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        bones = rig.evaluated_get(depsgraph).pose.bones
        ends = np.array([bones[f"mixamorig:{side}Hand{part}"].head for part in ("", "Middle1")])
        shown = mesh.evaluated_get(depsgraph).data
        points = np.empty(3 * len(shown.vertices), np.float32)
        shown.vertices.foreach_get("co", points)
        far[f] = outside(points.reshape(-1, 3).astype(float), body.faces, kept, ends.mean(0))
        wrists[f] = ends[0]
    return far, wrists


def played(actor: Actor, rig: bpy.types.Object, *, held: bool) -> Retargeted:
    settings = RetargetSettings(transfer=TransferSettings(hold_contacts=held))
    return retarget(actor, rig, bpy.context.scene, map_rig(rig), TakeTiming(1, 30.0), settings)


def bent_leg(joint: int) -> np.ndarray:
    pose = np.zeros((24, 3))
    pose[joint, 0], pose[joint + 3, 0] = -0.9, 1.2
    return pose


CASES = {
    "the side of the thigh": (np.zeros((24, 3)), LEFT, [0.22, -0.02, 0.68]),
    "the front of a thigh that is raised": (bent_leg(1), LEFT, [0.10, -0.30, 0.85]),
    "the hip": (np.zeros((24, 3)), RIGHT, [-0.19, -0.02, 1.00]),
    "the belly": (np.zeros((24, 3)), RIGHT, [-0.02, -0.16, 1.10]),
}


@pytest.mark.parametrize("shoulders", [1.0, BROADER])
@pytest.mark.parametrize("where", CASES)
def test_palms_on_the_body_stay_on_a_broader_one(
    scene: bpy.types.Scene, body: BodyFile, contacts: dict[str, tuple[Actor, np.ndarray]], where: str, shoulders: float
) -> None:
    legs, arm, place = CASES[where]
    if where not in contacts:
        actor = moving(body, touching_pose(body, legs, np.array(place), arm), arm)
        contacts[where] = actor, of_actor(body, actor, arm)
    actor, own = contacts[where]
    scene.render.fps = 30
    rig = own_character(body, BROADER, shoulders)
    touching = own < 0.03
    assert FRAMES / 4 < touching.sum() < 0.8 * FRAMES
    played(actor, rig, held=False)
    loose, free = of_rig(body, rig, arm)
    played(actor, rig, held=True)
    kept, wrists = of_rig(body, rig, arm)
    if shoulders < BROADER:
        assert np.abs(loose - own)[touching].min() > 0.03, "the body is broader than the touch allows for"
    assert np.abs(kept - own)[touching].max() < 0.015
    apart = own > 0.10
    assert apart.any() and np.abs(wrists - free)[apart].max() < 1e-4, "hands that touch nothing are left alone"
    step = np.linalg.norm(np.diff(wrists, axis=0), axis=1).max()
    assert step < 2.0 * np.linalg.norm(np.diff(free, axis=0), axis=1).max(), "hands do not jump"


def test_a_touch_beyond_short_arms_stops_short_and_blames_no_constraint(scene: bpy.types.Scene, body: BodyFile) -> None:
    legs, arm, place = CASES["the side of the thigh"]
    actor = moving(body, touching_pose(body, legs, np.array(place), arm), arm)
    scene.render.fps = 30
    done = played(actor, own_character(body, 1.0, 1.0, arms=0.7), held=True)
    assert done.deviation_mm < 0.5
    assert [note for note in done.notes if "out of reach of the rig's arm" in note]
    assert not [note for note in done.notes if "constraints" in note or "cannot follow" in note]
