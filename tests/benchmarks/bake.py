"""How long a bake takes: ``python tests/benchmarks/bake.py [FRAMES ...]``.

Bakes a synthetic motion of 24 bones onto the add-on's own body. Prints, for each length, the seconds of the action
alone (curves of 24 bones and the pelvis's path) and of the whole bake (armature, mesh, action, overlay, floor): wall
time and, because machines are shared, processor time; the best of three. Nothing is written.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import bpy
import numpy as np

from blender_addon.bake.action import bake_action
from blender_addon.bake.scene import bake_take
from blender_addon.files.body_file import BodyFile, default_body_path, read_body
from blender_addon.files.motion_file import MotionFile, read_motion
from tests.blender_addon.stand_in import motion_arrays

REPEATS = 3


def main() -> None:
    """Bake each length and print the table."""
    lengths = [int(text) for text in sys.argv[1:]] or [1000, 10_000]
    body = read_body(default_body_path())
    say = sys.stdout.write
    say(f"Blender {bpy.app.version_string}, {len(body.v_template)} vertices, best of {REPEATS}\n")
    say(f"{'frames':>8}  {'action s':>9}  {'cpu s':>7}  {'bake s':>9}  {'cpu s':>7}\n")
    for frames in lengths:
        motion = synthetic_motion(frames)
        action, action_cpu, bake, bake_cpu = np.min([measure(motion, body) for _ in range(REPEATS)], axis=0)
        say(f"{frames:>8}  {action:>9.3f}  {action_cpu:>7.3f}  {bake:>9.3f}  {bake_cpu:>7.3f}\n")


def synthetic_motion(frames: int) -> MotionFile:
    """Return a walk on a circle."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.npz"
        np.savez(path, **motion_arrays(default_body_path(), frames=frames))
        return read_motion(path)


def measure(motion: MotionFile, body: BodyFile) -> tuple[float, float, float, float]:
    """Return wall and processor seconds of the action alone, then of the whole bake."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    start, start_cpu = time.perf_counter(), time.process_time()
    take = bake_take(bpy.context.scene, motion, body)
    whole = time.perf_counter() - start, time.process_time() - start_cpu
    start, start_cpu = time.perf_counter(), time.process_time()
    bake_action("again", motion, take.armature, body.rest_joints(motion.betas)[0], take.timing)
    return time.perf_counter() - start, time.process_time() - start_cpu, *whole


if __name__ == "__main__":
    main()
