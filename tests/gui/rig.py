"""The rig and the panels from close by: a narrow sidebar, FK and IK by button, undo, the sliders' names.

``python -m tests.gui --script rig.py``: on the demo capture, in minutes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tests.gui.scene import mocap

_NARROW_PX = 200


def joints() -> Any:
    """Return the places of the body's bones on some frames, (F, J, 3)."""
    scene, found = bpy.context.scene, []
    armature = mocap().review.armature
    for frame in range(1, 60, 12):
        scene.frame_set(frame)
        shown = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
        names = [bone.name for bone in armature.data.bones if bone.name.endswith("_deform")]
        found.append([shown.pose.bones[name].head[:] for name in names])
    return np.array(found)


def switches() -> list[float]:
    """Return the limbs' switches."""
    root = mocap().review.armature.pose.bones["root"]
    return [root[f"{side}_{kind}_ik"] for kind in ("arm", "leg") for side in ("left", "right")]


def steps(user: Any) -> Any:
    """Make the demo in the factory scene, cube and all; solve, look, pose by IK and back."""
    assert "Cube" in bpy.data.objects
    yield from user.open_tab("MoCap")
    yield from user.narrow(_NARROW_PX)
    yield from user.shot("narrow_start")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')")
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    yield 1.0
    yield from user.shot("narrow_capture")
    mocap().solve.preset = "FAST"
    yield from user.press("mocap.solve()")
    yield 1.0
    yield from user.shot("narrow_running")
    yield from user.until(lambda: mocap().review.armature, "the capture is solved", 900)
    assert "Cube" in bpy.data.objects
    yield 1.0
    yield from user.shot("narrow_solved")
    user.note(f"sliders: {[key.name for key in mocap().review.armature.children[0].data.shape_keys.key_blocks[1:11]]}")
    yield from user.narrow(300)

    armature = mocap().review.armature
    user.look_at(armature.pose.bones["pelvis"].head, 3.0)
    before = joints()
    yield from user.press("mocap.switch_limbs(to='IK', limb='ALL')", 0.25)
    assert switches() == [1.0] * 4
    off = float(np.abs(joints() - before).max())
    user.note(f"to IK: joints are at most {1000 * off:.3f} mm off")
    assert off < 1e-3
    yield from user.shot("posed_by_ik")
    yield from user.key("Z", ctrl=True)
    yield 0.5
    assert switches() == [0.0] * 4, "undone"
    user.note("undone in one step")
    yield from user.press("mocap.switch_limbs(to='IK', limb='ALL')", 0.25)
    yield from user.press("mocap.switch_limbs(to='FK', limb='ALL')", 0.75)
    off = float(np.abs(joints() - before).max())
    user.note(f"there and back: joints are at most {1000 * off:.3f} mm off")
    assert off < 1e-3 and switches() == [0.0] * 4
    yield from user.shot("back_at_fk")
    bpy.ops.wm.save_as_mainfile(filepath="/work_io/six seconds.blend")
    user.note(f"saved: {Path('/work_io/six seconds.blend').stat().st_size / 1e6:.1f} MB")
