"""Store paths relative to the .blend file (``//``), so that a project folder can be moved."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from .._exchange.errors import MocapError

BESIDE = "mocap"  # Folder of captures and takes next to a saved .blend file.
_MOVED = "moved.json"


def absolute(text: str, library: bpy.types.Library | None = None) -> Path:
    """Return the absolute path of a path property, in this file or in a linked library."""
    return Path(os.path.normpath(bpy.path.abspath(text, library=library))) if text else Path()


def stored(path: Path | str, start: Path | None = None) -> str:
    """Return a path relative to ``start`` or the .blend file, or the full path."""
    if start is None and bpy.data.filepath:
        start = Path(bpy.data.filepath).parent
    if not str(path) or start is None:
        return str(path)
    try:
        return "//" + Path(os.path.relpath(path, start)).as_posix()
    except ValueError:  # another drive
        return str(path)


def file_of(text: str, library: bpy.types.Library | None = None) -> Path:
    """Return the file of a path property, or its new location if it was moved.

    Files of an unsaved scene are moved when the scene is saved, which undo does not revert. Files that older versions
    stored with their full path may have moved with their project folder.
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
    """Return the user's folder for files of unsaved scenes."""
    documents = Path.home() / "Documents"
    return (documents if documents.is_dir() else Path.home()) / "Manifold MoCap"


def moved_files() -> dict[str, str]:
    """Return the new path of each moved file of an unsaved scene, by its old path."""
    try:
        from .._exchange.json_file import read_json_file

        kept = read_json_file(sessions_folder() / _MOVED)
    except MocapError:
        return {}
    pairs = kept.items() if isinstance(kept, dict) else ()
    return {old: new for old, new in pairs if isinstance(new, str)}


def note_moved(files: dict[Path, Path]) -> None:
    """Record the new paths of an unsaved scene's files. Raise ``OutputNotWritable``."""
    import json

    from .._exchange.outputs import write_text

    known = moved_files() | {str(old): str(new) for old, new in files.items()}
    write_text(sessions_folder() / _MOVED, json.dumps(known, indent=1, ensure_ascii=False), overwrite=True)
