"""Operators of the studio, which makes data sets with ground truth and predicts a camera array's accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from ..._exchange.errors import CommandLineInvalid, FileMissing
from ..._exchange.outputs import write_text
from ...conventions.file_paths import absolute, file_of, stored
from ...conventions.naming import counted, next_path
from ..acquisition_properties import FAULTS, OWN
from ..project_files import files_folder, usable
from .base import OPENS, Call, Need, Steps, operator

if TYPE_CHECKING:
    from ..._exchange.verb_results import BenchmarkResult, DataSetPlan

_BENCHMARK_FRAMES, _BENCHMARK_FPS = 90, 30
_FIXED = ("capture", "cameras")
_AS_IT_STANDS = {"name": "my cameras", "stand": "aim"}
_BENCHMARK_WIDTH = 400
"""Width of the widest benchmark image in pixels. Simulated errors are in millimetres and do not depend on it."""


def _film(description: Path, out: Path, *more: str) -> Call:
    words = [str(description), "--out", str(out), *more]
    return Call("dataset make", words, description.parent, through_blender=True, of_capture=False)


@operator("Benchmark")
def benchmark(self: Any, context: bpy.types.Context) -> Steps:
    """Simulate a take with these cameras and detector errors, solve it, and compare it with the ground truth."""
    from ...studio.places import read_places, rows_of

    settings = context.scene.mocap.studio
    folder = _next_folder(context.scene, "benchmark")
    path = _write_description(benchmark_description(context), folder.with_suffix(".json"))
    faults = next(label for value, label, _ in FAULTS if value == settings.faults)
    more = "--benchmark", *sorted(settings.methods), "--places"
    result: BenchmarkResult = yield _film(path, folder, *more)
    settings, file = context.scene.mocap.studio, result.get("places", "")
    places, first = read_places(Path(file)), len(settings.rows)
    for array, reached in rows_of(result["rows"], [item.array for item in places]):
        row = settings.rows.add()
        row.array, row.reached, row.faults = array, reached, faults
        median = next(item.median_mm for item in places if item.array == array)
        row.median_mm = -1.0 if median is None else median
        row.page, row.places = stored(result["page"]), stored(file)
    _show_row(context, first)
    return f"{settings.rows[first].array}: {settings.rows[first].reached}"


@operator("Check Data Set")
def check_data_set(self: Any, context: bpy.types.Context) -> Steps:
    """Check the settings, and report the number of images and the required disk space."""
    settings = context.scene.mocap.studio
    out = absolute(settings.out) if settings.out else _next_folder(context.scene, "data_set")
    if settings.planned:  # nothing has changed since, so an unfinished run can continue
        out = file_of(settings.planned_out)
    description = _next_folder(context.scene, "data_set").with_name("data_set.json")
    path = _write_description(data_set_description(context), description)
    result: DataSetPlan = yield _film(path, out, "--plan")
    settings = context.scene.mocap.studio
    images = f"{counted(len(result['shots']), 'shot')}, {counted(result['frames'], 'frame')}"
    images += f", {counted(result['pictures'], 'image')}"
    settings.planned = f"{images}: about {_size(result['needed_mb'])}; {_size(result['free_mb'])} are free"
    settings.planned_file, settings.planned_out = stored(path), stored(out)
    return settings.planned


@operator("Make Data Set", Need("Check the settings first", lambda context: context.scene.mocap.studio.planned))
def make_data_set(self: Any, context: bpy.types.Context) -> Steps:
    """Film all shots without blocking Blender, or continue a cancelled run."""
    settings = context.scene.mocap.studio
    result: DataSetPlan = yield _film(file_of(settings.planned_file), file_of(settings.planned_out))
    return f"{counted(len(result['shots']), 'shot')} in {result['data_set']}"


@operator("Show on the Floor", index=int)
def show_places(self: Any, context: bpy.types.Context) -> None:
    """Show the array's error at each floor position as a coloured square."""
    _show_row(context, min(self.index, len(context.scene.mocap.studio.rows) - 1))


@operator("Open Page", options=OPENS, index=int)
def open_benchmark(self: Any, context: bpy.types.Context) -> set[str]:
    """Open the benchmark page with its table, errors by time and position, and worst frames."""
    page = _row(context, self.index)[0]
    if not page.is_file():
        raise FileMissing("The page no longer exists.", where=str(page), hint="Run the benchmark again.")
    return bpy.ops.wm.path_open(filepath=str(page))


@operator("Clear Benchmarks")
def clear_benchmarks(self: Any, context: bpy.types.Context) -> None:
    """Clear the table and the map on the floor, and keep the files."""
    from ...studio.places import remove_places

    context.scene.mocap.studio.rows.clear()
    remove_places(context.scene)


def _show_row(context: bpy.types.Context, index: int) -> None:
    from ...studio.places import read_places, shared_limits, show_places

    maps = read_places(_row(context, index)[1])
    array = context.scene.mocap.studio.rows[index].array
    limits = shared_limits(maps)
    chosen = next((item for item in maps if item.array == array), None)
    if chosen is None:
        raise FileMissing("The benchmark has no map of this array.", where=array, hint="Run the benchmark again.")
    show_places(context.scene, chosen, limits)
    context.scene.mocap.studio.shown_mm = limits


def _row(context: bpy.types.Context, index: int) -> tuple[Path, Path]:
    rows = context.scene.mocap.studio.rows
    if not len(rows):
        raise FileMissing("There is no benchmark yet.", hint="Press Benchmark first.")
    row = rows[min(index, len(rows) - 1)]
    return file_of(row.page), file_of(row.places)


def _size(mebibytes: float) -> str:
    return f"{mebibytes / 1024:.1f} GiB" if mebibytes >= 1024 else f"{mebibytes:.0f} MiB"


def data_set_description(context: bpy.types.Context) -> dict[str, Any]:
    """Return the panel's data set settings as a dict for the data set's JSON file."""
    settings = context.scene.mocap.studio
    if not settings.film:
        raise CommandLineInvalid("No kind of image is selected.", hint="Choose at least one kind of image.")
    scale = {"scale": round(settings.scale, 4)} if settings.scale != 1.0 else {}
    return {
        "version": 1,
        "name": "data set",
        "seed": settings.seed,
        "fps": round(settings.fps, 4),
        "frames": settings.frames,
        "motions": [_motion(context)],
        "people": {"count": settings.people, "strange": settings.strange},
        "camera_arrays": [_array(context) | scale],
        "looks": [settings.look],
        "film": sorted(settings.film),
        "write": sorted(settings.write),
        "perturb": settings.faults,
        "rgb": {"engine": settings.engine},
    }


def benchmark_description(context: bpy.types.Context) -> dict[str, Any]:
    """Return the benchmark's JSON settings: one person for three seconds, and the camera arrays."""
    settings = context.scene.mocap.studio
    if settings.faults.endswith("_markers"):
        hint = "Choose Detector, Good Detector or Jitter under Faults."
        raise CommandLineInvalid("These errors are for markers, but the simulated cameras record keypoints.", hint=hint)
    if not settings.methods:
        raise CommandLineInvalid("No method is chosen.", hint="Choose at least one method.")
    own = _array(context)
    own = {"name": own.get("preset") or "ring", **own} if own.get("layout") not in _FIXED else {**own, **_AS_IT_STANDS}
    arrays = [own]
    if settings.fewer:
        arrays.append({**own, "name": f"{own['name']} less 1", "leave_out": 1})
    arrays += [{"preset": name} for name in sorted(settings.against) if own.get("preset") != name]
    return {
        "version": 1,
        "name": "benchmark",
        "seed": settings.seed,
        "fps": _BENCHMARK_FPS,
        "frames": _BENCHMARK_FRAMES,
        "motions": ["choreography"],
        "camera_arrays": [{**array, "widest": _BENCHMARK_WIDTH} for array in arrays],
        "looks": ["everyday"],
        "film": ["infrared"],
        "perturb": settings.faults,
    }


def _write_description(description: dict[str, Any], path: Path) -> Path:
    import json

    return write_text(path, json.dumps(description, indent=1, ensure_ascii=False) + "\n", overwrite=True)


def _next_folder(scene: bpy.types.Scene, name: str) -> Path:
    return next_path(usable(files_folder(scene) / "studio"), name)


def _motion(context: bpy.types.Context) -> str:
    from ...animation.takes import take_file

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
    from ...studio.scene_file import array_of_scene
    from ..scene_job import capture_file

    settings, capture = context.scene.mocap.studio, context.scene.mocap.capture
    if settings.array == OWN and capture.file and len(capture.cameras):
        return {"layout": "capture", "capture": str(capture_file(capture))}
    if settings.array in (OWN, "SCENE"):
        return array_of_scene(context.scene, context.evaluated_depsgraph_get())
    if settings.array == "RING":
        radius, height = round(settings.radius_m, 4), round(settings.height_m, 4)
        return {"layout": "ring", "name": "ring", "count": settings.count, "radius_m": radius, "height_m": height}
    return {"preset": settings.array}
