"""Whole files or none: writing under a temporary name, and reading arrays without pickle."""

from __future__ import annotations

import json
import os
import tomllib
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, FileMissing, OutputExists, OutputNotWritable


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
    probe = _temporary_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
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
    temporary = _temporary_name(path)
    try:
        yield temporary
        with open(temporary, "rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise _not_writable(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def _temporary_name(path: Path) -> Path:
    return path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")


def _not_writable(path: Path, error: OSError) -> OutputNotWritable:
    reason = error.strerror or str(error)
    return OutputNotWritable(
        f"The output cannot be written: {reason}.",
        where=str(path),
        hint="Choose a folder you may write to, with enough free space.",
    )


def write_npz(path: Path | str, arrays: Mapping[str, np.ndarray], *, overwrite: bool = False) -> Path:
    """Write arrays to a compressed ``.npz`` that holds no pickles, whole or not at all.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        ValueError: an array is of type object.
    """
    plain = {key: np.asarray(value) for key, value in arrays.items()}
    for key, value in plain.items():
        if value.dtype.hasobject:
            raise ValueError(f"'{key}' is an object array, which would need pickle.")
    # The archive is written member by member: np.savez takes names as keywords and so forbids 'file'.
    with (
        atomic_output(path, overwrite=overwrite) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
    ):
        for key, value in plain.items():
            with archive.open(f"{key}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, value, allow_pickle=False)
    return Path(path)


def write_text(path: Path | str, text: str, *, overwrite: bool = False) -> Path:
    """Write a UTF-8 text file, whole or not at all."""
    with atomic_output(path, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def read_npz(path: Path | str) -> dict[str, np.ndarray]:
    """Read every array of an ``.npz`` that needs no pickle; arrays that would need it are left out.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file is truncated or no npz.
    """
    path = require_file(path)
    arrays: dict[str, np.ndarray] = {}
    try:
        if not zipfile.is_zipfile(path):
            raise zipfile.BadZipFile("no zip archive")
        with np.load(path, allow_pickle=False) as archive:
            for key in archive.files:
                try:
                    arrays[key] = archive[key]
                except ValueError as error:
                    if "pickle" not in str(error).lower():
                        raise
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise FileDamaged(
            f"The file is truncated or is not an .npz of arrays ({error}).",
            where=str(path),
            hint="Copy or export it again.",
        ) from error
    return arrays


def read_bytes(path: Path | str) -> bytes:
    """Read a whole file.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file cannot be read.
    """
    path = require_file(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileDamaged(f"The file cannot be read: {error.strerror or error}.", where=str(path)) from error


def read_text(path: Path | str) -> str:
    """Read a text file as UTF-8 (with or without mark), or as Latin-1 where it is not UTF-8.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file cannot be read.
    """
    data = read_bytes(path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_json(path: Path | str) -> Any:
    """Read a JSON file.

    Raises:
        FileMissing, FileDamaged: there is no such file, or it is truncated or not JSON.
    """
    text = read_text(path)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileDamaged(
            f"The file is truncated or is not JSON ({error}).", where=str(path), hint="Copy or export it again."
        ) from error


def read_toml(path: Path | str) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        FileMissing, FileDamaged: there is no such file, or it is truncated or not TOML.
    """
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FileDamaged(
            f"The file is truncated or is not TOML ({error}).", where=str(path), hint="Check the line that is named."
        ) from error


def require_file(path: Path | str) -> Path:
    """Return the path of a file that exists.

    Raises:
        FileMissing: there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    return path
