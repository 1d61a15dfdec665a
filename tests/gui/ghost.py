"""The first solve beside the start-up cube, controls in object mode, and the ghost of the take before.

``python -m tests.gui --script ghost.py``: on the demo capture in the factory scene.
"""

from __future__ import annotations

from typing import Any

import bpy

from tests.gui.scene import PACKAGE, extension, mocap

_FRAME = 200


def steps(user: Any) -> Any:
    """Solve with the cube in the scene, hide it, and compare a calmer take with the first."""
    assert "Cube" in bpy.data.objects
    yield from user.open_from_the_start(PACKAGE, "VIEW3D_PT_mocap_clean_up")
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    yield 0.5
    yield from user.shot("offered_before_the_solve")
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.press("mocap.solve()")
    yield from user.solved("the capture is solved")
    yield from user.shot("with_the_cube")
    yield from user.press("mocap.hide_cube()")
    cube = bpy.data.objects["Cube"]
    assert not cube.visible_get() and cube.users_collection, "it stays in the file"
    bpy.context.scene.frame_set(_FRAME)
    user.look_at(mocap().review.armature.pose.bones["pelvis"].head, 3.5)
    yield from user.shot("controls_in_object_mode")
    yield from ghost(user)


def ghost(user: Any) -> Any:
    """Move the body of the first take, solve again, and show and remove the ghost of the first take."""
    first = mocap().review.take.name
    yield from user.type_into("solve.smoothing", "5")
    yield from user.press("mocap.solve()")
    yield from user.solved("it is solved again")
    body = mocap().review.armature
    body.pose.bones["root"].location.x += 0.35
    bpy.context.view_layer.update()
    held = {name: len(getattr(bpy.data, name)) for name in ("objects", "actions", "meshes", "scenes", "armatures")}
    ghosts = extension("ui.viewport").ghosts
    yield from user.press(f'ghost_take(name="{first}")', 0.86)
    assert len(ghosts) == 1
    yield from user.shot("ghost_beside")
    body.pose.bones["root"].location.x -= 0.32
    bpy.context.view_layer.update()
    yield from user.shot("ghost_across")
    bpy.context.scene.frame_set(_FRAME + 60)
    yield from user.shot("ghost_later")
    yield from user.press(f'ghost_take(name="{first}")', 0.86)
    assert not ghosts
    assert held == {name: len(getattr(bpy.data, name)) for name in held}
    yield from user.shot("ghost_removed")
