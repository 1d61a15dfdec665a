"""Times that an animator waits in addition to the solver, in the bpy module: importing a take or C3D, and IK switches.

"take" reads a motion of 100 and of 10,000 frames, creates body and action, and evaluates a frame, which is all work
between the solver's last line and the body. "c3d" imports CMU's 135_02 (5,202 frames) by *Import Capture*, including
its process. "ik" switches all limbs of 1,000 frames to IK, and "fk" back. Times are processor seconds of all threads,
the best of three, because machines are shared. The C3D needs the recordings next to the repository (or
MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

import blender_addon
from blender_addon.body.body_file import default_body_path
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.addon_stand_in import motion_arrays
from tests.support.recordings import ABSENT, recordings_folder

_REPEATS = 3
_FPS = 60.0


def run() -> list[Metric]:
    """Import takes and a recording, and switch limbs."""
    recording = recordings_folder() / "markers" / "cmu_pairs" / "135_02.c3d"
    if not recording.is_file():
        raise BenchmarkSkipped(ABSENT)
    blender_addon.register()
    try:
        with TemporaryDirectory() as name:
            folder = Path(name)
            found = {f"take_{count}_cpu_s": _take_s(folder, count) for count in (100, 10_000)}
            found["c3d_cpu_s"] = _c3d_s(recording, folder)
            found["ik_1000_cpu_s"], found["fk_1000_cpu_s"] = _limbs_s(folder)
    finally:
        blender_addon.unregister()
    return [Metric(key, value, "s", rel_tol=0.6, abs_tol=0.2) for key, value in found.items()]


def _motion(folder: Path, frames: int) -> Path:
    path = folder / f"motion_{frames}.npz"
    if not path.exists():
        np.savez(path, **motion_arrays(default_body_path(), frames=frames, fps=_FPS))
    return path


def _take_s(folder: Path, frames: int) -> float:
    path = _motion(folder, frames)

    def take() -> None:
        bpy.ops.mocap.import_motion(filepath=str(path), floor=False)
        bpy.context.scene.frame_set(bpy.context.scene.frame_start + 1)

    return min(_processor_s(take) for _ in range(_REPEATS))


def _c3d_s(recording: Path, folder: Path) -> float:
    def read() -> None:
        bpy.context.scene.mocap.folder = str(folder / "mocap")
        bpy.ops.mocap.import_capture(filepath=str(recording))

    return min(_processor_s(read) for _ in range(_REPEATS))


def _limbs_s(folder: Path) -> tuple[float, float]:
    _empty()
    bpy.ops.mocap.import_motion(filepath=str(_motion(folder, 1000)), floor=False)
    switched = [
        [_processor_s(lambda to=to: bpy.ops.mocap.switch_limbs(to=to), fresh=False) for to in ("IK", "FK")]
        for _ in range(_REPEATS)
    ]
    return min(row[0] for row in switched), min(row[1] for row in switched)


def _empty() -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def _processor_s(work: Callable[[], object], fresh: bool = True) -> float:
    """Return the processor seconds of a step, including processes that it starts and waits for."""
    if fresh:
        _empty()
    start = _used_s()
    work()
    return _used_s() - start


def _used_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime
