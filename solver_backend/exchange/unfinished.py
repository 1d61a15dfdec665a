"""What is not finished: names for half-written files that no other process touches, and the sweeping of old ones."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]

_PART, _PROBE = ".part", ".probe"
_PROBE_BYTES = bytes(4096)
_LOCK = re.compile(r"\.part-[0-9a-f]{16}")
_LEFTOVER = re.compile(r"\.part-[0-9a-f]{16}(_.*)?|\.probe-[0-9a-f]{16}", re.DOTALL)
_YOUNG_S, _OLD_S = 60.0, 86400.0
"""A leftover is swept after the first if nobody holds its lock, after the second where locks cannot be asked."""


def is_leftover(name: str) -> bool:
    """Return whether a file or folder is named as our unfinished ones are."""
    return _LEFTOVER.fullmatch(name) is not None


def probe(folder: Path) -> None:
    """Write a small file and remove it, so that a read-only folder and a full disk are reported before work begins.

    Raises:
        OSError: the system reports why it cannot be written.
    """
    path = folder / f"{_PROBE}-{secrets.token_hex(8)}"
    path.touch(exist_ok=False)
    try:
        path.write_bytes(_PROBE_BYTES)
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def unfinished_names(folder: Path) -> Iterator[str]:
    """Yield a beginning of names in a folder that nobody can guess, and remove such files and folders at the end.

    The lock of a file without more to its name is held meanwhile, which the system releases however this process ends;
    what processes that ended without tidying have left is removed first.

    Raises:
        OSError: the folder cannot be written to.
    """
    held, handle = _new_lock(folder)
    try:
        sweep(folder, os.fstat(handle).st_mtime)
        yield f"{held.name}_"
    finally:
        _remove(held)
        os.close(handle)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a new folder among the system's temporary ones, removed at the end.

    What processes that were killed have left there is removed by the next that asks for one.

    Raises:
        OSError: it cannot be made.
    """
    from tempfile import gettempdir  # registering the add-on loads this module, and should load little

    place = Path(gettempdir())
    with unfinished_names(place) as beginning:
        folder = place / f"{beginning}work"
        folder.mkdir(mode=0o700)
        yield folder


def publish(unfinished: Path, whole: Path, mark: str) -> None:
    """Give a folder that is whole its name; where another process has done the same meanwhile, that one stays.

    Args:
        unfinished: folder beside the other, named by ``unfinished_names``.
        whole: what it is to be called.
        mark: path of a file that states that what bears the name is whole, from the folder around it.

    Raises:
        OSError: it cannot be renamed.
    """
    try:
        unfinished.rename(whole)
    except OSError:
        if (whole.parent / mark).is_file():
            return
        shutil.rmtree(whole, ignore_errors=True)
        unfinished.rename(whole)


def sweep(folder: Path, now: float | None = None) -> None:
    """Remove what processes that are gone have left in a folder.

    Args:
        folder: where to look.
        now: the time by the folder's own clock, which may be another machine's; None for this one's.
    """
    now = time.time() if now is None else now
    with suppress(OSError):
        for path in [path for path in folder.iterdir() if is_leftover(path.name)]:
            with suppress(OSError):
                _sweep_one(path, now)


def _sweep_one(path: Path, now: float) -> None:
    age = now - path.lstat().st_mtime
    if age < _YOUNG_S or not stat.S_ISREG(path.lstat().st_mode):
        return
    if _LOCK.fullmatch(path.name) is None:
        if age > _OLD_S or path.name.startswith(_PROBE):
            path.unlink()
        return
    handle = os.open(path, os.O_RDWR)
    try:
        if lock(handle) or age > _OLD_S:
            _remove(path)
    finally:
        os.close(handle)


def _remove(held: Path) -> None:
    """Remove the files and folders whose names begin with the lock's, then the lock."""
    for path in [path for path in held.parent.iterdir() if path.name.startswith(f"{held.name}_")]:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    held.unlink(missing_ok=True)


def _new_lock(folder: Path) -> tuple[Path, int]:
    path = folder / f"{_PART}-{secrets.token_hex(8)}"
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    lock(handle)
    return path, handle


def is_held(path: Path) -> bool:
    """Return whether a process that is alive holds the lock of a file; False where the system has no such locks."""
    if fcntl is None:
        return False
    handle = os.open(path, os.O_RDWR)
    try:
        return not lock(handle)
    finally:
        os.close(handle)


def lock(handle: int) -> bool:
    """Lock an open file if nobody holds it; False where another does, or the system has no such locks."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
