"""The studio's description of a scene's settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy

from .._exchange.errors import CommandLineInvalid, FileMissing
from .._exchange.outputs import write_text
from ..animation.takes import take_file
from ..conventions.file_paths import absolute
from ..conventions.naming import next_path
from ..studio.scene_array import array_of_scene
from .locations import files_folder, usable
from .scene_job import capture_file
from .studio_properties import OWN

_BENCHMARK_FRAMES, _BENCHMARK_FPS = 90, 30
_FIXED = ("capture", "cameras")
_AS_IT_STANDS = {"name": "my cameras", "stand": "aim"}
_BENCHMARK_WIDTH = 400
"""Pixels of the widest picture of a benchmark; faults are millimetres at the person and do not know of it."""


def data_set_description(context: bpy.types.Context) -> dict[str, Any]:
    """Return what the panel's settings describe.

    Raises:
        CalibrationMissing: there are no cameras where there should be.
        TakeMissing, FileMissing: the capture, take or motion is gone.
        CommandLineInvalid: nothing is filmed.
    """
    settings = context.scene.mocap.studio
    if not settings.film:
        raise CommandLineInvalid("Nothing is filmed.", hint="Choose at least one kind of picture.")
    array = _array(context) | ({"scale": round(settings.scale, 4)} if settings.scale != 1.0 else {})
    return {
        "version": 1, "name": "data set", "seed": settings.seed, "fps": round(settings.fps, 4),
        "frames": settings.frames, "motions": [_motion(context)],
        "people": {"count": settings.people, "strange": settings.strange}, "camera_arrays": [array],
        "looks": [settings.look],
        "film": sorted(settings.film), "write": sorted(settings.write), "perturb": settings.faults,
        "rgb": {"engine": settings.engine},
    }  # fmt: skip


def benchmark_description(context: bpy.types.Context) -> dict[str, Any]:
    """Return what a benchmark films: one person, three seconds, the array and those it is compared with.

    Raises:
        CalibrationMissing: there are no cameras.
        TakeMissing: the capture is gone.
        CommandLineInvalid: the faults are of markers, or no method is chosen.
    """
    settings = context.scene.mocap.studio
    if settings.faults.endswith("_markers"):
        hint = "Choose Detector, Good Detector or Jitter under Faults."
        raise CommandLineInvalid("The faults are those of markers, which no cameras of ours measure.", hint=hint)
    if not settings.methods:
        raise CommandLineInvalid("No method is chosen.", hint="Choose at least one method.")
    own = _array(context)
    own = {"name": own.get("preset") or "ring", **own} if own.get("layout") not in _FIXED else {**own, **_AS_IT_STANDS}
    arrays = [own]
    if settings.fewer:
        arrays.append({**own, "name": f"{own['name']} less 1", "leave_out": 1})
    arrays += [{"preset": name} for name in sorted(settings.against) if own.get("preset") != name]
    return {
        "version": 1, "name": "benchmark", "seed": settings.seed, "fps": _BENCHMARK_FPS, "frames": _BENCHMARK_FRAMES,
        "motions": ["choreography"], "camera_arrays": [{**array, "widest": _BENCHMARK_WIDTH} for array in arrays],
        "looks": ["everyday"], "film": ["infrared"], "perturb": settings.faults,
    }  # fmt: skip


def write_description(description: dict[str, Any], path: Path) -> Path:
    """Write a description beside its data set and return its path.

    Raises:
        OutputNotWritable: see ``write_text``.
    """
    return write_text(path, json.dumps(description, indent=1, ensure_ascii=False) + "\n", overwrite=True)


def next_folder(scene: bpy.types.Scene, name: str) -> Path:
    """Return the next numbered folder of the scene's files.

    Raises:
        OutputNotWritable: the folder of files cannot be written to.
    """
    return next_path(usable(files_folder(scene) / "studio"), name)


def _motion(context: bpy.types.Context) -> str:
    settings = context.scene.mocap.studio
    if settings.motion == "CHOREOGRAPHY":
        return "choreography"
    if settings.motion == "FILE":
        if not settings.motion_path:
            raise FileMissing("No motion is chosen.", hint="Choose a file or a folder, or the choreography.")
        return str(absolute(settings.motion_path))
    take = context.scene.mocap.review.take
    if take is None:
        raise FileMissing("There is no solved take.", hint="Solve a capture first, or choose another motion.")
    return str(take_file(take, "motion_file"))


def _array(context: bpy.types.Context) -> dict[str, Any]:
    """Return the array of the settings, as a description has it."""
    settings, capture = context.scene.mocap.studio, context.scene.mocap.capture
    if settings.array == OWN and capture.file and len(capture.cameras):
        return {"layout": "capture", "capture": str(capture_file(capture))}
    if settings.array in (OWN, "SCENE"):
        return array_of_scene(context.scene, context.evaluated_depsgraph_get())
    if settings.array == "RING":
        return {
            "layout": "ring", "name": "ring", "count": settings.count, "radius_m": round(settings.radius_m, 4),
            "height_m": round(settings.height_m, 4),
        }  # fmt: skip
    return {"preset": settings.array}
