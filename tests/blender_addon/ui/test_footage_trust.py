"""Footage that somebody else's capture names elsewhere is not looked for until the user allows it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.capture_file import read_capture
from blender_addon._exchange.diagnostics import sentence
from blender_addon._exchange.progress import silent
from blender_addon.headless.bake import run_bake
from blender_addon.headless.verb_table import VERBS
from blender_addon.render.picture import write_png
from blender_addon.scene import cameras
from blender_addon.scene.cameras import find_footage, near_footage
from blender_addon.ui.operators.import_results import add_motion
from solver_backend.io.native.capture_file import read_capture as read_whole
from solver_backend.io.native.capture_file import write_capture
from tests.support.solved_capture import SolvedCapture


def foreign(folder: Path, footage: str, solved: SolvedCapture) -> Path:
    """Write the solved capture as somebody else's whose first camera names this footage."""
    folder.mkdir(exist_ok=True)
    whole = read_whole(solved.folder / "capture.npz")
    write_capture(folder / "foreign.npz", whole)
    with np.load(folder / "foreign.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    arrays["footage"] = np.array([footage] + [""] * (len(whole.cameras.names) - 1))
    np.savez(folder / "foreign.npz", **arrays)
    return folder / "foreign.npz"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Return what is looked for on the disk."""
    seen: list[Path] = []

    def looked(path: Path | None) -> Any:
        if path is not None:
            seen.append(path)
        return find_footage(path)

    monkeypatch.setattr(cameras, "find_footage", looked)
    return seen


@pytest.mark.parametrize(
    "named", ["/etc/passwd", "../outside/a.mp4", "//server/share/a.mp4", "a/../../b.mp4", "\\\\server\\share\\a.mp4"]
)
def test_names_that_lead_out_of_the_folder_are_refused_unseen(
    tmp_path: Path, named: str, solved: SolvedCapture
) -> None:
    capture = read_capture(solved.folder / "capture.npz")
    first = replace(capture.cameras[0], footage=Path(named) if named[0] in "/\\" else tmp_path / named)
    near, said = near_footage(replace(capture, cameras=(first, *capture.cameras[1:])), [tmp_path])
    assert near.cameras[0].footage is None
    assert len(said) == 1 and "is outside" in said[0] and "was not opened" in said[0]
    inside = replace(first, footage=tmp_path / "videos" / "a.mp4")
    assert near_footage(replace(capture, cameras=(inside,)), [tmp_path])[1] == ()
    beside = replace(first, footage=tmp_path.with_name(tmp_path.name + "2") / "a.mp4")
    assert len(near_footage(replace(capture, cameras=(beside,)), [tmp_path])[1]) == 1


@pytest.mark.slow
def test_a_foreign_captures_footage_is_asked_for(
    mocap: Any, solved: SolvedCapture, tmp_path: Path, asked: list[Path]
) -> None:
    write_png(tmp_path / "elsewhere.png", np.zeros((9, 16, 3), np.uint8))
    path = foreign(tmp_path / "foreign", str(tmp_path / "elsewhere.png"), solved)
    assert bpy.ops.mocap.import_capture(filepath=str(path)) == {"FINISHED"}
    assert asked == [] and not mocap.capture.cameras[0].has_footage
    assert any("was not opened" in sentence(item) for item in mocap.capture.problems)
    mocap.reading.footage_anywhere = True
    assert bpy.ops.mocap.import_capture(filepath=str(path)) == {"FINISHED"}
    assert asked == [tmp_path / "elsewhere.png"] and mocap.capture.cameras[0].has_footage


def test_footage_beside_the_capture_that_was_chosen_is_shown(
    mocap: Any, solved: SolvedCapture, tmp_path: Path, asked: list[Path]
) -> None:
    path = foreign(tmp_path / "foreign", "beside.png", solved)
    write_png(path.with_name("beside.png"), np.zeros((9, 16, 3), np.uint8))
    assert bpy.ops.mocap.import_capture(filepath=str(path)) == {"FINISHED"}
    assert len(asked) == 1 and mocap.capture.cameras[0].has_footage


def test_footage_beside_the_recording_stays_where_cameras_are_refined_or_restored(
    mocap: Any, solved: SolvedCapture, tmp_path: Path
) -> None:
    path = foreign(tmp_path / "foreign", "beside.png", solved)
    write_png(path.with_name("beside.png"), np.zeros((9, 16, 3), np.uint8))
    assert bpy.ops.mocap.import_capture(filepath=str(path)) == {"FINISHED"}
    mocap.capture.original = mocap.capture.file  # as after a refinement
    assert bpy.ops.mocap.restore_cameras() == {"FINISHED"}
    assert mocap.capture.cameras[0].has_footage
    assert not any("was not opened" in sentence(item) for item in mocap.capture.problems)


@pytest.mark.slow
def test_motions_and_headless_bakes_ask_too(
    mocap: Any, solved: SolvedCapture, tmp_path: Path, asked: list[Path]
) -> None:
    from blender_addon.scene.bake import BakeSettings

    elsewhere = tmp_path / "elsewhere.png"
    write_png(elsewhere, np.zeros((9, 16, 3), np.uint8))
    path, motion = foreign(tmp_path / "foreign", str(elsewhere), solved), solved.folder / "take_01.npz"
    take = add_motion(bpy.context, motion, BakeSettings(), path)
    assert asked == [] and any("was not opened" in note for note in take.notes)
    request = VERBS["bake"].arguments(motion=motion, out=tmp_path / "out", capture=path, no_pictures=True)
    result = run_bake(request, silent)
    assert asked == [] and any("was not opened" in note for note in result["notes"])
    given = {"capture": path, "no_pictures": True, "footage_from": [tmp_path], "overwrite": True}
    allowed = VERBS["bake"].arguments(motion=motion, out=tmp_path / "out", **given)
    assert not [note for note in run_bake(allowed, silent)["notes"] if "was not opened" in note]
    assert asked == [elsewhere]
