"""How long 1,000 frames take on a Rigify and a Mixamo-named rig without a window, in the real application.

``python -m tests.gui --script retarget_speed.py``: the demo's motion, 1,000 frames long, is solved and retargeted by
the verbs of the installed extension. Files are read and written; Blender's start is taken off the processor's seconds.
"""

from __future__ import annotations

import json
import resource
import subprocess
from typing import Any

import bpy

from tests.gui.characters import support
from tests.gui.recordings import LONG_DEMO
from tests.gui.scene import OUT, empty

_RUNS, _LONGEST_S = 3, 3.0


def steps(user: Any) -> Any:
    """Make the rigs' files, solve, retarget thrice each."""
    empty()
    yield 0.5
    rigs = support("retarget_rigs")
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
    start = processor_s([bpy.app.binary_path, "--background", "--python-expr", "pass"])
    for name, (path, rig_name) in files.items():
        told, used = [], []
        for run in range(_RUNS):
            out = OUT / f"{name}_{run}.blend"
            before = children_s()
            told.append(verb("retarget", str(motion), "--target", str(path), "--object", rig_name, "--out", str(out)))
            used.append(round(children_s() - before - start, 2))
            yield 0.1
        wall = [result["seconds"] for result in told]
        off = told[0]["hands_and_feet_deviation_mm"]
        user.note(f"{name}: {told[0]['frames']} frames in {used} s of processor time, {wall} s of wall; {off} mm off")
        assert told[0]["frames"] == 1000 and min(used) <= _LONGEST_S, used


def processor_s(command: list[str]) -> float:
    """Return the seconds of processor time that a command uses."""
    before = children_s()
    subprocess.run(command, capture_output=True, check=True)
    return children_s() - before


def children_s() -> float:
    """Return the seconds of processor time that the programs which this one started have used."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def verb(*arguments: str) -> dict[str, Any]:
    """Run a verb of the extension in a Blender without a window and return its result."""
    command = [bpy.app.binary_path, "--command", "manifold_mocap", *arguments, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(next(line for line in reversed(done.stdout.splitlines()) if line.startswith("{")))
