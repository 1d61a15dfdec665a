"""Readers of the studio's data sets, of rigs' maps, and of what the add-on's child processes say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from blender_addon.headless.batch.request import BatchRequest
from blender_addon.render.picture import read_targa
from blender_addon.retarget.maps import presets
from blender_addon.retarget.maps.rig_map import read_map
from blender_addon.solving.child import event_in
from blender_addon.solving.run import Run
from blender_addon.studio.scene_file import FORMAT as SCENE
from blender_addon.studio.scene_file import read_scene
from solver_backend.io.png import png_bytes, read_png
from solver_backend.priors.catalogue import load_prior
from solver_backend.studio.data_set import DESCRIPTION, SHOTS, read_data_set
from solver_backend.studio.make_shot import DONE
from solver_backend.studio.spec import read_spec
from tests.fuzz.motion_targets import read_as_if_whole
from tests.fuzz.target import Target, Write, file
from tests.support.random_weights import write_random

_JSON = {".json": "json"}
_SPEC: dict[str, Any] = {
    "version": 1, "name": "small", "seed": 3, "fps": 30, "frames": 4, "motions": ["choreography"],
    "people": {"count": 2, "sigma": 0.5, "strange": True},
    "rigs": ["azure_kinect_3", {"preset": "azure_kinect_3", "name": "again"}], "looks": ["suit"],
    "film": ["infrared", "depth", "rgb"], "write": ["coco", "c3d"], "markers": "MANIFOLD_53", "joint_set": "BODY_25",
    "perturb": "none", "rgb": {"engine": "workbench", "samples": 2, "noise": 0.01},
}  # fmt: skip
_PRESETS = sorted((Path(presets.__file__).parent / "presets").glob("*.json"))


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
        lambda f: read_as_if_whole(f, lambda path: load_prior(name, path)), {".npz": "npz"}, 2,
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
    Target("description of shots", (file("a.json", json.dumps(_SPEC)),), lambda f: read_spec(f / "a.json"), _JSON, 6),
    Target("data set", (_data_set,), read_data_set, _JSON, 6),
    Target("picture, PNG", _pictures(), lambda f: read_png(f / "a.png").shape, {".png": "binary"}, 20),
    Target("picture, Targa", (_targa,), lambda f: read_targa(f / "a.tga").shape, {".tga": "binary"}, 10),
    Target("scene of a shot", (_scene,), lambda f: read_scene(f / "a.npz"), {".npz": "npz"}, 12),
    Target(
        "map of a rig",
        tuple(file("a.json", path.read_bytes()) for path in _PRESETS),
        lambda f: read_map(f / "a.json"),
        _JSON,
        20,
    ),
    Target(
        "job of a batch",
        (file("a.json", json.dumps({"version": 1, "fps": 30.0, "trim": True, "settings": {"window": 20}})),),
        lambda f: BatchRequest(f, f / "out", f / "a.json").choices(),
        _JSON,
        20,
    ),
    Target("events of a child", (file("a.txt", _EVENTS),), _hear, {".txt": "text"}, 20),
    *(_prior(name) for name in ("vposer", "rvposer", "lie_vae")),
)
