"""Retarget on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import pytest

from blender_addon._exchange.diagnostics import diagnostic
from blender_addon._exchange.motion_file import write_motion
from blender_addon.headless.main import main
from tests.support.mixamo_rig import mixamo_rig


def said(capfd: pytest.CaptureFixture[str]) -> dict[str, Any]:
    return json.loads(capfd.readouterr().out.splitlines()[-1])


@pytest.fixture
def rig_file(scene: bpy.types.Scene, tmp_path: Path) -> Path:
    for name in ("Hero", "Other"):
        mixamo_rig(name)
    path = tmp_path / "rigs ü.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def test_a_motion_file_goes_onto_a_rig_of_a_file(files: Any, rig_file: Path, tmp_path: Path, capfd: Any) -> None:
    out, kept, before = tmp_path / "out.blend", tmp_path / "map.json", rig_file.read_bytes()
    given = ["retarget", str(files.motion_path), "--target", str(rig_file), "--body", str(files.body_path), "--json"]
    chosen = [*given, "--object", "Hero", "--out", str(out)]
    assert main([*chosen, "--save-map", str(kept)]) == 0
    result = said(capfd)
    assert result["outputs"] == [str(out), str(kept)] and result["map"] == "Mixamo" and result["frames"] == 60
    assert rig_file.read_bytes() == before
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert bpy.data.objects["Hero"].animation_data.action.frame_range[:] == (1.0, pytest.approx(1 + 59 * 24 / 30))
    assert bpy.data.objects["Other"].animation_data is None
    assert main(chosen) == 3 and said(capfd)["code"] == "output_exists"
    assert main([*chosen, "--overwrite", "--map", str(kept), "--in-place"]) == 0


def test_a_rig_that_plays_one_cameras_motion_repeats_its_warnings(
    files: Any, rig_file: Path, tmp_path: Path, capfd: Any
) -> None:
    record = json.dumps({"diagnostics": [diagnostic("limb_depth_open", frames=[(3, 9)], part="left arm").as_dict()]})
    motion = write_motion(tmp_path / "walk.npz", replace(files.motion, provenance=record))
    given = ["retarget", str(motion), "--target", str(rig_file), "--object", "Hero", "--body", str(files.body_path)]
    assert main([*given, "--out", str(tmp_path / "out.blend"), "--json"]) == 0
    assert any(note.startswith("The depth of the left arm is ambiguous in frames 3-9") for note in said(capfd)["notes"])


def test_what_is_wrong_is_named_and_nothing_is_written(files: Any, rig_file: Path, tmp_path: Path, capfd: Any) -> None:
    out = tmp_path / "out.blend"
    given = ["retarget", str(files.motion_path), "--body", str(files.body_path), "--out", str(out), "--json"]
    cases = [
        (["--target", str(rig_file)], "target_unsuitable"),
        (["--target", str(rig_file), "--object", "Renamed"], "target_unsuitable"),
        (["--target", str(rig_file), "--object", "Hero", "--preset", "mixano"], "map_invalid"),
        (["--target", str(rig_file), "--object", "Hero", "--preset", "rigify"], "map_invalid"),
        (["--target", str(tmp_path / "gone.blend")], "file_missing"),
    ]
    for options, code in cases:
        assert main([*given, *options]) == 3
        assert said(capfd)["code"] == code
    assert not out.exists() and sorted(path.name for path in tmp_path.iterdir()) == [rig_file.name]
