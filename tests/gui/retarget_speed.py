"""How long 1,000 frames take on a Rigify and a Mixamo-named rig without a window, in the real application.

``python -m tests.gui --script retarget_speed.py``: the demo's motion, 1,000 frames long, is solved and retargeted by
the verbs of the installed extension. Seconds are the verb's: files are read and written, Blender's start is left out.
"""

from __future__ import annotations

import json
import subprocess
from typing import Any

import bpy

from tests.gui.characters import support
from tests.gui.recordings import LONG_DEMO
from tests.gui.scene import OUT, empty

_RUNS = 3


def steps(user: Any) -> Any:
    """Make the rigs' files, solve, retarget thrice each."""
    empty()
    yield 0.5
    rigs, _ = support()
    files = {}
    for name, make in (("mixamo", rigs.mixamo), ("rigify", rigs.rigify)):
        with bpy.context.temp_override(window=user.window, area=user.viewport, region=user.region("WINDOW")):
            rig, _ = make()
        bpy.context.view_layer.update()
        files[name] = (OUT / f"{name}.blend", rig.name)
        bpy.ops.wm.save_as_mainfile(filepath=str(files[name][0]), copy=True)
        empty()
    motion = OUT / "long.npz"
    verb("solve", str(OUT / LONG_DEMO), "--out", str(motion))
    for name, (path, rig_name) in files.items():
        told = []
        for run in range(_RUNS):
            out = OUT / f"{name}_{run}.blend"
            told.append(verb("retarget", str(motion), "--target", str(path), "--object", rig_name, "--out", str(out)))
            yield 0.1
        seconds = [result["seconds"] for result in told]
        user.note(f"{name}: {told[0]['frames']} frames in {seconds} s, {told[0]['hands_and_feet_deviation_mm']} mm off")
        assert told[0]["frames"] == 1000 and min(seconds) <= 3.0, seconds


def verb(*arguments: str) -> dict[str, Any]:
    """Run a verb of the extension in a Blender without a window and return its result."""
    command = [bpy.app.binary_path, "--command", "manifold_mocap", *arguments, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(next(line for line in reversed(done.stdout.splitlines()) if line.startswith("{")))
