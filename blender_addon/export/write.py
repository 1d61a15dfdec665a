"""The one way to export a take to any of the formats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress, silent
from ..errors import NothingToExport
from .formats import FORMATS, FileLayout, Format
from .take import ExportTake
from .writers.alembic import export_alembic
from .writers.amass import export_amass, export_amass_x
from .writers.blend import export_blend
from .writers.blender_exporters import export_fbx, export_gltf, export_usd
from .writers.joint_tables import export_bvh, export_csv, export_trc

WRITERS: dict[str, Callable[[Path, ExportTake, Progress], None]] = {
    "bvh": export_bvh, "fbx": export_fbx, "gltf": export_gltf, "usd": export_usd, "alembic": export_alembic,
    "amass": export_amass, "amass-x": export_amass_x, "blend": export_blend, "trc": export_trc, "csv": export_csv,
}  # fmt: skip
"""Writers of a take to a path, by the formats' names."""


def export_take(
    take: ExportTake, format_name: str, path: Path, *, overwrite: bool = False, progress: Progress = silent
) -> Path:
    """Write a take to a file, complete or not at all.

    Args:
        format_name: key of ``FORMATS``.
        path: the file. A suffix that is not the format's is an error.
        overwrite: replace a file that is there.
    """
    chosen = format_of(format_name)
    if path.suffix.lower() != chosen.suffix:
        hint = f"Try {path.stem}{chosen.suffix}."
        raise NothingToExport(f"A file of {chosen.label} ends in {chosen.suffix}.", where=path.name, hint=hint)
    layout = FileLayout(**{name: getattr(take.layout, name) for name in chosen.keeps})
    take = replace(take, layout=layout)
    with atomic_outputs(path.parent, (path.name,), overwrite=overwrite) as temporary:
        WRITERS[format_name](temporary[path.name], take, progress)
    return path


def format_of(name: str) -> Format:
    """Return a format by its name. Raises ``NothingToExport`` if there is none of that name."""
    if name not in FORMATS:
        raise NothingToExport(f"There is no format '{name}'.", hint=f"Known formats: {', '.join(FORMATS)}.")
    return FORMATS[name]


def file_names(stem: str, formats: Sequence[str]) -> dict[str, str]:
    """Return the file's name of each format. Of several with one suffix the later ones carry their format's name."""
    found: dict[str, str] = {}
    for name in formats:
        suffix = format_of(name).suffix
        plain = f"{stem}{suffix}"
        found[name] = f"{stem}_{name}{suffix}" if plain in found.values() else plain
    return found
