"""Store paths relative to the .blend file (``//``), so that a project's folder may move."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from .._exchange.errors import MocapError

BESIDE = "mocap"  # Folder of captures and takes next to a saved .blend file.
_MOVED = "moved.json"


def absolute(text: str, library: bpy.types.Library | None = None) -> Path:
    """Return the path that a property means, of this file or of a library's."""
    return Path(os.path.normpath(bpy.path.abspath(text, library=library))) if text else Path()


def stored(path: Path | str, start: Path | None = None) -> str:
    """Return a path relative to a folder (None for the .blend file's), in full without one or on another drive."""
    if start is None and bpy.data.filepath:
        start = Path(bpy.data.filepath).parent
    if not str(path) or start is None:
        return str(path)
    try:
        return "//" + Path(os.path.relpath(path, start)).as_posix()
    except ValueError:  # another drive
        return str(path)


def file_of(text: str, library: bpy.types.Library | None = None) -> Path:
    """Return the file of a property, or its new place if it was moved.

    A file of an unsaved scene moved when the scene was saved, which undo does not know. Files that older versions
    kept by their full path moved with their project's folder.
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
    """Return the user's folder for files of unsaved scenes. The extension's own may be deleted."""
    documents = Path.home() / "Documents"
    return (documents if documents.is_dir() else Path.home()) / "Manifold MoCap"


def moved_files() -> dict[str, str]:
    """Return the new paths of files of unsaved scenes, by their old paths."""
    try:
        from .._exchange.json_file import read_json_file

        kept = read_json_file(sessions_folder() / _MOVED)
    except MocapError:
        return {}
    pairs = kept.items() if isinstance(kept, dict) else ()
    return {old: new for old, new in pairs if isinstance(new, str)}


def note_moved(files: dict[Path, Path]) -> None:
    """Record the new paths of files of an unsaved scene. Raises ``OutputNotWritable`` if it cannot be written down."""
    import json

    from .._exchange.outputs import write_text

    known = moved_files() | {str(old): str(new) for old, new in files.items()}
    write_text(sessions_folder() / _MOVED, json.dumps(known, indent=1, ensure_ascii=False), overwrite=True)
