"""Readers of the studio's data sets, of arrays' maps, and of what the add-on's child processes say."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blender_addon.headless.batch.request import BatchRequest
from blender_addon.render.picture import read_targa
from blender_addon.retarget import recognition
from blender_addon.retarget.rig_map import read_map
from blender_addon.solving.child import event_in
from blender_addon.solving.run import Run
from blender_addon.studio.scene_file import FORMAT as SCENE
from blender_addon.studio.scene_file import read_scene
from research.priors import load_prior
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.png import png_bytes, read_png
from solver_backend.synthesis.studio.data_set import DESCRIPTION, SHOTS, read_data_set
from solver_backend.synthesis.studio.make_shot import DONE
from solver_backend.synthesis.studio.spec import read_spec
from tests.fuzz import odd_values
from tests.fuzz.motion_targets import read_as_if_whole
from tests.fuzz.odd_motions import changed
from tests.fuzz.target import Target, Write, file, nothing
from tests.support.random_weights import write_random
from tests.support.scenes import small_capture

_JSON = {".json": "json"}
_SPEC: dict[str, Any] = {
    "version": 1, "name": "small", "seed": 3, "fps": 30, "frames": 4, "motions": ["choreography"],
    "people": {"count": 2, "sigma": 0.5, "strange": True},
    "camera_arrays": ["azure_kinect_3", {"preset": "azure_kinect_3", "name": "again"}], "looks": ["suit"],
    "film": ["infrared", "depth", "rgb"], "write": ["coco", "c3d"], "markers": "MANIFOLD_53", "joint_set": "BODY_25",
    "perturb": "none", "rgb": {"engine": "workbench", "samples": 2, "noise": 0.01},
}  # fmt: skip
_PRESETS = sorted((Path(recognition.__file__).parent / "presets").glob("*.json"))


def _data_set(folder: Path) -> None:
    values = {"format": "manifold_mocap_studio", "version": "1", "digest": "ab", "folder": ".", "description": _SPEC}
    (folder / DESCRIPTION).write_text(json.dumps(values))
    shot = folder / SHOTS / "s"
    shot.mkdir(parents=True)
    (shot / DONE).write_text(json.dumps({"name": "s", "frames": 4}))


def _png(picture: np.ndarray) -> Write:
    return file("a.png", png_bytes(picture))


def _pictures() -> tuple[Write, ...]:
    rng = np.random.default_rng(2)
    grey = rng.integers(0, 255, (5, 7))
    colour = rng.integers(0, 255, (5, 7, 3)).astype(np.uint8)
    return _png(grey.astype(np.uint8)), _png((grey * 200).astype(np.uint16)), _png(colour)


def _chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def _png_of(filters: Sequence[int], depth: int = 8, kind: int = 0, interlaced: int = 0) -> Write:
    """Return what writes a small picture whose rows are packed by these filters."""
    step = {0: 1, 2: 3, 3: 1, 6: 4}[kind] * depth // 8
    rows = b"".join(bytes([which]) + bytes(range(4 * step)) for which in filters)
    head = struct.pack(">IIBBBBB", 4, len(filters), depth, kind, 0, 0, interlaced)
    chunks = _chunk(b"IHDR", head) + _chunk(b"IDAT", zlib.compress(rows)) + _chunk(b"IEND", b"")
    return file("a.png", b"\x89PNG\r\n\x1a\n" + chunks)


_ODD_PNG: tuple[Write, ...] = (
    _png_of([0, 1, 2, 0]), _png_of([3, 4, 3, 4]), _png_of([4, 1, 0, 2, 3], kind=2), _png_of([4, 3], depth=16),
    _png_of([4, 2], kind=6), _png_of([9]), _png_of([0], interlaced=1), _png_of([0], kind=3), _png_of([]),
    file("a.png", b"\x89PNG\r\n\x1a\n"), file("a.png", b"GIF89a"),
)  # fmt: skip


def _data_set_of(**values: object) -> Write:
    def write(folder: Path) -> None:
        _data_set(folder)
        kept = json.loads((folder / DESCRIPTION).read_text()) | values
        (folder / DESCRIPTION).write_text(json.dumps({k: v for k, v in kept.items() if v is not None}))

    return write


def _no_shots(folder: Path) -> None:
    _data_set(folder)
    (folder / SHOTS / "s" / DONE).unlink()


def _shot_of(text: str) -> Write:
    return lambda folder: (_data_set(folder), (folder / SHOTS / "s" / DONE).write_text(text))


_ODD_DATA_SETS: tuple[Write, ...] = (
    _data_set_of(description=None), _data_set_of(folder=5), _data_set_of(format="other"), _no_shots, _shot_of("[]"),
    _shot_of("{"),
)  # fmt: skip


def _array(look: str, array: dict[str, Any] | None = None) -> Write:
    """Return what writes a description of shots with an array, and a capture that one may name."""

    def write(folder: Path) -> None:
        write_capture(folder / "c.npz", small_capture(2, views=2))
        arrays = [{"layout": "ring", "count": 2} if array is None else array]
        (folder / "a.json").write_text(json.dumps({"version": 1, "camera_arrays": arrays, "looks": [look]}))

    return write


def _read_spec(folder: Path) -> object:
    spec = read_spec(folder / "a.json")
    return spec.perturb.of_views, spec.perturb.of_markers


def _targa(folder: Path) -> None:
    head = bytes([0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 2, 0, 24, 0x20])
    (folder / "a.tga").write_bytes(head + bytes(range(18)))


def _scene(folder: Path) -> None:
    arrays = {
        "format": np.array(SCENE), "version": np.array(1), "base": np.arange(4, dtype=np.int32),
        "offset_m": np.zeros(4, np.float32), "faces": np.array([[0, 1, 2], [1, 2, 3]], np.int32),
        "label": np.array([0, 1]), "labels": np.array(["skin", "shirt"]), "rest": np.zeros((4, 3), np.float32),
        "room": np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 3.0]]), "walls": np.array(True),
        "furniture": np.zeros((1, 4, 3)),
    }  # fmt: skip
    np.savez(folder / "a.npz", **arrays)


class _Said:
    """Stands in for a process that has said some lines and ended."""

    exit_code, cancelling = 1, False

    def __init__(self, lines: list[str]) -> None:
        self._items = [event_in(line) for line in lines]

    def received(self) -> list[str | dict[str, Any]]:
        items, self._items = self._items, []
        return items


def _hear(folder: Path) -> object:
    text = (folder / "a.txt").read_bytes().decode("utf-8", "replace")
    run = Run("solve", _Said(text.split("\n")))  # type: ignore[arg-type]
    while not run.finished:
        run.poll()
    return run.headline, run.share, run.result, run.error


def _prior(name: str) -> Target:
    return Target(
        f"weights of {name}", (lambda f: write_random(f / "a.npz", name),),
        lambda f: read_as_if_whole(f, lambda path: load_prior(name, path)), {".npz": "npz"},
    )  # fmt: skip


_EVENTS = "\n".join(
    [
        "a line of the log",
        json.dumps({"event": "progress", "stage": "solving", "done": 3, "total": 10, "eta_s": 4.5}),
        json.dumps({"event": "result", "motion": "m.npz", "report": "r.html", "seconds": 1.5, "frames": 10}),
        json.dumps({"event": "error", "code": "x", "message": "no", "where": "", "hint": ""}),
    ]
)

TARGETS: tuple[Target, ...] = (
    Target(
        "description of shots",
        (file("a.json", json.dumps(_SPEC)),),
        _read_spec,
        _JSON,
        odd_values.variants(_SPEC, odd_values.SHOTS),
    ),
    Target(
        "rig of a description",
        (_array("suit"),),
        _read_spec,
        {".json": "json", ".npz": "npz"},
        tuple(_array("suit", array) for array in odd_values.ARRAYS),
    ),
    Target("data set", (_data_set,), read_data_set, _JSON, _ODD_DATA_SETS, (nothing,)),
    Target("picture, PNG", _pictures(), lambda f: read_png(f / "a.png").shape, {".png": "png"}, _ODD_PNG, (nothing,)),
    Target("picture, Targa", (_targa,), lambda f: read_targa(f / "a.tga").shape, {".tga": "binary"}),
    Target(
        "scene of a shot",
        (_scene,),
        lambda f: read_scene(f / "a.npz"),
        {".npz": "npz"},
        (changed(_scene, faces=np.array([[0, 1, 99]], np.int32)), changed(_scene, rest=np.zeros((1, 3)))),
    ),
    Target(
        "map of a rig",
        tuple(file("a.json", path.read_bytes()) for path in _PRESETS),
        lambda f: read_map(f / "a.json"),
        _JSON,
        odd_values.variants(json.loads(_PRESETS[0].read_text(encoding="utf-8")), odd_values.MAPS),
    ),
    Target(
        "job of a batch",
        (file("a.json", json.dumps({"version": 1, "fps": 30.0, "trim": True, "settings": {"window": 20}})),),
        lambda f: BatchRequest(f, f / "out", f / "a.json").choices(),
        _JSON,
    ),
    Target("events of a child", (file("a.txt", _EVENTS),), _hear, {".txt": "text"}, odd_values.EVENTS),
    *(_prior(name) for name in ("vposer", "rvposer", "lie_vae")),
)
