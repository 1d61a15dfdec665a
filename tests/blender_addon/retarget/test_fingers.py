"""Fingers of our motions on other rigs: bent as the body's, and left alone where the motion has none."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_addon._exchange.body_layout import SMPL_HANDS
from blender_addon.animation.curves import action_curves
from blender_addon.body.body_file import default_body_path, pose_joints, read_body, rotvec_on
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import retarget
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import draw
from tests.support.grasping_hand import FINGERS, FRAMES, grasping
from tests.support.rigify_rig import rigify_rig


def angle_deg(*places: np.ndarray) -> float:
    u, v = places[1] - places[0], places[2] - places[1]
    return float(np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))))


@pytest.mark.parametrize(
    ("naming", "arms_down"),
    [("mixamo", 0.0), ("unreal_5", 50.0), ("vroid", 0.0), ("vrm_own_names", 40.0), ("rigify_deform", 40.0)],
)
def test_fingers_bend_as_the_bodys(scene: bpy.types.Scene, naming: str, arms_down: float) -> None:
    motion = grasping(0.9)
    body = read_body(default_body_path(), motion.body_layout)
    rest = body.rest_joints(np.zeros(10))
    _, joints = pose_joints(rest, rotvec_on(motion, body.layout), motion.transl)
    rig, _ = foreign_rig(draw(NAMINGS[naming], arms_down))
    scene.render.fps = 30
    retarget(actor_of_motion(motion, body), rig, scene, map_rig(rig), TakeTiming(1, 30.0))
    roles = map_rig(rig).bones
    for f in (0, FRAMES - 1):
        scene.frame_set(1 + f)
        bones = rig.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        for finger in FINGERS[:4]:
            own = [joints[f, SMPL_HANDS.joints.index(f"left_{finger}{i}")] for i in (1, 2, 3)]
            theirs = [np.array(bones[roles[f"left_{finger}_{i}"]].head) for i in (1, 2, 3)]
            wrists = joints[f, SMPL_HANDS.joints.index("left_wrist")], np.array(bones[roles["left_hand"]].head)
            assert angle_deg(*theirs) == pytest.approx(angle_deg(*own), abs=1.0)
            assert angle_deg(wrists[1], *theirs[:2]) == pytest.approx(angle_deg(wrists[0], *own[:2]), abs=12.0)
    assert angle_deg(*theirs) > 40.0


@pytest.mark.slow
def test_fingers_of_a_generated_rigify_rig_bend_as_the_bodys(scene: bpy.types.Scene) -> None:
    motion = grasping(0.9)
    body = read_body(default_body_path(), motion.body_layout)
    _, joints = pose_joints(body.rest_joints(np.zeros(10)), rotvec_on(motion, body.layout), motion.transl)
    rig = rigify_rig(fingers=True)
    scene.render.fps = 30
    retarget(actor_of_motion(motion, body), rig, scene, map_rig(rig), TakeTiming(1, 30.0))
    for f in (0, FRAMES - 1):
        scene.frame_set(1 + f)
        bones = rig.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        for finger in FINGERS[:4]:
            own = [joints[f, SMPL_HANDS.joints.index(f"left_{finger}{i}")] for i in (1, 2, 3)]
            theirs = [np.array(bones[f"DEF-f_{finger}.0{i}.L"].head) for i in (1, 2, 3)]
            assert angle_deg(*theirs) == pytest.approx(angle_deg(*own), abs=3.0)
    assert angle_deg(*theirs) > 40.0


def test_a_thumb_at_the_place_of_its_hand_bends(scene: bpy.types.Scene) -> None:
    """Its bone shows no direction at rest."""
    motion = grasping(0.9)
    rig, _ = foreign_rig(draw(NAMINGS["mixamo"]))
    body = read_body(default_body_path(), motion.body_layout)
    actor = actor_of_motion(motion, body)
    hands = tuple(
        replace(h, directions=h.directions * [["thumb_1" not in role] for role in h.roles]) for h in actor.hands
    )
    done = retarget(replace(actor, hands=hands), rig, scene, map_rig(rig), TakeTiming(1, 30.0))
    curves = [curve for curve in action_curves(done.action) if "HandThumb1" in curve.data_path]
    assert len(curves) == 4 and all(np.isfinite(point.co[1]) for curve in curves for point in curve.keyframe_points)


def test_fingers_of_a_motion_without_any_are_left_alone(scene: bpy.types.Scene) -> None:
    motion = grasping(0.0)
    rig, _ = foreign_rig(draw(NAMINGS["mixamo"]))
    body = read_body(default_body_path(), motion.body_layout)
    done = retarget(actor_of_motion(motion, body), rig, scene, map_rig(rig), TakeTiming(1, 30.0))
    assert not any("HandIndex" in curve.data_path for curve in action_curves(done.action))
