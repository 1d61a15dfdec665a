"""A short capture, read and solved once, and the add-on registered."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import pytest

from blender_addon.solving.run import start
from blender_addon.ui.operators.import_results import take_capture, take_motion
from solver_backend.cli.main import main as solver
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.kept_scenes import KeptScene, registered
from tests.support.solved_capture import SolvedCapture


@pytest.fixture(scope="session")
def solved_once(tmp_path_factory: pytest.TempPathFactory) -> SolvedCapture:
    """Read and solve the first half second of the demo capture; nobody writes into its folder."""
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
    return SolvedCapture(folder, run.result)


@pytest.fixture(scope="module")
def solved(solved_once: SolvedCapture, tmp_path_factory: pytest.TempPathFactory) -> SolvedCapture:
    """Return a copy of the solved capture that the tests of a file may write beside."""
    return solved_once.copied_to(tmp_path_factory.mktemp("gelöst – 1"))


@pytest.fixture(scope="module")
def kept_solve(solved: SolvedCapture, tmp_path_factory: pytest.TempPathFactory) -> KeptScene[bpy.types.Action]:
    """Take the solved capture and its motion into a scene, once a file."""
    folder = tmp_path_factory.mktemp("kept")

    def taken(scene: bpy.types.Scene) -> bpy.types.Action:
        with registered():
            scene.mocap.folder = str(folder / "Aufnahmen ü")
            take_capture(scene, solved.read)
            return take_motion(bpy.context, solved.files)

    return KeptScene(folder / "solved.blend", taken)


@pytest.fixture
def mocap(scene: bpy.types.Scene, tmp_path: Path) -> Iterator[bpy.types.PropertyGroup]:
    with registered():
        scene.mocap.folder = str(tmp_path / "Aufnahmen ü")
        yield scene.mocap


@pytest.fixture
def solved_take(mocap: bpy.types.PropertyGroup, kept_solve: KeptScene[bpy.types.Action]) -> bpy.types.Action:
    """Return the take in the scene of its capture."""
    return kept_solve.found()
