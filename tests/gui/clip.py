"""The README's animation: a real recording in Blender with its footage, the solved body and its confidence.

``python -m tests.gui --clip`` takes one picture of every other frame and puts them into
``docs/images/blender_take.webp``.
"""

from __future__ import annotations

from typing import Any

import bpy

from tests.gui.scene import TRIAL, empty, mocap

_EVERY = 2  # The recording has 100 frames, of which 50 at five frames per second last ten seconds.
_SETTLED_S = 2.0  # A screen without a graphics card needs a while.
_DRAWN_S = 0.35
_CAMERA = 0


def steps(user: Any) -> Any:
    """Import the recording, solve it, show the confidence through a camera, and play it frame by frame."""
    empty()
    yield from user.open_tab("MoCap")
    with user.override:
        files = [{"name": "Config.toml"}]
        bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=str(TRIAL), files=files)
    yield from user.until(lambda: mocap().capture.file, "the capture is read", 240)
    yield from user.press("mocap.solve()")
    yield from user.until(lambda: mocap().review.armature, "the capture is solved", 900)
    yield _SETTLED_S
    yield from user.press("mocap.show_confidence()")
    user.viewport.spaces.active.overlay.show_bones = False  # so that the controls do not cover the body
    with user.override:
        bpy.ops.mocap.view_camera(index=_CAMERA)
    yield _SETTLED_S
    first, last = mocap().review.first, mocap().review.last
    assert last - first >= 90, (first, last)
    view = user.region("WINDOW")
    yield from user.move(view.x + view.width // 3, view.y + view.height // 3)
    for frame in range(first, last + 1, _EVERY):
        bpy.context.scene.frame_set(frame)
        yield _DRAWN_S
        yield from user.shot(f"frame_{frame:04d}")
