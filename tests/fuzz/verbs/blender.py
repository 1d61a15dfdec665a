"""Verbs that need Blender's module, all of them in this process."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from blender_addon._exchange.progress import silent
from blender_addon.headless.process import own_streams
from blender_addon.headless.verb_table import VERBS
from tests.fuzz.target import Target
from tests.fuzz.verbs.motions import write_clip
from tests.fuzz.verbs.running import nothing_left, verb_target
from tests.fuzz.verbs.views import write_solved

_NPZ = {".npz": "npz"}
Run = Callable[[Path], object]


def _quietly(run: Run) -> Run:
    """Return the same with what Blender prints left out, and with its files taken away."""

    def run_quietly(folder: Path) -> object:
        with nothing_left(folder), own_streams(verbose=False):
            return run(folder)

    return run_quietly


def _bake(folder: Path) -> object:
    from blender_addon.headless.bake import run_bake

    files = {"motion": folder / "motion.npz", "out": folder, "capture": folder / "capture.npz"}
    return run_bake(VERBS["bake"].arguments(**files, no_pictures=True), silent)


def _export(*formats: str) -> Run:
    def run(folder: Path) -> object:
        from blender_addon.headless.export import run_export

        args = VERBS["export"].arguments(source=folder / "motion.npz", out=folder / "out", formats=formats)
        return run_export(args, silent)

    return run


def _rig(folder: Path) -> None:
    """Write a character, its map, a motion and a clip."""
    import bpy

    from blender_addon.scene.session import fresh_scene
    from tests.support.mixamo_rig import mixamo_rig

    write_solved(folder)
    write_clip(folder)
    with own_streams(verbose=False):
        fresh_scene()
        mixamo_rig("Hero")
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "hero.blend"))
        _retarget("motion.npz", save_map="map.json")(folder)
    (folder / "out.blend").unlink()


def _retarget(source: str, **files: str) -> Run:
    """Return what retargets a motion; other files are options with names in the folder."""

    def run(folder: Path) -> object:
        from blender_addon.headless.retarget import run_retarget

        given: dict[str, Any] = {name: folder / path for name, path in files.items()}
        given |= {"source": folder / source, "target": [folder / "hero.blend"], "out": folder / "out.blend"}
        return run_retarget(VERBS["retarget"].arguments(**given), silent)

    return run


TARGETS: tuple[Target, ...] = (
    verb_target("bake", (write_solved,), _quietly(_bake), _NPZ),
    verb_target("export", (write_solved,), _quietly(_export("bvh", "csv", "amass")), _NPZ),
    verb_target("export, meshes", (write_solved,), _quietly(_export("fbx", "gltf")), _NPZ),
    verb_target("retarget", (_rig,), _quietly(_retarget("motion.npz")), _NPZ),
    verb_target("retarget, map", (_rig,), _quietly(_retarget("motion.npz", map="map.json")), {".json": "json"}),
    verb_target("retarget, clip", (_rig,), _quietly(_retarget("clip.bvh")), {".bvh": "text"}),
) if find_spec("bpy") else ()  # fmt: skip
