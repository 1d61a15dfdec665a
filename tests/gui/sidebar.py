"""The sidebar as users first see it, 250 px wide, in English and in German: every stage before and after a solve.

``python -m tests.gui --script sidebar.py``: twenty pictures on the demo capture. Stages are opened by their property;
other scripts click on them.
"""

from __future__ import annotations

import json
from typing import Any

import bpy

from tests.gui.scene import empty, mocap

_WIDTH_PX = 250
_STAGES = ("CAPTURE", "SOLVE", "EDIT", "DELIVER")


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.narrow(_WIDTH_PX)
    yield from pictures(user, "empty")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    for camera in mocap().capture.cameras[1:]:  # so that something is to be reviewed
        gap = mocap().capture.left_out.add()
        gap.name, gap.first, gap.last = camera.name, 101, 120
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from pictures(user, "captured", "CAPTURE", "SOLVE")
    yield from user.press("mocap.solve()")
    yield from user.until(lambda: mocap().review.take, "it is solved", 900)
    yield from pictures(user, "solved")
    words = ("Camera cam02 is turned by 4°.", "Camera cam03 starts 12 frames late.")
    found = [{"code": "scene_message", "values": {"text": word}} for word in words]
    mocap().capture.findings = json.dumps(found)
    mocap().review.take["warnings"] = "The feet are 6 cm above the floor."
    yield from pictures(user, "problems", "CAPTURE", "EDIT")


def pictures(user: Any, name: str, *stages: str) -> Any:
    """Have stages pictured in both languages."""
    view = bpy.context.preferences.view
    for language in ("en_US", "de_DE"):
        view.language = language
        view.use_translate_interface = view.use_translate_tooltips = language != "en_US"
        for stage in stages or _STAGES:
            mocap().stage = stage
            user.viewport.tag_redraw()
            yield 0.5
            yield from user.shot(f"{name}_{stage.lower()}_{language}")
    view.language = "en_US"
