"""A folder of clips onto one character: actions with asset marks, a file a clip, and what fails named beside."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy
import pytest

from blender_addon.animation.curves import current_action
from blender_addon.headless.main import main
from tests.support.foreign_characters import write_character
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import draw
from tests.support.keyed_walk import play


@pytest.fixture
def clips(scene: bpy.types.Scene, tmp_path: Path) -> Path:
    """Write a folder with two actions in one file, a clip, a broken file and a file of another kind."""
    folder = tmp_path / "clips ü"
    folder.mkdir()
    rig, _ = foreign_rig(draw(NAMINGS["unreal_4"], 45.0))
    play(rig)
    bpy.data.actions.remove(bpy.data.actions[0])
    for name in ("walk", "run/fast"):
        rig.animation_data.action = None
        play(rig)
        action = current_action(rig)
        assert action is not None
        action.name, action.use_fake_user = name, True
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "moves.blend"))
    bpy.ops.export_anim.bvh(filepath=str(folder / "one.bvh"), frame_start=1, frame_end=20)
    (folder / "broken.fbx").write_bytes(b"Kaydara FBX Binary  \x00" + bytes(40))
    (folder / "notes.txt").write_text("not a clip")
    return folder


# Blender's importer of BVH leaves its file to the garbage collector.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_every_clip_is_laid_and_written(clips: Path, tmp_path: Path, capfd: Any) -> None:
    target = write_character(tmp_path / "hero.glb", draw(NAMINGS["mixamo"]))
    out = tmp_path / "out" / "hero.blend"
    given = ["retarget", str(clips), "--target", str(target), "--out", str(out), "--export", "gltf", "--json"]
    assert main(given) == 3, "one file is broken"
    result = json.loads(capfd.readouterr().out.splitlines()[-1])
    names = {"moves run_fast", "moves walk", "one"}
    assert {clip["clip"] for clip in result["clips"]} == names
    assert [entry["clip"] for entry in result["failed"]] == ["broken.fbx"]
    assert {path.name for path in out.parent.iterdir()} == {"hero.blend", *(f"{name}.glb" for name in names)}
    bpy.ops.wm.open_mainfile(filepath=str(out))
    marked = {action.name: action for action in bpy.data.actions if action.asset_data is not None}
    assert set(marked) == names
    rig = next(o for o in bpy.data.objects if o.type == "ARMATURE")
    assert rig.animation_data.action.name in names and not len(rig.animation_data.nla_tracks)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.gltf(filepath=str(out.parent / "one.glb"))
    assert len(bpy.data.actions) >= 1
    assert main(given) == 3 and json.loads(capfd.readouterr().out.splitlines()[-1])["code"] == "output_exists"


def test_folders_without_clips_are_named(scene: Any, tmp_path: Path, capfd: Any) -> None:
    target = write_character(tmp_path / "hero.glb", draw(NAMINGS["mixamo"]))
    empty = tmp_path / "empty"
    empty.mkdir()
    given = ["retarget", str(empty), "--target", str(target), "--out", str(tmp_path / "o.blend"), "--json"]
    assert main(given) == 3
    assert "contains no clips" in json.loads(capfd.readouterr().out.splitlines()[-1])["message"]
    (empty / "bad.glb").write_bytes(b"glTF" + bytes(40))
    assert main(given) == 3
    assert "No clip of the folder" in json.loads(capfd.readouterr().out.splitlines()[-1])["message"]
    assert not (tmp_path / "o.blend").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_several_characters_get_a_folder_each(clips: Path, tmp_path: Path, capfd: Any) -> None:
    for name in ("broken.fbx", "moves.blend"):
        (clips / name).unlink()
    targets = [
        write_character(tmp_path / "hero.glb", draw(NAMINGS["mixamo"])),
        write_character(tmp_path / "villain.fbx", draw(NAMINGS["unreal_5"], 45.0)),
    ]
    (tmp_path / "chair.blend").write_bytes(b"not a blend")
    named = [part for path in (*targets, tmp_path / "chair.blend") for part in ("--target", str(path))]
    out = tmp_path / "out" / "moves.blend"
    given = ["retarget", str(clips), "--out", str(out), "--export", "gltf", "--json"]
    assert main([*given, *named]) == 3, "one target is damaged"
    result = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert list(result["targets"]) == ["hero", "villain"] and [f["target"] for f in result["failed"]] == ["chair"]
    written = {path.relative_to(out.parent).as_posix() for path in out.parent.rglob("*") if path.is_file()}
    assert written == {f"{name}/{file}" for name in ("hero", "villain") for file in ("moves.blend", "one.glb")}
    assert sorted(result["outputs"]) == sorted(str(out.parent / name) for name in written)
    twice = [*given, "--target", str(targets[0]), "--target", str(tmp_path / "other" / "Hero.fbx")]
    assert main(twice) != 0 and "the same name" in json.loads(capfd.readouterr().out.splitlines()[-1])["message"]
    assert main([*given, "--target", str(tmp_path / "a.fbx"), "--target", str(tmp_path / "b.fbx")]) == 3
    assert "any target" in json.loads(capfd.readouterr().out.splitlines()[-1])["message"]
