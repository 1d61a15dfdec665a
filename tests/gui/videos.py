"""From videos to a body with fingers, by clicks, in the zip that includes a detector.

``python -m tests.gui --script videos.py``: four videos without a calibration. Cancelled once, then solved. Below
``unshare --net`` it has no network.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import bpy
import numpy as np

from tests.gui.offline import network
from tests.gui.recordings import VIDEOS
from tests.gui.scene import OUT, extension, mocap

_CLICKS = 3  # Clicks from the open tab to the body, without those in the file browser.
_FINGER = "left_index2"
_LEAST_DEG = 2.0  # A finger on the timeline moves by more than this.


def steps(user: Any) -> Any:
    """Import, cancel, import again, solve and look."""
    for name in ("cv2", "av", "ai_edge_litert", "onnxruntime", "mediapipe"):
        spec = importlib.util.find_spec(name)
        user.note(f"{name}: {None if spec is None else spec.origin}")
    user.note(f"network: {network() or 'on'}")
    yield from user.open_tab("MoCap")
    yield from user.shot("start")
    yield from chosen(user)
    yield from user.until(
        lambda: run() is not None and run().stage == "Detecting" and run().share > 0.1, "detecting", 300
    )
    yield from user.shot("detecting")
    user.note(f"the panel says: {run().headline}, {run().share:.0%}")
    yield from user.press("mocap.cancel()")
    yield from user.until(lambda: run() is None, "it is cancelled", 30)
    assert not mocap().capture.file and not list((OUT / VIDEOS).rglob("*.npz")), "no unfinished file"
    yield from user.shot("cancelled")

    user.clicks = 0
    yield from chosen(user)
    yield from user.until(lambda: mocap().capture.file, "the capture is imported", 1200)
    yield 1.0
    yield from user.shot("captured")
    yield from user.press("mocap.solve()")
    yield from user.until(lambda: mocap().review.take, "it is solved", 1200)
    user.note(f"{user.clicks} clicks without the file browser")
    assert user.clicks <= _CLICKS, user.clicks
    yield 1.0
    yield from user.shot("solved")
    yield from user.press("mocap.hide_cube()")
    body, scene = mocap().review.armature, bpy.context.scene
    user.look_at(body.pose.bones["pelvis"].head, 3.0)
    for frame in np.linspace(scene.frame_start, scene.frame_end, 3).astype(int).tolist():
        scene.frame_set(frame)
        yield 0.5
        yield from user.shot(f"frame_{frame}")
    angles = np.array([finger(body, frame) for frame in range(scene.frame_start, scene.frame_end + 1)])
    user.note(f"{len(angles)} frames at {scene.render.fps} fps; {_FINGER} bends by {np.ptp(angles):.1f} degrees")
    assert len(angles) == 100 and np.ptp(angles) > _LEAST_DEG


def chosen(user: Any) -> Any:
    """Press the button and choose the first video."""
    yield from user.press("mocap.capture_from_videos()")
    yield from user.accept_file(str(OUT / VIDEOS / "cam01.mp4"))


def run() -> Any:
    """Return the run in progress, None for none."""
    return extension("ui.operators.base").current.run


def finger(body: bpy.types.Object, frame: int) -> float:
    """Return how far a finger is bent on a frame, degrees."""
    bpy.context.scene.frame_set(frame)
    posed = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return float(np.degrees(posed.pose.bones[_FINGER].matrix_basis.to_quaternion().angle))
