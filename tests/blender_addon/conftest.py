"""Fixtures of the add-on's tests: a clean Blender, and stand-in files."""

from __future__ import annotations

import atexit
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.capture_file import CaptureFile, read_capture
from blender_addon._exchange.motion_file import MotionFile, read_motion
from blender_addon.body.body_file import BodyFile, default_body_path, read_body
from blender_addon.body.rig import Rig, create_rig
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from tests.support.addon_stand_in import capture_arrays, motion_arrays, write_body


@atexit.register
def _clear_handlers() -> None:
    """A handler of ours that is left behind would keep the interpreter from ending."""
    for name in dir(bpy.app.handlers):
        handlers = getattr(bpy.app.handlers, name)
        for handler in list(handlers) if isinstance(handlers, list) else []:
            if handler.__module__.split(".")[0] in ("blender_addon", "tests"):
                handlers.remove(handler)


@dataclass(frozen=True)
class Files:
    """Stand-in files and what they hold."""

    folder: Path
    body_path: Path
    motion_path: Path
    capture_path: Path
    body: BodyFile
    motion: MotionFile
    capture: CaptureFile


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Write a body, a motion and a capture once."""
    folder = tmp_path_factory.mktemp("stand in ü")
    body = write_body(folder / "body.npz")
    arrays = motion_arrays(body)
    np.savez(folder / "walk.npz", **arrays)
    np.savez(folder / "capture.npz", **capture_arrays(arrays["joints"]))
    return Files(
        folder=folder,
        body_path=body,
        motion_path=folder / "walk.npz",
        capture_path=folder / "capture.npz",
        body=read_body(body),
        motion=read_motion(folder / "walk.npz"),
        capture=read_capture(folder / "capture.npz"),
    )


@pytest.fixture
def scene() -> bpy.types.Scene:
    """Return the scene of an empty Blender session."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


@pytest.fixture
def take(scene: bpy.types.Scene, files: Files) -> BakedTake:
    """Return the stand-in take, baked into the empty scene."""
    return bake_take(scene, files.motion, files.body, files.capture, BakeSettings())


@pytest.fixture(scope="session")
def body() -> BodyFile:
    """Return the body that ships."""
    return read_body(default_body_path())


@pytest.fixture
def rig(scene: bpy.types.Scene, body: BodyFile) -> Rig:
    """Return the mean body as a rig."""
    return create_rig("Body", body, np.zeros(10), scene.collection)
