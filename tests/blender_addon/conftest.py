"""Fixtures of the add-on's tests: a clean Blender, and stand-in files."""

from __future__ import annotations

import atexit

import bpy
import numpy as np
import pytest

from blender_addon.body.body_file import BodyFile, default_body_path, read_body
from blender_addon.body.rig import Rig, create_rig
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from tests.support.addon_stand_in import Files, write_files


@atexit.register
def _clear_handlers() -> None:
    """A handler of ours that is left behind would keep the interpreter from ending."""
    for name in dir(bpy.app.handlers):
        handlers = getattr(bpy.app.handlers, name)
        for handler in list(handlers) if isinstance(handlers, list) else []:
            if handler.__module__.split(".")[0] in ("blender_addon", "tests"):
                handlers.remove(handler)


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Write a body, a motion and a capture once."""
    return write_files(tmp_path_factory.mktemp("stand in ü"))


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
