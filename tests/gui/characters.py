"""The demo's motion on Rigify, Mixamo and characters of other programs' files, and a clip onto our body, by clicks.

``python -m tests.gui --script characters.py``. What the rigs show is measured as the benchmark measures it.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tests.gui.recordings import FIGURES
from tests.gui.scene import OUT, empty, extension, mocap

SHOWN = 60  # Frame of the pictures.
Made = tuple[bpy.types.Object, Any]


def support(module: str) -> Any:
    """Return a module of the tests' support, which knows the extension by the name of its source tree."""
    sys.modules["blender_addon"] = extension()
    environment = extension("backend_environment")
    paths = [str(OUT), *environment.environment_for_child()["PYTHONPATH"].split(os.pathsep)]
    sys.path += [path for path in paths if path not in sys.path]
    return importlib.import_module(f"tests.support.{module}")


def steps(user: Any) -> Any:
    """Solve the demo, retarget to each rig, measure, look; undo and redo; bring one rig's motion onto our body."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.press("mocap.solve()")
    yield from user.until(lambda: mocap().review.armature, "the capture is solved", 900)
    rigs, characters = support("retarget_rigs"), support("foreign_files").CHARACTERS
    yield from user.open_panel("VIEW3D_PT_mocap_retarget", at_the_end=True)
    makers: dict[str, Callable[[], Made]] = {"Mixamo": rigs.mixamo, "Rigify": rigs.rigify}
    makers |= {name: lambda character=character: imported(character) for name, character in characters.items()}
    # Last comes what is brought onto our body: its take with locked feet plays otherwise than its motion file.
    for name, make in sorted(makers.items(), key=lambda item: item[0] == "xbot_glb"):
        with bpy.context.temp_override(window=user.window, area=user.viewport, region=user.region("WINDOW")):
            rig, limbs = make()
        rig_name, rig.show_in_front = rig.name, True
        bpy.ops.ed.undo_push(message=name)
        yield from retargeted(user, name, rig_name)
        measured(user, name, bpy.data.objects[rig_name], limbs)
        if name in ("Mixamo", "Rigify"):
            yield from undone_and_redone(user, rig_name)
        if name == "xbot_glb":
            yield from brought_back(user, rig_name)
        mocap().retarget.target = mocap().retarget.actor = None
        remove(rig_name)


def imported(character: Any) -> Made:
    """Import a character from its file into the scene, as its user would."""
    path, before = OUT / FIGURES / character.file, set(bpy.data.objects)
    render = bpy.context.scene.render
    rate = render.fps, render.fps_base
    if path.suffix == ".blend":
        with bpy.data.libraries.load(str(path)) as (theirs, ours):
            ours.objects = list(theirs.objects)
        for obj in ours.objects:
            bpy.context.scene.collection.objects.link(obj)
    elif path.suffix == ".fbx":
        bpy.ops.import_scene.fbx(filepath=str(path))
    else:
        bpy.ops.import_scene.gltf(filepath=str(path))
    render.fps, render.fps_base = rate  # which the importer of FBX takes from the file
    return next(o for o in set(bpy.data.objects) - before if o.type == "ARMATURE"), character.limbs


def remove(rig_name: str) -> None:
    """Take a rig and what hangs on it out of the file."""
    rig = bpy.data.objects[rig_name]
    for obj in (*rig.children_recursive, rig):
        bpy.data.objects.remove(obj)


def plays(rig_name: str) -> bool:
    """Return whether a rig plays anything."""
    data = bpy.data.objects[rig_name].animation_data
    return data is not None and data.action is not None


def retargeted(user: Any, name: str, rig_name: str) -> Any:
    """Choose the rig, map it, lay the motion on it, look."""
    mocap().retarget.target = bpy.data.objects[rig_name]
    user.viewport.tag_redraw()
    yield 0.3
    yield from user.press("mocap.map_rig()", 0.9)
    user.note(f"{name} is mapped: {mocap().retarget.label}; {mocap().retarget.warnings or 'no doubts'}")
    if name == "Mixamo":
        yield from user.open_panel("VIEW3D_PT_mocap_bone_table", at_the_end=True)
        yield from user.shot("table_of_bones")
    yield from user.press("mocap.retarget()")
    yield from user.until(lambda: plays(rig_name), f"{name} plays the motion", 240)
    bpy.context.scene.frame_set(SHOWN)
    user.look_at(mocap().review.armature.pose.bones["pelvis"].head, 4.5)
    yield 1.0
    yield from user.shot(f"retargeted_{name.lower()}")


def undone_and_redone(user: Any, rig_name: str) -> Any:
    """Undo in one step, and redo."""
    yield from user.key("Z", ctrl=True)
    yield 0.5
    assert not plays(rig_name), "undone"
    yield from user.key("Z", ctrl=True, shift=True)
    yield 0.5
    assert plays(rig_name), "redone"
    user.note("undone and redone in one step")


def brought_back(user: Any, rig_name: str) -> Any:
    """Bring the character's motion onto a body of ours, and look at both."""
    before = mocap().review.armature.name
    mocap().retarget.target, mocap().retarget.actor = None, bpy.data.objects[rig_name]
    user.viewport.tag_redraw()
    yield 0.5
    yield from user.press("mocap.motion_from_rig()")
    yield from user.until(lambda: mocap().review.armature.name != before, "the body has the character's motion", 300)
    body = mocap().review.armature
    bpy.context.scene.frame_set(SHOWN)
    rig = bpy.data.objects[rig_name]
    roles = support("foreign_files").CHARACTERS["xbot_glb"].skeleton.roles
    bones = {"left_thigh": "left_hip", "left_forearm": "left_elbow", "right_hand": "right_wrist"}
    heads = [
        [rig.matrix_world @ rig.pose.bones[roles[role]].head, body.matrix_world @ body.pose.bones[own].head]
        for role, own in bones.items()
    ]
    apart = np.array([theirs - own for theirs, own in heads])
    off_mm = 1000.0 * float(np.linalg.norm(apart - apart.mean(axis=0), axis=1).max())  # the floor may differ
    user.note(f"brought onto our body: joints within {off_mm:.1f} mm")
    yield 1.0
    yield from user.shot("brought_onto_the_body")
    assert off_mm < 20.0
    yield from user.open_panel("VIEW3D_PT_mocap_clean_up")
    yield from user.press("mocap.lock_feet()")
    yield from user.until(lambda: mocap().review.take.name.endswith("locked feet"), "its feet are locked", 30)
    yield from user.shot("feet_locked")
    yield from user.open_stage("DELIVER")


def measured(user: Any, name: str, rig: bpy.types.Object, limbs: Any) -> None:
    """Hold hands, feet, twist and skating against the bounds."""
    measures = support("retarget_measures")
    from blender_addon._exchange.motion_file import read_motion
    from blender_addon.body.body_file import default_body_path, read_body

    motion = read_motion(Path(bpy.path.abspath(mocap().review.take["motion_file"])))
    scene, start = bpy.context.scene, float(mocap().review.take["frame_start"])
    step = scene.render.fps / scene.render.fps_base / motion.fps
    found = measures.score(
        rig, limbs, motion, read_body(default_body_path()), start + step * np.arange(motion.num_frames)
    )
    twists = f"{found.twist_deg:.2f}, {found.wrists_deg:.2f}, {found.hips_deg:.2f}, {found.pelvis_deg:.2f}"
    user.note(
        f"{name}: hands {found.hands_mm:.2f} mm, feet {found.feet_mm:.2f} mm, twist of hinges, wrists, hips and pelvis "
        f"{twists} degrees, skating {found.skating:.3f} of the actor's {found.skating_actor:.3f} cm a frame"
    )
    assert found.hands_mm < 10 and found.steps_mm < 10 and found.feet_mm < 35
    assert max(found.twist_deg, found.wrists_deg, found.hips_deg, found.pelvis_deg) < 5
    assert found.skating <= 1.001 * found.skating_actor
