"""Work that leaves Blender free: an export, and few keys and switched limbs of a take that counts as long.

``python -m tests.gui --script second_blender.py``: on the demo capture.
"""

from __future__ import annotations

from typing import Any

import bpy

from tests.gui.scene import OUT, PACKAGE, empty, extension, mocap


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_from_the_start(PACKAGE, "VIEW3D_PT_mocap_take")
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.press("mocap.solve()")
    yield from user.solved("the capture is solved")
    yield from user.shot("solved_in_a_new_scene")
    yield from few_keys(user)
    yield from limbs(user)
    yield from export(user)


def few_keys(user: Any) -> Any:
    """Reduce keys in the background, and look at the progress."""
    base = extension("ui.operators.base")
    base.SHORT, full = 0, mocap().review.take.name
    yield from user.press("by='TOLERANCE'", 0.25)
    yield from user.until(lambda: base.current.busy, "the run is on", 10)
    bpy.context.scene.frame_set(50)
    assert base.current.busy, "Blender is free while the keys are reduced"
    yield from user.shot("few_keys_run")
    yield from user.until(lambda: not base.current.busy, "the keys are reduced", 120)
    take = mocap().review.take
    user.note(take["keys_deviation"])
    yield from user.shot("few_keys_done")
    assert take.name == f"{full} reduced keys" and take.users > 0


def limbs(user: Any) -> Any:
    """Switch all limbs to IK in the background."""
    base, body = extension("ui.operators.base"), mocap().review.armature.name
    yield from user.press("mocap.switch_limbs(to='IK', limb='ALL')", 0.25)
    yield from user.until(lambda: base.current.busy, "the switch runs in the background", 20)
    yield from user.shot("limbs_run")
    yield from user.until(lambda: not base.current.busy, "the switch ended", 180)
    yield 1.0
    yield from user.shot("limbs_done")
    assert bpy.data.objects[body].pose.bones["root"]["left_arm_ik"] == 1.0


def export(user: Any) -> Any:
    """Export by clicks in the background: cancelled first, then to its end."""
    base, path = extension("ui.operators.base"), OUT / "my take.fbx"
    for cancelled in (True, False):
        yield from user.press('node="Armature"', 0.25)
        yield from user.accept_file(str(path))
        yield from user.until(lambda: base.current.busy, "it is exported in the background", 20)
        assert not path.exists(), "Blender is free while it is written"
        if cancelled:
            bpy.ops.mocap.cancel()  # an export ends before the mouse finds the button
        else:
            yield from user.shot("export_run")
        yield from user.until(lambda: not base.current.busy, "the export ended", 180)
        yield 1.0
        yield from user.shot("export_cancelled" if cancelled else "export_done")
        assert path.is_file() != cancelled and not list(OUT.glob(".*fbx*")), list(OUT.iterdir())
    user.note(mocap().exported)
    assert path.name in mocap().exported, mocap().exported
    assert len(bpy.data.scenes) == 1
