"""``export``: a motion file, or the takes of a Blender file, to files of other formats."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .._exchange.diagnostics import DiagnosticValues, sentence
from .._exchange.errors import FileDamaged, FileMissing, OutputExists
from .._exchange.motion_file import read_motion
from .._exchange.progress import Progress
from ..body.body_choice import body_path_of
from ..body.body_file import read_body
from ..errors import NothingToExport
from .result import TimedResult

if TYPE_CHECKING:
    import bpy


@dataclass(frozen=True)
class ExportRequest:
    """What to export."""

    source: Path
    """Motion file or Blender file; neither is changed."""
    out: Path
    """Folder of the files."""
    formats: tuple[str, ...]
    """Keys of ``export.formats.FORMATS``."""
    body: Path | None = None
    """Body file for a motion; None for the one the motion was solved for."""
    armature: str = ""
    """Which armature of a Blender file; needed where there are several."""
    fps: float | None = None
    """Frames per second of the files; None for those the take was solved at."""
    overwrite: bool = False
    """Replace files that are there."""
    look: str = ""
    """One of ``conventions.looks``; "" for the file's own, and for a person of a motion."""


class ExportResult(TimedResult):
    """Of ``export``."""

    diagnostics: list[DiagnosticValues]


def run_export(request: ExportRequest, progress: Progress) -> ExportResult:
    """Write one file a format, named as the take is.

    Returns:
        The ``result`` event: outputs, frames, frames per second, and the warnings of the take's solve.

    Raises:
        MocapError: the source is missing or wrong, a file is there already, or an exporter fails.
    """
    from ..body.looks import show_look
    from ..body.shape import body_mesh
    from ..export.take import take_of
    from ..export.write import export_take, file_names

    names = file_names(request.source.stem, request.formats)
    if not request.source.is_file():
        raise FileMissing("There is no such file.", where=str(request.source), hint="Check the path.")
    paths = {name: request.out / file_name for name, file_name in names.items()}
    _check_free(request, list(paths.values()))
    is_blend = request.source.suffix.lower() == ".blend"
    scene, armature = _open(request) if is_blend else _baked(request, progress)
    if request.look and (mesh := body_mesh(armature)) is not None:
        show_look(mesh, request.look)
    take = take_of(scene, armature, fps=request.fps)
    for name, path in paths.items():
        export_take(take, name, path, overwrite=request.overwrite, progress=progress)
    outputs = [str(path) for path in paths.values()]
    return {
        "event": "result", "outputs": outputs, "frames": take.num_frames, "fps": take.fps,
        "notes": [sentence(item, take.fps) for item in take.warnings],
        "diagnostics": [item.as_dict() for item in take.warnings],
    }  # fmt: skip


def _check_free(request: ExportRequest, paths: list[Path]) -> None:
    """Refuse to start where a file would be overwritten, among them the source itself."""
    existing = [path.name for path in paths if path.exists() and not request.overwrite]
    existing += [path.name for path in paths if path.exists() and path.samefile(request.source)]
    if existing:
        raise OutputExists(
            f"{', '.join(dict.fromkeys(existing))} would be overwritten.",
            where=str(request.out),
            hint="Choose another folder, or allow overwriting (--overwrite).",
        )


def _baked(request: ExportRequest, progress: Progress) -> tuple[bpy.types.Scene, bpy.types.Object]:
    from ..scene.bake import BakeSettings, bake_take
    from ..scene.session import fresh_scene

    motion = read_motion(request.source)
    body = read_body(request.body or body_path_of(motion.provenance), motion.body_layout)
    scene = fresh_scene()
    progress("baking", 0, 1)
    take = bake_take(scene, motion, body, settings=BakeSettings(floor=False))
    progress("baking", 1, 1)
    return scene, take.armature


def _open(request: ExportRequest) -> tuple[bpy.types.Scene, bpy.types.Object]:
    import bpy

    try:
        bpy.ops.wm.open_mainfile(filepath=str(request.source.resolve()), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise FileDamaged(f"Blender cannot open the file: {str(error).strip()}", where=str(request.source)) from error
    scene = bpy.context.scene
    found = {o.name: o for o in scene.objects if o.type == "ARMATURE" and o.animation_data is not None}
    chosen = [request.armature] if request.armature else list(found)
    if len(chosen) != 1 or chosen[0] not in found:
        raise NothingToExport(
            f"There is no animated armature '{request.armature}'."
            if request.armature
            else "Exactly one animated armature is needed.",
            where=str(request.source),
            hint=f"Name one with --armature: {', '.join(found) or 'the file has none'}.",
        )
    return scene, found[chosen[0]]
