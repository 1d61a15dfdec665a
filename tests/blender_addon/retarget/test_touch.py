"""Palms that touch on the actor touch on a broader figure, and hands that do not are left where they are."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_addon._exchange.motion_file import MotionFile
from blender_addon._exchange.so3 import matrix_from_rotvec
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import Actor, actor_of_motion
from blender_addon.retarget.motion.transfer import TransferSettings
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import RetargetSettings, retarget
from tests.support.foreign_characters import skinned_rig
from tests.support.own_skeleton import own_skeleton

BROADER = 1.2
FRAMES = 41


def clapping() -> Actor:
    """Return an actor whose palms come together and part again, arms before the chest."""
    pose = np.zeros((FRAMES, 24, 3))
    share = np.minimum(1.25 * np.sin(np.linspace(0, np.pi, FRAMES)), 1.0)
    for shoulder, elbow, sign in ((16, 18, 1.0), (17, 19, -1.0)):
        pose[:, shoulder, 1] = -sign * np.radians(50.0 + 20.0 * share)
        pose[:, elbow, 1] = -sign * np.radians(20.0 + 56.0 * share)
    body = read_body(default_body_path())
    motion = MotionFile("clap", pose, np.tile([0.0, 0.0, 0.95], (FRAMES, 1)), np.zeros(10), 30.0)
    R = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    upright = replace(motion, rotvec=np.concatenate([np.tile([np.pi / 2, 0, 0], (FRAMES, 1, 1)), pose[:, 1:]], axis=1))
    assert np.allclose(matrix_from_rotvec(upright.rotvec[0, 0]), R)
    return actor_of_motion(upright, body)


def palms_apart(heads: np.ndarray, knuckles: np.ndarray) -> np.ndarray:
    """Return the distance (F,) of the middles of the palms, from wrists and knuckles (F, 2, 3)."""
    middles = (heads + knuckles) / 2
    return np.linalg.norm(middles[:, 0] - middles[:, 1], axis=-1)


def shown(rig: bpy.types.Object) -> np.ndarray:
    names = [f"mixamorig:{side}Hand{part}" for part in ("", "Middle1") for side in ("Left", "Right")]
    found = np.empty((FRAMES, 4, 3))
    for f in range(FRAMES):
        bpy.context.scene.frame_set(1 + f)
        posed = rig.evaluated_get(bpy.context.evaluated_depsgraph_get())
        found[f] = [posed.matrix_world @ posed.pose.bones[name].head for name in names]
    return palms_apart(found[:, :2], found[:, 2:])


@pytest.mark.parametrize("held", [True, False])
def test_palms_that_touch_touch_on_a_broader_body(scene: bpy.types.Scene, held: bool) -> None:
    actor = clapping()
    own = palms_apart(actor.joints[:, [20, 21]], actor.joints[:, [22, 23]])
    skeleton = own_skeleton(read_body(default_body_path()), np.zeros(10))
    trunk = dict(skeleton.heads)

    def broader(name: str) -> np.ndarray:
        side = "Left" if "Left" in name else "Right"
        limb = "Arm" if "Arm" in name or "Hand" in name else "UpLeg" if "Leg" in name or "Foot" in name else ""
        base = trunk[f"mixamorig:{side}{limb}"] if limb else trunk[name]
        return trunk[name] + [(BROADER - 1.0) * base[0], 0.0, 0.0]

    rig = skinned_rig(replace(skeleton, heads={name: broader(name) for name in trunk}))
    scene.render.fps = 30
    settings = RetargetSettings(transfer=TransferSettings(hold_contacts=held))
    retarget(actor, rig, scene, map_rig(rig), TakeTiming(1, 30.0), settings)
    apart = shown(rig)
    touching = own < 0.055
    assert 3 < touching.sum() < FRAMES / 2
    if held:
        assert np.abs(apart - own)[touching].max() < 0.015
        assert np.abs(np.diff(apart)).max() < 2.5 * np.abs(np.diff(own)).max(), "hands do not jump"
    else:
        assert np.abs(apart - own)[touching].min() > 0.04, "the body is broader than the touch allows for"
    free = own > 0.35
    assert free.any() and np.all(apart[free] > own[free])
