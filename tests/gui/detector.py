"""*Set Up Detector…* by clicks: asked first, offline, failed, cancelled, set up from a folder of wheels, tested.

``python -m tests.gui --script detector.py``: the wheels hold next to nothing, so that nothing is downloaded. A Blender
whose Python makes no environments (Debian's without python3-venv) names that instead.
"""

from __future__ import annotations

import shutil
from importlib.util import find_spec
from typing import Any

import bpy

from tests.gui.recordings import WHEELS
from tests.gui.scene import OUT, extension, mocap

_EMPTY = OUT / "leer"
_OFFERED = "mocap.set_up_detector"


def steps(user: Any) -> Any:
    """Play it."""
    find_python = extension("solving.pythons")
    shutil.rmtree(find_python.environment_folder("litert"), ignore_errors=True)  # of an earlier run
    yield from user.open_tab("MoCap")
    yield from user.open_panel("VIEW3D_PT_mocap_videos")
    yield from user.shot("none")
    yield from asked(user, "", "ESC")
    assert not busy() and find_python.made_litert_python() is None
    user.note("Escape: nothing is made")
    if find_spec("ensurepip") is None:
        yield from asked(user, str(OUT / WHEELS), "RET")
        yield 1.0
        yield from user.shot("no_environments")
        assert not busy() and find_python.made_litert_python() is None
        user.note("a Python without ensurepip is named")
        return
    yield from asked(user, "", "RET")
    yield 0.5
    yield from user.shot("offline")
    yield from user.key("ESC")  # the report of an error goes when the mouse does
    assert not busy(), "Blender is set to stay offline: nothing is asked of a network"
    _EMPTY.mkdir()
    yield from asked(user, str(_EMPTY), "RET")
    yield from user.until(lambda: not busy(), "the empty folder is named", 120)
    assert error() == "detector_not_made" and find_python.made_litert_python() is None
    yield from user.shot("failed")
    yield from user.key("ESC")
    yield from asked(user, str(OUT / WHEELS), "RET")
    yield from user.until(busy, "it is at work", 10)
    yield from user.shot("progress")
    yield from user.press("mocap.cancel()")
    yield from user.until(lambda: not busy(), "it is cancelled", 30)
    assert error() == "cancelled" and find_python.made_litert_python() is None, error()
    yield from user.shot("cancelled")
    yield from asked(user, str(OUT / WHEELS), "RET")
    yield from user.until(lambda: not busy(), "it is set up", 120)
    assert find_python.made_litert_python() is not None, error()
    assert mocap().videos.hands.endswith("hand_landmark_full.tflite"), mocap().videos.hands
    assert mocap().videos.detector == "model" and mocap().videos.model.endswith("pose_landmark_full.tflite")
    yield 0.5
    yield from user.shot("set_up")


def asked(user: Any, wheels: str, answer: str) -> Any:
    """Press the button, look at the question, and answer by a key."""
    last = bpy.context.window_manager.operator_properties_last(_OFFERED)
    last.kind, last.wheels = "litert", wheels
    yield from user.press(_OFFERED)
    yield 0.5
    yield from user.shot(f"asked_{answer.lower()}")
    for value in ("PRESS", "RELEASE"):
        user.window.event_simulate(type=answer, value=value, x=user._x, y=user._y)
        yield None
    yield 0.3


def busy() -> bool:
    """Return whether a run is under way."""
    return bool(extension("ui.operators.base").current.busy)


def error() -> str:
    """Return the code of what went wrong in the last run, "" where nothing did."""
    last = extension("ui.operators.base").current.last
    return "" if last is None or last.error is None else str(last.error["code"])
