"""The table of formats, and the one way to export to any of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import NothingToExport
from ..outputs import atomic_outputs
from ..progress import Progress, silent
from .alembic import export_alembic
from .amass import export_amass
from .bvh import export_bvh
from .fbx import export_fbx
from .gltf import export_gltf
from .joint_tables import export_csv, export_trc
from .take import ExportTake
from .usd import export_usd


@dataclass(frozen=True)
class Format:
    """One way to write a take."""

    suffix: str
    """Of the file, with its dot."""
    label: str
    """For people."""
    description: str
    """What the file holds."""
    write: Callable[[Path, ExportTake, Progress], None]
    """Writes a take to a path."""


FORMATS: dict[str, Format] = {
    "bvh": Format(".bvh", "BVH", "Skeleton and rotations; centimetres, Y up", export_bvh),
    "fbx": Format(".fbx", "FBX", "Skeleton, skinned mesh and motion; Y up", export_fbx),
    "gltf": Format(".glb", "glTF", "Skeleton, skinned mesh and motion; metres, Y up", export_gltf),
    "usd": Format(".usdc", "USD", "Skeleton, skinned mesh and motion; metres, Z up", export_usd),
    "alembic": Format(".abc", "Alembic", "Vertices of every frame; metres, Y up", export_alembic),
    "amass": Format(".npz", "AMASS", "Pose and shape parameters of an SMPL-type body; Z up", export_amass),
    "trc": Format(".trc", "TRC", "Joint positions for OpenSim; millimetres, Y up", export_trc),
    "csv": Format(".csv", "CSV", "Joint positions as a table; metres, Z up", export_csv),
}
"""By the names that settings and command lines use."""


def export_take(
    take: ExportTake, format_name: str, path: Path, *, overwrite: bool = False, progress: Progress = silent
) -> Path:
    """Write a take to a file, whole or not at all.

    Args:
        take: the take.
        format_name: key of ``FORMATS``.
        path: the file; a suffix that is not the format's is an error.
        overwrite: replace a file that is there.
        progress: told how far it is.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_outputs``.
        NothingToExport, ExporterMissing, ExportFailed: see the formats.
    """
    chosen = format_of(format_name)
    if path.suffix.lower() != chosen.suffix:
        raise NothingToExport(
            f"A file of {chosen.label} ends in {chosen.suffix}.",
            where=path.name,
            hint=f"Try {path.stem}{chosen.suffix}.",
        )
    with atomic_outputs(path.parent, (path.name,), overwrite=overwrite) as temporary:
        chosen.write(temporary[path.name], take, progress)
    return path


def format_of(name: str) -> Format:
    """Return a format by its name.

    Raises:
        NothingToExport: there is none of that name.
    """
    if name not in FORMATS:
        raise NothingToExport(f"There is no format '{name}'.", hint=f"Known formats: {', '.join(FORMATS)}.")
    return FORMATS[name]
