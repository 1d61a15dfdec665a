"""What scripts ask of the scene and of the extension that is installed."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import bpy

PACKAGE = "bl_ext.user_default.manifold_mocap"
OUT = Path("/work_io")
"""Where the run's folder is seen from inside."""
TRIAL = OUT / "Aufnahme ü/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"
SESSION = OUT / "Sitzung ü"


def mocap() -> Any:
    """Return the scene's settings; undo and opening a file make earlier references invalid."""
    return bpy.context.scene.mocap


def empty() -> None:
    """Take everything out of the scene."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    bpy.ops.ed.undo_push(message="empty scene")


def extension(module: str = "") -> Any:
    """Return the extension or one of its modules."""
    return importlib.import_module(f"{PACKAGE}.{module}" if module else PACKAGE)


def file_of(key: str) -> Path:
    """Return a file that the shown take refers to."""
    return Path(bpy.path.abspath(mocap().review.take[key]))


def joints(body: bpy.types.Object, frames: range) -> Any:
    """Return where the joints of a body are on scene frames, (F, 24, 3) metres."""
    import numpy as np

    scene, now = bpy.context.scene, bpy.context.scene.frame_current
    measure = extension("animation.deviation").evaluated_joints
    found = np.stack([measure(scene, body, frame) for frame in frames])
    scene.frame_set(now)
    return found
