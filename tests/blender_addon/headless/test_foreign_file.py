"""Files of other programs: a child opens them within limits, and its arrays are what an import here gives."""

from __future__ import annotations

import json
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from struct import pack
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.errors import FileDamaged
from blender_addon.errors import ImportStopped, SolverStopped
from blender_addon.headless.foreign_file import ImportLimits, open_foreign_scene, read_foreign_clips
from blender_addon.headless.main import main
from blender_addon.retarget.actor_file import ReadActor, read_actor_file, write_actor
from blender_addon.retarget.motion.figures import Actor, Hand, Trunk
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.rig_actor import read_rig_actor
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import draw
from tests.support.keyed_walk import play

_BOMB_MB = 400
EVENT = (
    "import json, sys, time;"
    "print(json.dumps({{'event': 'progress', 'stage': 's', 'done': {done}, 'total': 4}}), flush=True);"
)
"""A child's line of progress."""


def fbx_bomb(path: Path) -> Path:
    """Write an FBX file of 0.4 MB with an array of 400 MB (Blender's notes on binary FBX)."""
    deflate = zlib.compressobj(1)
    packed = b"".join(deflate.compress(bytes(2**20)) for _ in range(_BOMB_MB)) + deflate.flush()
    array = b"b" + pack("<III", _BOMB_MB * 2**20, 1, len(packed)) + packed
    head = b"Kaydara FBX Binary  \x00\x1a\x00" + pack("<I", 7400)
    name = b"Objects"
    end = len(head) + 13 + len(name) + len(array)
    node = pack("<IIIB", end, 1, len(array), len(name)) + name + array
    path.write_bytes(head + node + bytes(13))
    return path


def test_a_file_that_unpacks_to_gigabytes_is_stopped(tmp_path: Path, capfd: Any) -> None:
    bomb, out = fbx_bomb(tmp_path / "bomb.fbx"), tmp_path / "m.npz"
    assert main(["motion convert", str(bomb), "--out", str(out), "--import-memory", "350", "--json"]) == 3
    found = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert found["code"] == "import_stopped" and "350 MB are allowed" in found["message"]
    assert found["where"] == str(bomb) and "--import-memory" in found["hint"]
    assert not out.exists()


def test_a_file_that_takes_too_long_is_stopped(scene: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    with pytest.raises(ImportStopped, match=r"more than 0 s"):
        open_foreign_scene(path, ImportLimits(seconds=0.01))


def test_limits_follow_from_the_size_up_to_2_gb(tmp_path: Path) -> None:
    path = tmp_path / "a.fbx"
    sizes = []
    for megabytes in (0, 1, 300):
        with path.open("wb") as file:
            file.truncate(megabytes * 2**20)
        sizes.append(ImportLimits().of_file(path))
    assert sizes == [(512.0, 60.0), (612.0, 80.0), (2048.0, 6060.0)]
    assert ImportLimits(4096.0, 5.0).of_file(path) == (4096.0, 5.0)


def test_limits_count_what_a_file_names(tmp_path: Path) -> None:
    (tmp_path / "a b.bin").write_bytes(bytes(2**20))
    (tmp_path / "skin.png").write_bytes(bytes(2**20))
    buffers = [{"uri": "a%20b.bin"}, {"uri": "data:,x"}, {"uri": "x" * 5000}, {"uri": "a\0"}, {"uri": 5}, 5]
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps({"buffers": buffers, "images": [{"uri": "skin.png"}, {"uri": "skin.png"}]}))
    assert ImportLimits().of_file(path) == pytest.approx((712.0, 100.0), rel=0.01)
    blend = tmp_path / "a.blend"
    blend.write_bytes(b"x")
    assert ImportLimits().of_file(blend)[0] == 2048.0
    assert ImportLimits().of_file(blend, whole=True)[0] == np.inf
    assert ImportLimits(300.0).of_file(blend, whole=True)[0] == 300.0


def child(monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    """Let a program stand in for the child."""
    monkeypatch.setattr("blender_addon.headless.children.command_line", lambda: [sys.executable, "-c", program])


def test_a_crash_of_blender_is_named_once_it_opens_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.fbx"
    path.write_bytes(b"x")
    child(monkeypatch, EVENT.format(done=0) + "sys.exit(1)")
    with pytest.raises(FileDamaged, match="Blender crashed"):
        open_foreign_scene(path, ImportLimits())
    child(monkeypatch, "raise SystemExit(1)")
    with pytest.raises(SolverStopped, match=r"Blender's process \(import-file\) stopped without a result"):
        open_foreign_scene(path, ImportLimits())


def test_each_clip_has_the_time_of_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.fbx"
    path.write_bytes(b"x")
    steps = "".join(EVENT.format(done=done) + "time.sleep(0.8);" for done in range(4))
    child(monkeypatch, steps + "print(json.dumps({'event': 'result', 'outputs': [], 'notes': []}))")
    assert not list(read_foreign_clips(path, ImportLimits(seconds=2.0)))
    child(monkeypatch, (EVENT.format(done=0) + "time.sleep(0.8);") * 4)
    with pytest.raises(ImportStopped, match="more than 2 s"):
        list(read_foreign_clips(path, ImportLimits(seconds=2.0)))


def test_an_actor_of_the_child_is_that_of_an_import_here(scene: bpy.types.Scene, tmp_path: Path) -> None:
    rig, _ = foreign_rig(draw(NAMINGS["unreal_4"], 45.0))
    play(rig)
    path = tmp_path / "walk.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    here, _, notes = read_rig_actor(rig, scene, map_rig(rig))
    [there] = read_foreign_clips(path, ImportLimits())
    assert there.actor.name == "walk" and there.notes == notes and there.actor.fps == here.fps
    for name in ("rest", "turns", "joints", "contacts"):
        np.testing.assert_array_equal(getattr(there.actor, name), getattr(here, name))
    assert there.actor.skin.keys() == here.skin.keys() and there.actor.trunk is not None


def test_an_actor_file_holds_everything_and_nothing_else_is_read(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(1), tmp_path / "a.npz"
    hand = Hand(("left_index_1", "left_index_2"), *(rng.normal(size=s) for s in ((2, 3), (2, 4, 3, 3), (2, 3))))
    actor = Actor(
        "a", rng.normal(size=(24, 3)), rng.normal(size=(4, 24, 3, 3)), rng.normal(size=(4, 24, 3)), 30.0,
        rng.random((4, 2)) > 0.5, Trunk(np.arange(3.0), rng.normal(size=(3, 4, 3, 3))), (hand, hand),
        {"trunk": rng.normal(size=(5, 3))},
    )  # fmt: skip
    write_actor(path, ReadActor(actor, ("note", "another")), "walk")
    found = read_actor_file(path)
    assert found.notes == ("note", "another") and found.actor.name == "walk" and len(found.actor.hands) == 2
    np.testing.assert_array_equal(found.actor.hands[1].bends, hand.bends)
    np.testing.assert_array_equal(found.actor.contacts, actor.contacts)
    np.testing.assert_array_equal(found.actor.skin["trunk"], actor.skin["trunk"])
    assert found.actor.trunk is not None and found.actor.hands[0].roles == hand.roles
    path.unlink()
    write_actor(path, ReadActor(replace(actor, joints=actor.joints[:3])))
    with pytest.raises(FileDamaged, match="'turns' is float64 of shape"):
        read_actor_file(path)
    for changed in ({"joints": np.array(1.0)}, {"format": np.array("manifold_mocap_motion")}, {"turns": np.array("x")}):
        np.savez(path, **{**dict(np.load(path)), **changed})
        with pytest.raises(FileDamaged):
            read_actor_file(path)
