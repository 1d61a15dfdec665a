"""Studio, Live and From Videos in a sidebar of 200 pixels, opened and used by clicks.

``python -m tests.gui --script panels.py``: without a capture, and on the markers that ship.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import bpy

PACKAGE = "bl_ext.user_default.manifold_mocap"
_NARROW_PX = 200


def mocap() -> Any:
    """Return the scene's settings; undo makes earlier references invalid."""
    return bpy.context.scene.mocap


def steps(user: Any) -> Any:
    """Open each, look, use Live and Studio."""
    yield from user.open_tab("MoCap")
    yield from user.narrow(_NARROW_PX)
    yield from user.open_panel("VIEW3D_PT_mocap_videos")
    yield from user.shot("videos")
    yield from user.open_panel("VIEW3D_PT_mocap_studio", at_the_end=True)
    yield from user.open_panel("VIEW3D_PT_mocap_data_set")
    yield from user.find("mocap.check_data_set()")
    yield from user.shot("studio")
    yield from user.press("mocap.check_data_set()")
    yield from user.until(lambda: mocap().studio.planned, "the studio says what a data set needs", 120)
    yield from user.find("mocap.make_data_set()")
    yield from user.shot("data_set_checked")
    yield from live(user)


def live(user: Any) -> Any:
    """Replay the markers that ship, stop, and import what was recorded."""
    live_run = importlib.import_module(f"{PACKAGE}.ui.operators.live").live
    extension = importlib.import_module(PACKAGE)
    demo = Path(str(extension.__file__)).parent / "backend/solver_backend/assets/demo_markers.c3d"
    mocap().live.source = str(demo)
    yield from user.open_panel("VIEW3D_PT_mocap_live", at_the_end=True)
    yield from user.press("mocap.live_start()")
    yield from user.until(lambda: live_run.run is not None and live_run.run.shown > 5, "a body moves live", 120)
    user.look_at((0.0, 0.0, 0.9), 4.0)
    yield 2.0
    yield from user.shot("live")
    if live_run.busy:
        yield from user.press("mocap.live_stop()")
    yield from user.until(lambda: not live_run.busy, "live has stopped", 60)
    assert live_run.failure == "", live_run.failure
    assert Path(bpy.path.abspath(live_run.recorded)).is_file()
    yield from user.shot("live_stopped")
    yield from user.press("mocap.import_capture(filepath=", 0.85)
    yield from user.until(lambda: mocap().capture.markers > 0, "what was recorded is imported", 120)
    yield from user.shot("recorded")
