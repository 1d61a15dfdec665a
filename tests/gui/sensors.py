"""The panels *Live* and *Rig*: markers replayed, sensors shown, a wand waved and calibrated, takes imported.

``python -m tests.gui --script sensors.py``: on a real recording of markers, and on painted pictures of two sensors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from tests.gui.recordings import KATA, SENSORS, WAND
from tests.gui.scene import OUT, PACKAGE, empty, extension, mocap

_LONGEST_S = 300


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_from_the_start(PACKAGE)
    yield from user.open_acquisition(PACKAGE)
    yield from user.narrow(283)
    yield from live_panel(user)
    yield from a_take(user)
    yield from a_wand(user)
    yield from cameras_that_are_not_there(user)


def running() -> Any:
    """Return the live run."""
    return extension("ui.operators.live").live


def ended(user: Any, what: str) -> Any:
    """Wait for the live run to end, without a failure."""
    yield from user.until(lambda: not running().busy, what, _LONGEST_S)
    yield 0.5
    assert running().failure == "", running().failure


def live_panel(user: Any) -> Any:
    """Replay a recording of markers, stop, import what was recorded."""
    mocap().live.source = str(OUT / KATA)
    user.viewport.tag_redraw()
    yield 0.3
    yield from user.press("mocap.live_start()")
    yield from user.until(lambda: running().run and running().run.shown > 20, "twenty poses are shown", _LONGEST_S)
    user.look_at((0.0, 0.0, 0.9), 3.5)
    yield 1.0
    yield from user.find("mocap.live_stop()")
    yield from user.shot("live_runs")
    assert running().run is not None and running().run.latest.rotvec is not None
    yield from user.press("mocap.live_stop()")
    yield from ended(user, "live is stopped")
    recorded = running().recorded
    assert recorded and Path(bpy.path.abspath(recorded)).is_file(), recorded
    yield from user.find("mocap.import_capture(filepath=", 0.8)
    yield from user.shot("live_recorded")
    yield from user.press("live_01.c3d", 0.8)
    yield from user.until(lambda: mocap().capture.markers > 0, "what was recorded is a capture", 120)
    yield 0.5
    yield from user.shot("live_imported")


def a_take(user: Any) -> Any:
    """Show sensors' points, record them, import the take."""
    mocap().sensors.kind, mocap().sensors.source = "FOLDER", str(OUT / SENSORS)
    yield from user.press("mocap.start_sensors(part='TAKE')")
    yield from user.until(lambda: not running().busy or running().run.shown > 1, "sensors are shown", _LONGEST_S)
    yield from user.shot("rig_runs")
    yield from ended(user, "the recording is at its end")
    assert Path(bpy.path.abspath(mocap().sensors.take)).name == "take_01", mocap().sensors.take
    yield from user.find("take_01", 0.5)
    yield from user.shot("rig_recorded")
    captures = len(mocap().captures)
    yield from user.press("take_01")
    yield from user.until(lambda: len(mocap().captures) == captures + 1, "the take is a capture", 300)
    yield 0.5
    yield from user.shot("rig_imported")


def a_wand(user: Any) -> Any:
    """Wave a wand: coverage while it is seen, a sentence where it is none, a calibration where it is one."""
    yield from user.press("mocap.start_sensors(part='WAND')")
    yield from user.until(lambda: not running().busy or running().run.latest, "coverage is told", _LONGEST_S)
    yield from user.shot("wand_is_waved")
    assert running().run is None or running().run.latest.state == "waving"
    yield from ended(user, "the wand's recording is at its end")
    yield from user.press("mocap.calibrate_sensors()")
    yield from user.solved("what was waved is no wand")
    assert mocap().sensors.calibration == ""
    yield from user.shot("no_wand")
    yield from user.key("ESC")  # the message stays up until it is dismissed, in Blender 5
    mocap().sensors.wand = str(OUT / WAND)
    yield from user.press("mocap.calibrate_sensors()")
    yield 1.0
    yield from user.shot("calibrating")
    yield from user.solved("the sensors are calibrated")
    assert Path(bpy.path.abspath(mocap().sensors.calibration)).is_file()
    yield from user.find("mocap.calibrate_sensors()")
    yield from user.shot("calibrated")
    user.note(f"said: {mocap().sensors.findings.splitlines()}")


def cameras_that_are_not_there(user: Any) -> Any:
    """Look for cameras where there are none."""
    mocap().sensors.kind = "OAK"
    user.viewport.tag_redraw()
    yield 0.3
    yield from user.press("mocap.find_sensors()")
    yield from user.solved("cameras are looked for", 60)
    assert mocap().sensors.oaks == ""
    yield from user.shot("no_cameras")
    yield from user.key("ESC")
    yield from user.narrow(200)
    yield from user.find("mocap.find_sensors()")
    yield from user.shot("narrow")
