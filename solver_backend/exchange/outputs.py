"""Output files, whole or not at all: they are written under temporary names and renamed when all of them are there."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from .errors import OutputExists, OutputNotWritable
from .unfinished import is_leftover, probe, unfinished_names

_NO_ROOM = {getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG", "EROFS") if hasattr(errno, name)}
"""No space, a quota, a limit of file size, a disk that is only read."""


def check_output(path: Path | str, *, overwrite: bool = False) -> Path:
    """Return the output's path after checking that it can be written; meant to be called before long work.

    Missing folders are made. Nothing is left behind in the folder.

    Raises:
        OutputExists: the file or folder is there and ``overwrite`` is off.
        OutputNotWritable: the folder cannot be made or written to, or the output is a link, a device or a folder.
    """
    path = Path(path)
    if os.path.lexists(path) and not overwrite:
        raise _exists(path)
    _require_plain(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        probe(path.parent)
    except OSError as error:
        raise _not_writable(path, error) from error
    return path


@contextmanager
def atomic_output(path: Path | str, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that becomes ``path`` when the block ends well, and vanishes otherwise.

    Raises:
        OutputExists: the output is there and ``overwrite`` is off.
        OutputNotWritable: the folder cannot be written to, or the disk is full.
    """
    with atomic_files([path], overwrite=overwrite) as [temporary]:
        yield temporary


@contextmanager
def atomic_files(paths: Sequence[Path | str], *, overwrite: bool = False) -> Iterator[list[Path]]:
    """Yield a temporary path beside each path; those that are written take their names when the block ends well.

    Raises:
        OutputExists: one of the outputs is there and ``overwrite`` is off.
        OutputNotWritable: a folder cannot be written to, or the disk is full.
    """
    checked = [check_output(path, overwrite=overwrite) for path in paths]
    with _named_at_the_end(checked, checked[0], overwrite) as temporary:
        yield temporary


@contextmanager
def atomic_outputs(folder: Path, names: tuple[str, ...], *, overwrite: bool = False) -> Iterator[dict[str, Path]]:
    """Yield a temporary path for each name; they become the files when the block ends well and vanish otherwise.

    Existing files are replaced only with ``overwrite``. Missing folders are made, and removed again if nothing was
    written.

    Raises:
        OutputExists: one of the files is there, and ``overwrite`` is off.
        OutputNotWritable: the folder cannot be made or written to.
    """
    existing = [name for name in names if os.path.lexists(folder / name)]
    if existing and not overwrite:
        raise OutputExists(
            f"{', '.join(existing)} {'is' if len(existing) == 1 else 'are'} already there and not overwritten.",
            where=str(folder),
            hint="Choose another folder or delete the files.",
        )
    for name in existing:
        _require_plain(folder / name)
    new_folders = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe(folder)
    except OSError as error:
        _remove_empty(new_folders)
        raise _not_writable(folder, error) from error
    try:
        with _named_at_the_end([folder / name for name in names], folder, overwrite) as temporary:
            yield dict(zip(names, temporary, strict=True))
    finally:
        _remove_empty(new_folders)


def write_text(path: Path | str, text: str, *, overwrite: bool = False) -> Path:
    """Write a UTF-8 text file, whole or not at all."""
    with atomic_output(path, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def is_free(folder: Path) -> bool:
    """Return whether a folder is not there, or holds nothing but what an interrupted run has left."""
    return not folder.exists() or (folder.is_dir() and all(is_leftover(path.name) for path in folder.iterdir()))


@contextmanager
def _named_at_the_end(paths: Sequence[Path], where: Path, overwrite: bool) -> Iterator[list[Path]]:
    """Yield a temporary path for each path; those that were written take the paths' names in one moment."""
    try:
        with ExitStack() as unfinished:
            folders = dict.fromkeys(path.parent for path in paths)
            beginning = {folder: unfinished.enter_context(unfinished_names(folder)) for folder in folders}
            temporary = [path.with_name(beginning[path.parent] + path.name) for path in paths]
            yield temporary
            written = [(part, path) for part, path in zip(temporary, paths, strict=True) if part.exists()]
            for part, _ in written:
                with part.open("rb+") as stream:
                    os.fsync(stream.fileno())
            _publish(written, overwrite)
            for folder in folders:
                _flush_folder(folder)
    except OSError as error:
        raise _not_writable(where, error) from error


def _publish(written: Sequence[tuple[Path, Path]], overwrite: bool) -> None:
    """Give the files their names, all or none; without ``overwrite`` a name that somebody took meanwhile is kept."""
    if overwrite:
        for part, path in written:
            _require_plain(path)
            os.replace(part, path)
        return
    done: list[Path] = []
    try:
        for part, path in written:
            _take_name(part, path)
            done.append(path)
    except FileExistsError as error:
        for path in done:
            path.unlink(missing_ok=True)
        raise _exists(written[len(done)][1]) from error


def _take_name(part: Path, path: Path) -> None:
    """Rename a file to a name that must be free; a second link fails where it is not, which a rename does not."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links: the name is taken by an empty file first
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        os.replace(part, path)


def _flush_folder(folder: Path) -> None:
    """Bring the new names to the disk, where the system lets folders be flushed."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _require_plain(path: Path) -> None:
    """Make sure that what would be replaced is an ordinary file, or nothing."""
    try:
        mode = path.lstat().st_mode
    except OSError:
        return
    if stat.S_ISDIR(mode):
        raise OutputNotWritable("The output is a folder; a file name is expected.", where=str(path))
    if not stat.S_ISREG(mode):
        what = "a link" if stat.S_ISLNK(mode) else "a device or a pipe"
        raise OutputNotWritable(
            f"The output is {what}, which is not replaced.", where=str(path), hint="Choose another name."
        )


def _remove_empty(folders: Sequence[Path]) -> None:
    """Remove those of the folders, innermost first, that hold nothing."""
    for folder in folders:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _exists(path: Path) -> OutputExists:
    return OutputExists(
        "The output is already there and is not overwritten.",
        where=str(path),
        hint="Choose another name, delete it, or allow overwriting (--overwrite).",
    )


def full_disk(error: BaseException) -> OutputNotWritable | None:
    """Return the named error of a disk that is full or may not be written to, None for any other failure."""
    if isinstance(error, OSError) and error.errno in _NO_ROOM:
        return _not_writable(error.filename or "", error)
    return None


def _not_writable(where: Path | str, error: OSError) -> OutputNotWritable:
    return OutputNotWritable(
        f"The output cannot be written: {error.strerror or error}.",
        where=str(where),
        hint="Choose a folder you may write to, with enough free space.",
    )
