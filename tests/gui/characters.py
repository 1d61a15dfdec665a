"""The demo's motion on a generated Rigify and a Mixamo-named rig of other proportions, by the panel's buttons.

``python -m tests.gui --script characters.py``. What the rigs show is measured as the benchmark measures it.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tests.gui.scene import empty, extension, mocap


def support() -> tuple[Any, Any]:
    """Return the tests' rigs and measures; they know the extension by the name of its source tree."""
    package = extension()
    sys.modules["blender_addon"] = package
    environment = extension("backend_environment")
    sys.path += ["/work_io", *environment.environment_for_child()["PYTHONPATH"].split(os.pathsep)]
    return importlib.import_module("tests.support.retarget_rigs"), importlib.import_module(
        "tests.support.retarget_measures"
    )


def steps(user: Any) -> Any:
    """Solve the demo, retarget to both, measure, undo, redo."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.press("mocap.solve()")
    yield from user.until(lambda: mocap().review.armature, "the capture is solved", 900)
    rigs, measures = support()
    yield from user.open_panel("VIEW3D_PT_mocap_retarget", at_the_end=True)
    for name, make, label in (("Mixamo", rigs.mixamo, "Mixamo"), ("Rigify", rigs.rigify, "Rigify")):
        with bpy.context.temp_override(window=user.window, area=user.viewport, region=user.region("WINDOW")):
            rig, limbs = make()
        rig_name = rig.name
        bpy.ops.ed.undo_push(message=name)
        yield from retargeted(user, name, label, rig_name)
        measured(user, name, measures, bpy.data.objects[rig_name], limbs)
        yield from user.key("Z", ctrl=True)
        yield 0.5
        assert not plays(rig_name), "undone"
        yield from user.key("Z", ctrl=True, shift=True)
        yield 0.5
        assert plays(rig_name), "redone"
        user.note("undone and redone in one step")


def plays(rig_name: str) -> bool:
    """Return whether a rig plays anything."""
    data = bpy.data.objects[rig_name].animation_data
    return data is not None and data.action is not None


def retargeted(user: Any, name: str, label: str, rig_name: str) -> Any:
    """Choose the rig, map it, lay the motion on it, look."""
    mocap().retarget.target = bpy.data.objects[rig_name]
    user.viewport.tag_redraw()
    yield 0.3
    yield from user.press("mocap.map_rig()")
    assert label.lower() in mocap().retarget.label.lower(), mocap().retarget.label
    if name == "Mixamo":
        yield from user.open_panel("VIEW3D_PT_mocap_rig_table", at_the_end=True)
        yield from user.shot("table_of_bones")
    yield from user.press("mocap.retarget()")
    yield from user.until(lambda: plays(rig_name), f"the {name} rig plays the motion", 120)
    bpy.context.scene.frame_set(60)
    user.look_at(mocap().review.armature.pose.bones["pelvis"].head, 4.5)
    yield 1.0
    yield from user.shot(f"retargeted_{name.lower()}")


def measured(user: Any, name: str, measures: Any, rig: bpy.types.Object, limbs: Any) -> None:
    """Hold hands, feet, twist and skating against the bounds."""
    from blender_addon._exchange.motion_file import read_motion  # pyright: ignore
    from blender_addon.body.body_file import default_body_path, read_body  # pyright: ignore

    motion = read_motion(Path(bpy.path.abspath(mocap().review.take["motion_file"])))
    scene, start = bpy.context.scene, float(mocap().review.take["frame_start"])
    step = scene.render.fps / scene.render.fps_base / motion.fps
    found = measures.score(
        rig, limbs, motion, read_body(default_body_path()), start + step * np.arange(motion.num_frames)
    )
    user.note(
        f"{name}: hands {found.hands_mm:.2f} mm, feet {found.feet_mm:.2f} mm, twist {found.twist_deg:.2f} degrees, "
        f"skating {found.skating:.3f} of the actor's {found.skating_actor:.3f} cm a frame"
    )
    assert found.hands_mm < 10 and found.feet_mm < 10 and found.twist_deg < 5
    assert found.skating <= found.skating_actor
