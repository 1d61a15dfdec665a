"""A first-time user's path: from an empty Blender to an FBX for Unreal, with the demo and with a C3D of one's own.

``python -m tests.gui --script first_animation.py``: clicks are counted; choosing a file does not count.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tests.gui.recordings import WALK
from tests.gui.scene import OUT, mocap

_MOST_CLICKS = 6
_WIDTH_PX = 250


def steps(user: Any) -> Any:
    """Go the path twice, in the scene that Blender starts with."""
    yield from path(user, "demo", demo)
    bpy.ops.wm.read_homefile()
    yield 1.5
    yield from path(user, "c3d", own_recording)


def path(user: Any, name: str, capture: Any) -> Any:
    """Capture, solve, deliver; count the clicks, and read the file back."""
    yield from user.open_tab("MoCap")
    user.clicks = 1  # on the tab
    objects = {obj.name: obj.matrix_world.copy() for obj in bpy.data.objects}
    yield from user.shot(f"{name}_start")
    yield from capture(user)
    yield from user.shot(f"{name}_captured")
    yield from user.press("mocap.solve()")
    yield from user.until(lambda: mocap().review.take, "it is solved", 900)
    assert mocap().stage == "EDIT" and mocap().review.take.name == "Take 01", mocap().review.take.name
    yield 1.0
    yield from user.shot(f"{name}_solved")
    out = OUT / f"{name}.fbx"
    yield from user.press('node="Armature"', 0.25)
    yield from user.shot(f"{name}_export")
    yield from user.accept_file(str(out))
    yield from user.until(out.is_file, "the FBX is there", 180)
    user.note(f"{name}: {user.clicks} clicks beside the choice of files, {out.stat().st_size / 1e6:.1f} MB")
    assert user.clicks <= _MOST_CLICKS, user.clicks
    yield from user.shot(f"{name}_delivered")
    kept = {obj.name: obj.matrix_world for obj in bpy.data.objects if obj.name in objects}
    assert set(kept) == set(objects) and all(kept[key] == objects[key] for key in kept), "the scene's own stays"
    read_back(user, out)


def demo(user: Any) -> Any:
    """Press the demo's button."""
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    yield 1.0


def own_recording(user: Any) -> Any:
    """Press Import Capture and choose the recording."""
    yield from user.press("mocap.import_capture()")
    yield from user.accept_file(str(OUT / WALK))
    yield from user.until(lambda: mocap().capture.markers > 0, "the recording is read", 180)
    yield 1.0


_READ = """
import bpy, json, sys
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
bpy.ops.import_scene.fbx(filepath=sys.argv[-1])
[rig] = [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]
roots = [bone.name for bone in rig.data.bones if bone.parent is None]
first, last = rig.animation_data.action.frame_range
print(json.dumps({"roots": roots, "scale": list(rig.matrix_world.to_scale()), "frames": last - first + 1}))
"""


def read_back(user: Any, path: Path) -> None:
    """Read the FBX in another Blender and look at its skeleton."""
    command = [bpy.app.binary_path, "--background", "--python-expr", _READ, "--", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True)
    found = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    user.note(f"read back: {found}")
    assert found["roots"] == ["root"] and found["frames"] > 50
    assert np.allclose(found["scale"], 0.01, rtol=1e-3), "centimetres, and nothing else is scaled"
