"""Write output files completely or not at all, by renaming temporary files together."""

from __future__ import annotations

import errno
import os
import re
import stat
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import FileDamaged, FileMissing, OutputExists, OutputNotWritable

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]

_PART, _PROBE = ".part", ".probe"
_PROBE_BYTES = bytes(4096)
_LOCK = re.compile(r"\.part-[0-9a-f]{16}")
_LEFTOVER = re.compile(r"\.part-[0-9a-f]{16}(_.*)?|\.probe-[0-9a-f]{16}", re.DOTALL)
_LIKE = 0.8  # Smallest similarity (0 to 1) of a suggested name. Chosen by hand.
_MOST_NEAR = 1000  # Largest number of names in a folder that are compared with a misspelt name. Chosen by hand.
_YOUNG_S, _OLD_S = 60.0, 86400.0
"""Age in seconds at which a leftover is removed: if its lock is free, and on systems without locks."""


def is_leftover(name: str) -> bool:
    """Return whether a file or folder is named like one of our unfinished outputs."""
    return _LEFTOVER.fullmatch(name) is not None


def probe(folder: Path) -> None:
    """Write and remove a small file to detect a read-only folder or a full disk."""
    path = folder / f"{_PROBE}-{os.urandom(8).hex()}"
    path.touch(exist_ok=False)
    try:
        path.write_bytes(_PROBE_BYTES)
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def unfinished_names(folder: Path) -> Iterator[str]:
    """Yield an unguessable name prefix, and finally remove all files and folders whose names start with it.

    First, leftovers of processes that ended without cleaning up are removed. Within the ``with`` block, a locked file
    shows other processes that the prefix is in use. The system releases the lock when this process ends.
    """
    held = folder / f"{_PART}-{os.urandom(8).hex()}"
    handle = os.open(held, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        lock(handle)
        sweep(folder, os.fstat(handle).st_mtime)
        yield f"{held.name}_"
    finally:
        _remove(held)
        os.close(handle)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a new folder in the system's temporary folder, and remove it at the end."""
    from tempfile import gettempdir  # this module is imported when the add-on is registered, which should be fast

    place = Path(gettempdir())
    with unfinished_names(place) as beginning:
        folder = place / f"{beginning}work"
        folder.mkdir(mode=0o700)
        yield folder


def publish(unfinished: Path, whole: Path, mark: str) -> None:
    """Give a completed folder its final name, unless another process has already published it.

    Args:
        unfinished: folder next to ``whole``, named by ``unfinished_names``.
        mark: path of a file that exists if ``whole`` is complete, relative to the parent of ``whole``.
    """
    try:
        unfinished.rename(whole)
    except OSError:
        if (whole.parent / mark).is_file():
            return
        remove_folder(whole)
        unfinished.rename(whole)


def remove_folder(path: Path) -> None:
    """Remove a folder and its contents, as far as the system allows."""
    from shutil import rmtree  # rarely needed, and slow to import

    rmtree(path, ignore_errors=True)


def sweep(folder: Path, now: float | None = None) -> None:
    """Remove leftovers of processes that have ended.

    Args:
        now: current time on the folder's machine, which may be another one. None uses this machine's clock.
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
        held = _LOCK.match(path.name)
        alone = held is None or not path.with_name(held[0]).exists()  # otherwise it is removed together with its lock
        if alone and (age > _OLD_S or path.name.startswith(_PROBE)):
            path.unlink()
        return
    handle = os.open(path, os.O_RDWR)
    try:
        free = lock(handle)
        if free or (free is None and age > _OLD_S):  # with locks, a clock change cannot make an active file old
            _remove(path)
    finally:
        os.close(handle)


def _remove(held: Path) -> None:
    for path in [path for path in held.parent.iterdir() if path.name.startswith(f"{held.name}_")]:
        if path.is_dir() and not path.is_symlink():
            remove_folder(path)
        else:
            path.unlink(missing_ok=True)
    held.unlink(missing_ok=True)


def is_held(path: Path) -> bool:
    """Return whether a running process has locked a file. False on systems without such locks."""
    if fcntl is None:
        return False
    handle = os.open(path, os.O_RDWR)
    try:
        return lock(handle) is False
    finally:
        os.close(handle)


_HELD = {errno.EAGAIN, errno.EACCES}  # Network shares return EACCES for a file that another machine has locked.


def lock(handle: int) -> bool | None:
    """Lock an open file. Return False if it is already locked, or None if the system has no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return False if error.errno in _HELD else None
    return True


_LONGEST_NAME = 255  # Longest file name in bytes on common file systems.
_NO_ROOM = {getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG", "EROFS") if hasattr(errno, name)}
"""Error codes of a full disk or quota, a file size limit, and a read-only disk."""


def check_output(path: Path | str, *, overwrite: bool = False) -> Path:
    """Create missing folders and return the output path if it is writable.

    Raises:
        OutputExists: the file or folder exists and ``overwrite`` is False.
        OutputNotWritable: the folder cannot be created or written to, or the output is a link, a device or a folder.
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
    """Yield a temporary path that is renamed to ``path`` on success and removed otherwise."""
    with atomic_files([path], overwrite=overwrite) as [temporary]:
        yield temporary


@contextmanager
def atomic_files(paths: Sequence[Path | str], *, overwrite: bool = False) -> Iterator[list[Path]]:
    """Yield a temporary path next to each path, and rename all files on success.

    New folders are removed if nothing was written.
    """
    wanted = [Path(path) for path in paths]
    new_folders = [folder for path in wanted for folder in path.parents if not os.path.exists(folder)]
    try:
        for path in wanted:
            check_output(path, overwrite=overwrite)
        with _named_at_the_end(wanted, overwrite) as temporary:
            yield temporary
    finally:
        for folder in new_folders:
            with suppress(OSError):  # it now contains files, or was never created
                folder.rmdir()


@contextmanager
def atomic_outputs(folder: Path, names: tuple[str, ...], *, overwrite: bool = False) -> Iterator[dict[str, Path]]:
    """Yield a dict that maps each name to a temporary path in ``folder``. See ``atomic_files``."""
    existing = [name for name in names if os.path.lexists(folder / name)]
    if existing and not overwrite:
        what = f"{', '.join(existing)} already exist{'s' * (len(existing) == 1)}. Nothing was overwritten."
        raise OutputExists(what, where=str(folder), hint="Choose another folder or delete the files.")
    with atomic_files([folder / name for name in names], overwrite=overwrite) as unfinished:
        yield dict(zip(names, unfinished, strict=True))


def write_text(path: Path | str, text: str, *, overwrite: bool = False) -> Path:
    """Write a UTF-8 text file, completely or not at all."""
    with atomic_output(path, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def is_free(folder: Path) -> bool:
    """Return whether a folder does not exist or contains only leftovers from an interrupted run."""
    return not folder.exists() or (folder.is_dir() and all(is_leftover(path.name) for path in folder.iterdir()))


@contextmanager
def _named_at_the_end(paths: Sequence[Path], overwrite: bool) -> Iterator[list[Path]]:
    try:
        with ExitStack() as unfinished:
            folders = dict.fromkeys(path.parent for path in paths)
            beginning = {folder: unfinished.enter_context(unfinished_names(folder)) for folder in folders}
            temporary = [
                path.with_name(_unfinished(beginning[path.parent], path, number)) for number, path in enumerate(paths)
            ]
            yield temporary
            written = [(part, path) for part, path in zip(temporary, paths, strict=True) if part.exists()]
            for part, _ in written:
                with part.open("rb+") as stream:
                    os.fsync(stream.fileno())
            _publish(written, overwrite)
            for folder in folders:
                with suppress(OSError):  # not all systems can flush folders
                    handle = os.open(folder, os.O_RDONLY)
                    try:
                        os.fsync(handle)
                    finally:
                        os.close(handle)
    except OSError as error:
        raise _not_writable(paths[0], error) from error


def _unfinished(beginning: str, path: Path, number: int) -> str:
    """Return a temporary name with the suffix of ``path``. If the name is too long, ``number`` replaces its stem."""
    name = beginning + path.name
    return name if len(os.fsencode(name)) <= _LONGEST_NAME else f"{beginning}{number}{path.suffix}"


def _publish(written: Sequence[tuple[Path, Path]], overwrite: bool) -> None:
    """Rename all files. Without ``overwrite``, existing files are never replaced: all files are renamed or none."""
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
    """Rename a file by means of a hard link. Unlike a plain rename, this fails if the name exists."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # for file systems without links, reserve the name with an empty file
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        os.replace(part, path)


def _require_plain(path: Path) -> None:
    try:
        mode = path.lstat().st_mode
    except OSError:
        return
    if stat.S_ISDIR(mode):
        raise OutputNotWritable("The output is a folder, but a file name is expected.", where=str(path))
    if not stat.S_ISREG(mode):
        what = f"The output is {'a link' if stat.S_ISLNK(mode) else 'a device or a pipe'}, which is not replaced."
        raise OutputNotWritable(what, where=str(path), hint="Choose another name.")


def _exists(path: Path) -> OutputExists:
    hint = "Choose another name, delete it, or allow overwriting (--overwrite)."
    return OutputExists("The output already exists and was not overwritten.", where=str(path), hint=hint)


def full_disk(error: BaseException) -> OutputNotWritable | None:
    """Return the named error for a full or read-only disk, or None for other failures."""
    if isinstance(error, OSError) and error.errno in _NO_ROOM:
        return _not_writable(error.filename or "", error)
    return None


def _not_writable(where: Path | str, error: OSError) -> OutputNotWritable:
    hint = "Choose a writable folder with enough free space."
    return OutputNotWritable(f"The output cannot be written: {error.strerror or error}.", where=str(where), hint=hint)


def require_file(path: Path | str) -> Path:
    """Return the path of an existing file, or raise ``FileMissing``."""
    path = Path(path)
    if path.exists() and not path.is_file():
        what = "The path is a folder, a pipe or a device, not a file."
        raise FileMissing(what, where=str(path), hint="Name a file.")
    return require_path(path)


def unreadable(path: Path | str, error: OSError) -> FileDamaged:
    """Return the error for an existing file that the system cannot read."""
    hint = "Check its permissions and its disk."
    return FileDamaged(f"The file cannot be read: {error.strerror or error}.", where=str(path), hint=hint)


def require_path(path: Path | str, what: str = "file") -> Path:
    """Return the path of an existing file or folder. Otherwise, raise ``FileMissing`` and suggest a similar name."""
    path = Path(path)
    if path.exists():
        return path
    from difflib import get_close_matches  # needed only for mistakes

    folder = path.absolute().parent
    hint = "Check the path." if folder.is_dir() else f"Check the path: there is no folder {folder}."
    with suppress(OSError):
        near = get_close_matches(path.name, sorted(os.listdir(folder))[:_MOST_NEAR], 1, _LIKE)
        hint = f"Did you mean {path.with_name(near[0])}?" if near else hint
    raise FileMissing(f"There is no such {what}.", where=str(path), hint=hint)


def open_regular(path: Path | str) -> BinaryIO:
    """Open a regular file for reading bytes.

    Some system files, such as ``/proc/kmsg``, look like regular files, but reading them can wait forever. Therefore,
    all files are opened without blocking.

    Raises:
        OSError: it cannot be opened, is a device, pipe or folder, or has no data yet.
    """
    return os.fdopen(_opened(path)[0], "rb")


def read_regular(path: Path | str, largest: int) -> tuple[bytes, int]:
    """Return a file's bytes and size. If the file is larger than ``largest``, the bytes are empty."""
    handle, size = _opened(path)
    try:
        if size > largest:
            return b"", size
        data = os.read(handle, size + 1)
        if size and len(data) == size:
            return data, size
        parts, left = [data], largest - size
        while left > 0 and (part := os.read(handle, min(left, _CHUNK))):
            parts.append(part)
            left -= len(part)
        return b"".join(parts), size
    finally:
        os.close(handle)


_CHUNK = 1 << 20  # Bytes per read for a file that states no size.


def _opened(path: Path | str) -> tuple[int, int]:
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
    handle = os.open(path, flags)
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file")
        if not status.st_size:
            try:
                os.read(handle, 1)
            except BlockingIOError as error:
                raise OSError(errno.EINVAL, "it is a device that waits for data") from error
            os.lseek(handle, 0, os.SEEK_SET)
    except BaseException:
        os.close(handle)
        raise
    return handle, status.st_size
