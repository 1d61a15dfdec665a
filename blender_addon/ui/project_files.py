"""Keep captures and takes next to their .blend file, under relative paths.

Files are copied before the .blend file is written. After it has been written, the originals in an unsaved scene's
session folder are removed, but never a file that another .blend file uses. If writing fails, paths are restored and
copies are removed. After *Save Copy* only the paths are restored, because the new paths are valid in the copy.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from itertools import chain, count, islice, takewhile
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .._exchange.errors import MocapError, OutputNotWritable
from .._exchange.outputs import probe
from ..conventions.file_paths import BESIDE, absolute, file_of, note_moved, sessions_folder, stored

RELATIVE = (
    {"PATH_SUPPORTS_BLEND_RELATIVE"}
    if "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
    else set()
)
"""Option that allows ``//`` in path properties. Before Blender 4.5 all path properties allow it."""


def files_folder(scene: bpy.types.Scene) -> Path:
    """Return the folder for captures and takes. Create it if needed.

    It is the folder chosen in the scene's settings, or else ``mocap`` in the folder of the .blend file. An unsaved file
    uses a session folder in the user's directory until it is saved.
    """
    settings = scene.mocap
    if settings.folder and (bpy.data.filepath or not settings.folder.startswith("//")):
        return usable(absolute(settings.folder))
    if bpy.data.filepath:
        return usable(Path(bpy.data.filepath).parent / BESIDE)
    if not settings.session:
        settings.session = str(_new_session())
    return usable(Path(settings.session))


def usable(folder: Path) -> Path:
    """Return a writable folder for captures or takes. Create it if needed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe(folder)
    except OSError as error:
        raise OutputNotWritable(
            f"The folder for takes cannot be written to: {error.strerror or error}.",
            where=str(folder),
            hint="Free some space there, or choose another folder under Advanced in the Solve panel.",
        ) from error
    return folder


def waits_for_saving(scene: bpy.types.Scene) -> str:
    """Return an unsaved scene's session folder, or "" if takes are already in their final folder."""
    settings = scene.mocap
    if bpy.data.filepath or (settings.folder and not settings.folder.startswith("//")):
        return ""
    return settings.session or str(sessions_folder())


def _new_session() -> Path:
    name = f"unsaved {datetime.now():%Y-%m-%d %H.%M.%S}"
    names = (name if n == 1 else f"{name} ({n})" for n in range(1, 1000))
    return next(path for path in map(sessions_folder().__truediv__, names) if not path.exists())


@dataclass(frozen=True)
class _Link:
    """A path stored in the open .blend file."""

    owner: Any  # Settings of a scene, or an action in the file.
    key: str
    follows: bool  # True for the add-on's files, which move with the .blend file. The user's own files do not move.

    @property
    def text(self) -> str:
        is_action = isinstance(self.owner, bpy.types.Action)
        return str(self.owner.get(self.key, "") if is_action else getattr(self.owner, self.key))

    def write(self, value: str) -> None:
        if isinstance(self.owner, bpy.types.Action):
            self.owner[self.key] = value
        else:
            setattr(self.owner, self.key, value)


@dataclass
class Journey:
    """Files copied and paths changed by one save, to undo them if saving fails."""

    before: list[tuple[_Link, str]] = field(default_factory=list)  # Changed links and their earlier paths.
    copied: dict[Path, Path] = field(default_factory=dict)  # New path of each copied file, keyed by its earlier path.
    made: list[Path] = field(default_factory=list)  # Copies that did not exist before.

    def relink(self, link: _Link, text: str) -> None:
        """Change a stored path and remember the earlier one."""
        if link.text != text:
            self.before.append((link, link.text))
            link.write(text)

    def links_back(self) -> None:
        """Restore all stored paths."""
        for link, text in reversed(self.before):
            with suppress(ReferenceError):
                link.write(text)

    def back(self) -> None:
        """Restore all stored paths, and remove the copied files."""
        self.links_back()
        for path in self.made:
            with suppress(OSError):
                path.unlink()
                path.parent.rmdir()

    def arrive(self) -> None:
        """Remove the originals of files copied from session folders, and record the new paths."""
        gone = {old: new for old, new in self.copied.items() if old.is_relative_to(sessions_folder())}
        if not gone or following.solver_reads:
            return
        note_moved(gone)
        for path in gone:
            with suppress(OSError):  # if the file cannot be removed, two copies remain
                path.unlink()
        folders = {folder for path in gone for folder in (path.parent, path.parent.parent)} - {sessions_folder()}
        for folder in sorted(folders, key=lambda folder: -len(folder.parts)):
            with suppress(OSError):  # the folder is not empty
                folder.rmdir()


@dataclass
class Following:
    """State of the current save, and the failure of the last save."""

    journey: Journey | None = None
    failure: str = ""
    solver_reads: bool = False  # True while the solver may read the session folder, so that no file is removed.


following = Following()


def follow(target: Path) -> Journey:
    """Copy captures and takes to the .blend file's folder and store the new paths. A failure changes nothing."""
    journey, base = Journey(), target.parent
    try:
        links = list(_links())
        files = {link: file_of(link.text) for link in links if link.text}
        journey.copied = _destinations([path for link, path in files.items() if link.follows], base)
        for old, new in journey.copied.items():
            if not new.exists():
                _copy(old, new)
                journey.made.append(new)
        for link, path in files.items():
            if link.key == "session":
                journey.relink(link, "")
            elif not _is_kept(link, path):
                journey.relink(link, stored(journey.copied.get(path, path), base))
    except (MocapError, OSError) as error:
        journey.back()
        if isinstance(error, MocapError):
            raise
        message = f"Captures and takes cannot be copied: {error.strerror or error}."
        raise OutputNotWritable(message, where=str(base)) from error
    return journey


def bring_home() -> None:
    """Move files that were written to a session folder after the scene had been saved."""
    if bpy.data.filepath:
        follow(Path(bpy.data.filepath)).arrive()


@persistent
def before_save(target: str = "", *_: object) -> None:
    """Copy captures and takes to the .blend file's folder, or report the failure."""
    following.journey, following.failure = None, ""
    if not target or not isinstance(target, str):
        return  # the start-up file
    try:
        following.journey = follow(Path(target))
    except MocapError as error:
        following.failure = f"Captures and takes were not moved. {error}"
        _say(following.failure)


@persistent
def after_save(target: str = "", *_: object) -> None:
    """Remove the originals in the session folder, or restore the paths if the user saved a copy."""
    journey, following.journey = following.journey, None
    if journey is None:
        return
    if Path(bpy.data.filepath) != Path(target):
        journey.links_back()
        return
    try:
        journey.arrive()
    except MocapError as error:
        _say(f"The session folder is unchanged. {error}")


@persistent
def after_failed_save(*_: object) -> None:
    """Restore all stored paths, and remove the copied files."""
    journey, following.journey = following.journey, None
    if journey is not None:
        journey.back()


_MOST_FOLDERS = 20_000  # Largest number of folders to search. Chosen by hand.


def missing_links() -> list[_Link]:
    """Return the stored paths of missing files or folders of captures and takes."""
    made = ("folder", "results", "session")  # these are created when needed
    return [link for link in _links() if link.text and link.key not in made and not file_of(link.text).exists()]


def relink(folder: Path) -> tuple[int, list[Path]]:
    """Find missing captures and takes below a folder by their names, and store their new paths.

    A candidate must be in the folder itself, or in a folder with the name of the missing file's folder. The candidate
    with the most equal parent folders is used, or none if two are equally good. A file replaces only one missing file,
    and none if another stored path already points to it.

    Returns:
        The number of changed paths, and the files that are still missing.
    """
    links, there = missing_links(), dict[str, list[Path]]()
    for place, folders, files in islice(os.walk(folder), _MOST_FOLDERS):
        for name in (*folders, *files):
            there.setdefault(name, []).append(Path(place, name))
    claims: dict[Path, dict[Path, int]] = {}  # number of equal path parts, by candidate file and missing path
    for path in {file_of(link.text) for link in links}:
        fits = [new for new in there.get(path.name, ()) if new.parent == folder or new.parent.name == path.parent.name]
        alike = sorted(((_equal_parts(path, new), new) for new in fits), reverse=True)
        if alike and (len(alike) == 1 or alike[0][0] > alike[1][0]):
            claims.setdefault(alike[0][1], {})[path] = alike[0][0]
    taken = {file_of(link.text) for link in _links() if link.text} - {file_of(link.text) for link in links}
    fitting: dict[Path, Path] = {}
    for new, parts in claims.items():
        first = [path for path, equal in parts.items() if equal == max(parts.values())]
        if len(first) == 1 and new not in taken:
            fitting[first[0]] = new
    found = {link: fitting[path] for link in links if (path := file_of(link.text)) in fitting}
    for link, path in found.items():
        link.write(stored(path))
    return len(found), sorted({file_of(link.text) for link in links if link not in found})


def _equal_parts(path: Path, other: Path) -> int:
    """Return the number of equal parts (file name, folder, ...) at the ends of two paths."""
    parts = zip(reversed(path.parts), reversed(other.parts), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], parts))


_OF_CAPTURE = ("file", "original", "source", "network")


def _links() -> Iterator[_Link]:
    from ..animation.takes import PATHS

    for scene in bpy.data.scenes:
        if scene.library is not None:
            continue
        settings = scene.mocap
        for capture in (*settings.captures, settings.blank):
            yield from (_Link(capture, key, follows=key != "source") for key in _OF_CAPTURE)
        yield _Link(settings.solve, "subject", follows=True)
        for owner, keys in (
            (settings.videos, ("folder", "results", "lenses", "model")),
            (settings, ("folder", "session")),
        ):
            yield from (_Link(owner, key, follows=False) for key in keys)
    for action in bpy.data.actions:
        if action.library is None:
            yield from (_Link(action, key, follows=True) for key in PATHS if action.get(key))


def _destinations(paths: list[Path], base: Path) -> dict[Path, Path]:
    """Return each file's new path. If another file has this path, the new folder gets a number."""
    groups: dict[Path, tuple[Path, set[Path]]] = {}
    for path in paths:
        root = _root(path, base)
        if root is not None and path.is_file():
            into, below = root
            groups.setdefault(path.parent, (into / path.parent.relative_to(below), set()))[1].add(path)
    moved: dict[Path, Path] = {}
    for wanted, files in groups.values():
        names = chain([wanted], (wanted.with_name(f"{wanted.name}_{n}") for n in count(2)))
        folder = next(folder for folder in names if all(_is_free(folder / f.name, f) for f in files))
        moved |= {path: folder / path.name for path in sorted(files)}
    return moved


def _root(path: Path, base: Path) -> tuple[Path, Path] | None:
    """Return the new and the current root folder of a file, or None if the file stays where it is."""
    sessions = sessions_folder()
    if path.is_relative_to(sessions) and len(path.relative_to(sessions).parts) > 1:
        return base / BESIDE, sessions / path.relative_to(sessions).parts[0]
    old = _old_base()
    if old is None or old == base:
        return None
    relative = {scene.mocap.folder for scene in bpy.data.scenes if scene.mocap.folder.startswith("//")}
    for folder in (old / BESIDE, *map(absolute, sorted(relative))):
        if folder.is_relative_to(old) and path.is_relative_to(folder):
            return base / folder.relative_to(old), folder
    return None


def _old_base() -> Path | None:
    return Path(bpy.data.filepath).parent if bpy.data.filepath else None


def _is_kept(link: _Link, path: Path) -> bool:
    """Return whether a path is a folder relative to the .blend file. Such a folder moves with the file."""
    base = _old_base()
    return link.key == "folder" and link.text.startswith("//") and (base is None or path.is_relative_to(base))


def _is_free(new: Path, old: Path) -> bool:
    import filecmp

    return not new.exists() or filecmp.cmp(old, new, shallow=False)


def _copy(old: Path, new: Path) -> None:
    import shutil

    usable(new.parent)
    part = new.with_name(f".part_{new.name}")
    try:
        shutil.copy2(old, part)
        part.replace(new)
    finally:
        part.unlink(missing_ok=True)


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    if not bpy.app.background and bpy.context.window is not None:
        windows = bpy.context.window_manager
        windows.popup_menu(lambda menu, _: menu.layout.label(text=text, icon="ERROR"), title="Motion capture")
