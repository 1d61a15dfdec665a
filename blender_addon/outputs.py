"""Several output files, all of them or none."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import OutputExists, OutputNotWritable

_PROBE = bytes(4096)


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
    made = _make_folder(folder)
    temporary = {name: folder / f".part{os.getpid()}_{name}" for name in names}
    try:
        probe(folder)
        yield temporary
        for name, path in temporary.items():
            if path.exists():
                os.replace(path, folder / name)
    except OSError as error:
        raise _not_writable(folder, error) from error
    finally:
        for path in temporary.values():
            path.unlink(missing_ok=True)
        for parent in made:
            if parent.is_dir() and not any(parent.iterdir()):
                parent.rmdir()


def probe(folder: Path) -> None:
    """Write a small file and remove it, so that a read-only folder and a full disk are told before work begins.

    Raises:
        OSError: the system says why it cannot be written.
    """
    path = folder / f".probe{os.getpid()}"
    try:
        path.write_bytes(_PROBE)
    finally:
        path.unlink(missing_ok=True)


def _make_folder(folder: Path) -> list[Path]:
    """Make a folder and return the ones that were new, innermost first."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _not_writable(folder, error) from error
    return missing


def _not_writable(folder: Path, error: OSError) -> OutputNotWritable:
    return OutputNotWritable(
        f"The output cannot be written: {error.strerror or error}.",
        where=str(folder),
        hint="Choose a folder you may write to, with enough free space.",
    )
