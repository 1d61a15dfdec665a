"""A short capture, read and solved once, and the add-on registered."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import pytest

import blender_addon
from blender_addon.animation.takes import SolveFiles
from blender_addon.solving.run import start
from blender_addon.ui.operators.import_results import take_capture, take_motion
from solver_backend.cli.main import main as solver
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthetic.demo import demo_capture


@dataclass(frozen=True)
class Solved:
    """A short capture, what the solver said when it read it, and its solved motion."""

    folder: Path
    read: dict[str, Any]

    @property
    def files(self) -> SolveFiles:
        return SolveFiles(*(self.folder / name for name in ("take_01.npz", "capture.npz", "take_01.html", "job.json")))


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Solved:
    """Read and solve the first half second of the demo capture once."""
    folder = tmp_path_factory.mktemp("gelöst – 1")
    whole = demo_capture()
    assert whole.keypoints is not None
    write_capture(folder / "source.npz", replace(whole, keypoints=whole.keypoints.frames(0, 30), truth={}))
    run = start("convert", [str(folder / "source.npz"), "--out", str(folder / "capture.npz")], None, folder)
    run.process.wait()
    while not run.finished:
        run.poll()
    assert run.result is not None, run.error
    out = ["--out", str(folder / "take_01.npz"), "--report", str(folder / "take_01.html")]
    assert solver(["solve", str(folder / "capture.npz"), *out]) == 0
    (folder / "job.json").write_text("{}")
    return Solved(folder, run.result)


@pytest.fixture
def mocap(scene: bpy.types.Scene, tmp_path: Path) -> Iterator[bpy.types.PropertyGroup]:
    blender_addon.register()
    scene.mocap.folder = str(tmp_path / "Aufnahmen ü")
    yield scene.mocap
    blender_addon.unregister()


@pytest.fixture
def solved_take(mocap: bpy.types.PropertyGroup, solved: Solved) -> bpy.types.Action:
    """Return the take in the scene of its capture."""
    take_capture(bpy.context.scene, solved.read)
    return take_motion(bpy.context, solved.files)
