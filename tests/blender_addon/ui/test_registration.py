"""Registering, importing by the operator, and the built extension."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import pytest

import blender_addon
import build_addon

ROOT = Path(__file__).resolve().parents[3]

_TWICE = """
import gc
import bpy
import blender_addon
def census():
    handlers = {n: len(h) for n in dir(bpy.app.handlers) if isinstance(h := getattr(bpy.app.handlers, n), list)}
    menus = len(getattr(bpy.types.TOPBAR_MT_file_import.draw, "_draw_funcs", (None,)))
    return sorted(n for n in dir(bpy.types) if "mocap" in n.lower()), handlers, menus, sorted(dir(bpy.types.Scene))
before = census()
for _ in range(2):
    blender_addon.register()
    assert "MOCAP_OT_import_motion" in dir(bpy.types) and census() != before and gc.isenabled()
    blender_addon.unregister()
    assert census() == before, (before, census())
print("clean")
"""


def test_registering_twice_leaves_nothing_behind() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _TWICE], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "clean", done.stdout + done.stderr


def test_registering_loads_nothing_that_works_with_arrays_or_processes() -> None:
    """A bare Blender has not loaded NumPy: that alone would take longer than registering may (``bench_register``)."""
    code = """
import bpy, sys
for name in [name for name in sys.modules if name.split(".")[0] in ("numpy", "subprocess", "json", "tempfile")]:
    del sys.modules[name]
before = set(sys.modules)
import blender_addon
blender_addon.register()
print(*sorted({name.split(".")[0] for name in set(sys.modules) - before} - {"blender_addon"}))
blender_addon.unregister()
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not {"numpy", "subprocess", "json", "tempfile", "zipfile", "argparse"} & set(done.stdout.split()), (
        done.stdout
    )


def test_importing_the_package_does_not_load_blender() -> None:
    code = "import sys, blender_addon, blender_addon.__main__; print('bpy' in sys.modules, 'numpy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split()[0] == "False"


@pytest.fixture
def registered(scene: bpy.types.Scene) -> Iterator[None]:
    blender_addon.register()
    yield
    blender_addon.unregister()


def test_operator_bakes_a_file(registered: None, scene: bpy.types.Scene, files: Any) -> None:
    scene.frame_start = 7
    done = bpy.ops.mocap.import_motion(
        filepath=str(files.motion_path), capture_path=str(files.capture_path), body_path=str(files.body_path)
    )
    assert done == {"FINISHED"}
    assert bpy.context.object.name == "walk" and bpy.context.object.select_get()
    assert scene.frame_start == 7 and scene.frame_end == 66
    assert bpy.context.object.animation_data.action.frame_range[:] == (7.0, 66.0)


def test_operator_says_what_is_wrong(registered: None, files: Any) -> None:
    with pytest.raises(RuntimeError, match="was solved with the body 'stand_in'"):
        bpy.ops.mocap.import_motion(filepath=str(files.motion_path))
    with pytest.raises(RuntimeError, match="There is no such file"):
        bpy.ops.mocap.import_motion(filepath=str(files.folder / "gone.npz"))
    assert not bpy.data.objects


def test_operator_asks_to_leave_other_modes(registered: None, scene: bpy.types.Scene) -> None:
    armature = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
    scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    assert not bpy.ops.mocap.import_motion.poll()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.ops.mocap.import_motion.poll()


def test_zip_installs_and_bakes_in_blender(files: Any, tmp_path: Path) -> None:
    """The installed extension has another package name, and finds its own body."""
    path = build_addon.build(tmp_path)
    code = f"""
import bpy, os, subprocess
install = bpy.ops.extensions.package_install_files
assert install(filepath={str(path)!r}, repo="user_default", enable_on_install=True) == {{"FINISHED"}}
from bl_ext.user_default.manifold_mocap.body.body_file import default_body_path
assert "user_default" in str(default_body_path()), default_body_path()
from bl_ext.user_default.manifold_mocap.backend_environment import backend_command, environment_for_child
assert all("user_default" in path for path in environment_for_child()["PYTHONPATH"].split(os.pathsep))
subprocess.run([*backend_command(), "--version"], env=environment_for_child(), check=True)
done = bpy.ops.mocap.import_motion(filepath={str(files.motion_path)!r}, body_path={str(files.body_path)!r})
assert done == {{"FINISHED"}}
bpy.ops.preferences.addon_disable(module="bl_ext.user_default.manifold_mocap")
assert not hasattr(bpy.types, "MOCAP_OT_import_motion")
print("works")
"""
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path / "user")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=environment,
        cwd=tmp_path,
    )
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "works", done.stdout + done.stderr
