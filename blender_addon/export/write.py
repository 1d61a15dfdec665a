"""Export a take to any of the formats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress, silent
from ..errors import NothingToExport
from .formats import FORMATS, FileLayout, Format
from .take import ExportTake


def export_take(
    take: ExportTake, format_name: str, path: Path, *, overwrite: bool = False, progress: Progress = silent
) -> Path:
    """Write a take to a file. The file is complete or is not written. The suffix must match the format."""
    chosen = format_of(format_name)
    if path.suffix.lower() != chosen.suffix:
        hint = f"Try {path.stem}{chosen.suffix}."
        raise NothingToExport(f"The name of this file must end in {chosen.suffix}.", where=path.name, hint=hint)
    layout = FileLayout(**{name: getattr(take.layout, name) for name in chosen.keeps})
    take, stage = replace(take, layout=layout), f"exporting {chosen.label}"
    progress(stage, 0, 1)
    with atomic_outputs(path.parent, (path.name,), overwrite=overwrite) as temporary:
        writer_of(chosen)(temporary[path.name], take, progress)
    progress(stage, 1, 1)
    return path


def writer_of(chosen: Format) -> Callable[[Path, ExportTake, Progress], None]:
    """Return the function that writes takes in this format."""
    module, _, function = chosen.writer.partition(".")
    return getattr(import_module(f".writers.{module}", __package__), function)


def format_of(name: str) -> Format:
    """Return a format by its name. Raises ``NothingToExport`` for an unknown name."""
    if name not in FORMATS:
        raise NothingToExport(f"There is no format '{name}'.", hint=f"Known formats: {', '.join(FORMATS)}.")
    return FORMATS[name]


def file_names(stem: str, formats: Sequence[str]) -> dict[str, str]:
    """Return the file name for each format. Names differ even if formats share a suffix."""
    found: dict[str, str] = {}
    for name in formats:
        suffix = format_of(name).suffix
        plain = f"{stem}{suffix}"
        found[name] = f"{stem}_{name}{suffix}" if plain in found.values() else plain
    return found
