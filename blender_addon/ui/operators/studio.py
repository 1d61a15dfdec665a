"""Operators of the studio: a data set made, and what the user's own array would reach."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from ..._exchange.errors import CommandLineInvalid, FileMissing
from ...conventions.file_paths import absolute, file_of, stored
from ...conventions.naming import counted, next_path
from ..acquisition_properties import OWN
from ..preferences import chosen_python
from ..project_files import files_folder, usable
from .base import MocapOperator, SolverOperator

if TYPE_CHECKING:
    from ..._exchange.studio_results import BenchmarkResult, DataSetPlan


class _Films(SolverOperator):
    """What the studio's operators that start its command line have in common."""

    is_of_capture = False

    def film(self, context: bpy.types.Context, description: Path, out: Path, options: list[str]) -> set[str]:
        """Start ``studio`` in a Blender of its own and follow it."""
        from ...headless.child_verb import start_verb

        python = chosen_python(context)
        given = [str(description), "--out", str(out), *options, *(["--python", str(python)] if python else [])]
        return self.follow(context, start_verb("studio", given, description.parent))


class MOCAP_OT_benchmark(_Films, bpy.types.Operator):
    """Films a person with the array, adds a detector's errors, solves, and compares with the truth."""

    bl_idname = "mocap.benchmark"
    bl_label = "Benchmark"
    bl_description = (
        "Film a synthetic person with these cameras, add a detector's errors, solve, and compare with the truth"
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        folder = next_folder(context.scene, "benchmark")
        description = benchmark_description(context)
        path = write_description(description, folder.with_suffix(".json"))
        methods = sorted(context.scene.mocap.studio.methods)
        self._faults = context.scene.mocap.studio.faults
        return self.film(context, path, folder, ["--benchmark", *methods, "--places"])

    def received(self, context: bpy.types.Context, result: BenchmarkResult) -> set[str]:
        """Add a row an array and show the first array's map on the floor."""
        from ...studio.places import read_places, rows_of

        settings = context.scene.mocap.studio
        file = result.get("places", "")
        places = read_places(Path(file))
        first, faults = len(settings.rows), self._faults
        for array, reached in rows_of(result["rows"], [item.array for item in places]):
            row = settings.rows.add()
            row.array, row.reached, row.faults = array, reached, faults
            median = next(item.median_mm for item in places if item.array == array)
            row.median_mm = -1.0 if median is None else median
            row.page, row.places = stored(result["page"]), stored(file)
        show_row(context, first)
        self.report({"INFO"}, f"{settings.rows[first].array}: {settings.rows[first].reached}")
        return {"FINISHED"}


class MOCAP_OT_check_data_set(_Films, bpy.types.Operator):
    """Reports what a data set would hold and need."""

    bl_idname = "mocap.check_data_set"
    bl_label = "Check"
    bl_description = "Check the settings, and report the number of pictures and the disk space"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        settings = context.scene.mocap.studio
        out = absolute(settings.out) if settings.out else next_folder(context.scene, "data_set")
        if settings.planned:  # nothing has changed: what a run has begun goes on
            out = file_of(settings.planned_out)
        description = next_folder(context.scene, "data_set").with_name("data_set.json")
        path = write_description(data_set_description(context), description)
        self._checked = stored(path), stored(out)
        return self.film(context, path, out, ["--plan"])

    def received(self, context: bpy.types.Context, result: DataSetPlan) -> set[str]:
        """Keep what was reported until a setting changes."""
        settings = context.scene.mocap.studio
        settings.planned = (
            f"{counted(len(result['shots']), 'shot')}, {counted(result['frames'], 'frame')}, "
            f"{counted(result['pictures'], 'picture')}: "
            f"about {_size(result['needed_mb'])}; {_size(result['free_mb'])} are free"
        )
        settings.planned_file, settings.planned_out = self._checked
        self.report({"INFO"}, settings.planned)
        return {"FINISHED"}


class MOCAP_OT_make_data_set(_Films, bpy.types.Operator):
    """Makes the data set that was checked."""

    bl_idname = "mocap.make_data_set"
    bl_label = "Make Data Set"
    bl_description = "Film all shots in a process of its own; a run that was cancelled goes on where it was"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs settings that were checked."""
        if not context.scene.mocap.studio.planned:
            cls.poll_message_set("Check the settings first")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start, or go on."""
        settings = context.scene.mocap.studio
        description, out = file_of(settings.planned_file), file_of(settings.planned_out)
        return self.film(context, description, out, [])

    def received(self, context: bpy.types.Context, result: DataSetPlan) -> set[str]:
        """Report where it is."""
        self.report({"INFO"}, f"{counted(len(result['shots']), 'shot')} in {result['data_set']}")
        return {"FINISHED"}


class MOCAP_OT_show_places(MocapOperator, bpy.types.Operator):
    """Shows an array's errors on the floor."""

    bl_idname = "mocap.show_places"
    bl_label = "Show on the Floor"
    bl_description = "Show the array's errors by place as coloured squares on the floor"

    index: bpy.props.IntProperty(name="Row", description="Of the table", default=0, min=0)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Show them."""
        show_row(context, min(self.index, len(context.scene.mocap.studio.rows) - 1))
        return {"FINISHED"}


class MOCAP_OT_open_benchmark(MocapOperator, bpy.types.Operator):
    """Opens a benchmark's page."""

    bl_idname = "mocap.open_benchmark"
    bl_label = "Open Page"
    bl_description = "Open the benchmark's page: table, errors over time and by place, worst frames"
    bl_options = {"REGISTER"}  # noqa: RUF012 - Blender reads a plain set

    index: bpy.props.IntProperty(name="Row", description="Of the table", default=0, min=0)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Open it in the system's browser."""
        page = _row(context, self.index)[0]
        if not page.is_file():
            raise FileMissing("The page no longer exists.", where=str(page), hint="Run the benchmark again.")
        return bpy.ops.wm.path_open(filepath=str(page))


class MOCAP_OT_clear_benchmarks(MocapOperator, bpy.types.Operator):
    """Empties the table of arrays."""

    bl_idname = "mocap.clear_benchmarks"
    bl_label = "Clear"
    bl_description = "Empty the table and remove the map from the floor; files stay"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Empty it."""
        from ...studio.places import remove_places

        context.scene.mocap.studio.rows.clear()
        remove_places(context.scene)
        return {"FINISHED"}


def show_row(context: bpy.types.Context, index: int) -> None:
    """Show the map of a row, in colours that all rows of its benchmark share.

    Raises:
        FileMissing, FileDamaged: its file is gone or damaged.
    """
    from ...studio.places import read_places, shared_limits, show_places

    array = context.scene.mocap.studio.rows[index].array
    maps = read_places(_row(context, index)[1])
    limits = shared_limits(maps)
    chosen = next((item for item in maps if item.array == array), None)
    if chosen is None:
        raise FileMissing("The benchmark has no map of this array.", where=array, hint="Run the benchmark again.")
    show_places(context.scene, chosen, limits)
    context.scene.mocap.studio.shown_mm = limits


def _row(context: bpy.types.Context, index: int) -> tuple[Path, Path]:
    rows = context.scene.mocap.studio.rows
    if not len(rows):
        raise FileMissing("Nothing has been benchmarked.", hint="Press Benchmark first.")
    row = rows[min(index, len(rows) - 1)]
    return file_of(row.page), file_of(row.places)


def _size(mebibytes: float) -> str:
    return f"{mebibytes / 1024:.1f} GiB" if mebibytes >= 1024 else f"{mebibytes:.0f} MiB"


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
    import json

    from ..._exchange.outputs import write_text

    return write_text(path, json.dumps(description, indent=1, ensure_ascii=False) + "\n", overwrite=True)


def next_folder(scene: bpy.types.Scene, name: str) -> Path:
    """Return the next numbered folder of the scene's files.

    Raises:
        OutputNotWritable: the folder of files cannot be written to.
    """
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
    """Return the array of the settings, as a description has it."""
    from ...studio.scene_file import array_of_scene
    from ..scene_job import capture_file

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
