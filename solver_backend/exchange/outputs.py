"""Output files, whole or not at all: they are written under temporary names and renamed when all of them are there."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from .errors import OutputExists, OutputNotWritable

_PROBE = bytes(4096)


def check_output(path: Path | str, *, overwrite: bool = False) -> Path:
    """Return the output's path after checking that it can be written; meant to be called before long work.

    Missing folders are made. Nothing is left behind in the folder.

    Raises:
        OutputExists: the file or folder is there and ``overwrite`` is off.
        OutputNotWritable: the folder cannot be made or written to.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise OutputExists(
            "The output is already there and is not overwritten.",
            where=str(path),
            hint="Choose another name, delete it, or ask for overwriting.",
        )
    if path.is_dir():
        raise OutputNotWritable("The output is a folder; a file name is expected.", where=str(path))
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
    path = check_output(path, overwrite=overwrite)
    with _renamed_at_the_end([path], path) as [temporary]:
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
    existing = [name for name in names if (folder / name).exists()]
    if existing and not overwrite:
        raise OutputExists(
            f"{', '.join(existing)} {'is' if len(existing) == 1 else 'are'} already there and not overwritten.",
            where=str(folder),
            hint="Choose another folder or delete the files.",
        )
    new_folders = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe(folder)
    except OSError as error:
        _remove_empty(new_folders)
        raise _not_writable(folder, error) from error
    try:
        with _renamed_at_the_end([folder / name for name in names], folder) as temporary:
            yield dict(zip(names, temporary, strict=True))
    finally:
        _remove_empty(new_folders)


def write_text(path: Path | str, text: str, *, overwrite: bool = False) -> Path:
    """Write a UTF-8 text file, whole or not at all."""
    with atomic_output(path, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def probe(folder: Path) -> None:
    """Write a small file and remove it, so that a read-only folder and a full disk are reported before work begins.

    Raises:
        OSError: the system says why it cannot be written.
    """
    path = folder / f".probe{os.getpid()}"
    try:
        path.touch()
        path.write_bytes(_PROBE)
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def _renamed_at_the_end(paths: Sequence[Path], where: Path) -> Iterator[list[Path]]:
    """Yield a temporary path beside each path; those that were written take the paths' names."""
    temporary = [path.with_name(f".part{os.getpid()}_{path.name}") for path in paths]
    try:
        yield temporary
        written = [(part, path) for part, path in zip(temporary, paths, strict=True) if part.exists()]
        for part, _ in written:
            with part.open("rb+") as stream:
                os.fsync(stream.fileno())
        for part, path in written:
            os.replace(part, path)
    except OSError as error:
        raise _not_writable(where, error) from error
    finally:
        for part in temporary:
            part.unlink(missing_ok=True)


def _remove_empty(folders: Sequence[Path]) -> None:
    """Remove those of the folders, innermost first, that hold nothing."""
    for folder in folders:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _not_writable(where: Path, error: OSError) -> OutputNotWritable:
    return OutputNotWritable(
        f"The output cannot be written: {error.strerror or error}.",
        where=str(where),
        hint="Choose a folder you may write to, with enough free space.",
    )
