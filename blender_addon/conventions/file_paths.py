"""Store paths relative to the .blend file (``//``), so that a project folder can be moved."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from .._exchange.errors import MocapError

BESIDE = "mocap"  # Folder for captures and takes next to a saved .blend file.
_MOVED = "moved.json"


def absolute(text: str, library: bpy.types.Library | None = None) -> Path:
    """Return the absolute path that a path property of this file or of a linked library refers to."""
    return Path(os.path.normpath(bpy.path.abspath(text, library=library))) if text else Path()


def stored(path: Path | str, start: Path | None = None) -> str:
    """Return a path relative to ``start`` or to the .blend file, or the absolute path if that is impossible."""
    if start is None and bpy.data.filepath:
        start = Path(bpy.data.filepath).parent
    if not str(path) or start is None:
        return str(path)
    try:
        return "//" + Path(os.path.relpath(path, start)).as_posix()
    except ValueError:  # the path is on another drive
        return str(path)


def file_of(text: str, library: bpy.types.Library | None = None) -> Path:
    """Return the file that a path property names, or its new location if the file was moved.

    Files of an unsaved scene move when the scene is saved, and undo does not revert this. Older versions stored
    absolute paths. If such a file is missing, its new location is searched for next to the .blend file.
    """
    path = absolute(text, library)
    if not text or path.exists():
        return path
    moved = [Path(text) for text in (moved_files().get(str(path)),) if text]
    if bpy.data.filepath and BESIDE in path.parts:
        tail = path.parts[len(path.parts) - path.parts[::-1].index(BESIDE) :]
        moved.append(Path(bpy.data.filepath).parent.joinpath(BESIDE, *tail))
    return next((candidate for candidate in moved if candidate.exists()), path)


def sessions_folder() -> Path:
    """Return the user's folder for the files of unsaved scenes."""
    documents = Path.home() / "Documents"
    return (documents if documents.is_dir() else Path.home()) / "Manifold MoCap"


def moved_files() -> dict[str, str]:
    """Return the new path of each moved file of an unsaved scene, keyed by its old path."""
    try:
        from .._exchange.json_file import read_json_file

        kept = read_json_file(sessions_folder() / _MOVED)
    except MocapError:
        return {}
    pairs = kept.items() if isinstance(kept, dict) else ()
    return {old: new for old, new in pairs if isinstance(new, str)}


def note_moved(files: dict[Path, Path]) -> None:
    """Record the new paths of an unsaved scene's files. Raise ``OutputNotWritable`` if that fails."""
    import json

    from .._exchange.outputs import write_text

    known = moved_files() | {str(old): str(new) for old, new in files.items()}
    write_text(sessions_folder() / _MOVED, json.dumps(known, indent=1, ensure_ascii=False), overwrite=True)
