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
from tests.support.kept_scenes import KeptScene, empty_scene

KEPT = ("kept_take", "kept_rig", "kept_solve", "kept_import")
"""Fixtures that keep a scene; those of the user interface are with its tests."""


@atexit.register
def _clear() -> None:
    """A handler of ours that is left behind, or a scene's driver in Python, would keep the interpreter from ending."""
    for name in dir(bpy.app.handlers):
        handlers = getattr(bpy.app.handlers, name)
        for handler in list(handlers) if isinstance(handlers, list) else []:
            if handler.__module__.split(".")[0] in ("blender_addon", "tests"):
                handlers.remove(handler)
    empty_scene()


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Write a body, a motion and a capture once."""
    return write_files(tmp_path_factory.mktemp("stand in ü"))


@pytest.fixture(scope="session")
def body() -> BodyFile:
    """Return the body that ships."""
    return read_body(default_body_path())


@pytest.fixture(scope="session")
def kept_take(tmp_path_factory: pytest.TempPathFactory, files: Files) -> KeptScene[BakedTake]:
    """Bake the stand-in take once."""
    path = tmp_path_factory.mktemp("kept") / "take.blend"
    return KeptScene(path, lambda scene: bake_take(scene, files.motion, files.body, files.capture, BakeSettings()))


@pytest.fixture(scope="session")
def kept_rig(tmp_path_factory: pytest.TempPathFactory, body: BodyFile) -> KeptScene[Rig]:
    """Create the mean body as a rig once."""
    path = tmp_path_factory.mktemp("kept") / "rig.blend"
    return KeptScene(path, lambda scene: create_rig("Body", body, np.zeros(10), scene.collection))


@pytest.fixture
def scene(request: pytest.FixtureRequest) -> bpy.types.Scene:
    """Return the scene of an empty Blender session, or of one that holds what the test has of it."""
    kept = [name for name in KEPT if name in request.fixturenames]
    assert len(kept) < 2, "a scene holds one of them"
    return request.getfixturevalue(kept[0]).opened() if kept else empty_scene()


@pytest.fixture
def take(scene: bpy.types.Scene, kept_take: KeptScene[BakedTake]) -> BakedTake:
    """Return the stand-in take, baked into the empty scene."""
    return kept_take.found()


@pytest.fixture
def rig(scene: bpy.types.Scene, kept_rig: KeptScene[Rig]) -> Rig:
    """Return the mean body as a rig."""
    return kept_rig.found()
