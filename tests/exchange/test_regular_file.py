"""Devices and pipes in the place of files are refused, and nothing waits for them."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.exchange.json_file import read_json_file
from solver_backend.exchange.npz import read_npz
from solver_backend.exchange.outputs import open_regular
from solver_backend.io.files import read_bytes
from solver_backend.io.footage import read_video_header
from solver_backend.io.markers.live_recording import read_live_recording


def refuse_to_wait(*args: object) -> bytes:
    raise BlockingIOError


@pytest.mark.parametrize("read", [read_json_file, read_npz, read_bytes, read_live_recording])
def test_what_is_no_file_is_named_at_once(tmp_path: Path, read: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe")
    start = time.monotonic()
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises((FileMissing, FileDamaged)):
            read(path)
    assert time.monotonic() - start < 2.0


@pytest.mark.parametrize("read", [read_json_file, read_npz, read_bytes, read_live_recording])
def test_a_file_of_the_system_that_waits_for_data_is_named(
    tmp_path: Path, read: Callable[[Path], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What reading ``/proc/kmsg`` without waiting does, which only the superuser may try."""
    path = tmp_path / "log"
    path.touch()
    monkeypatch.setattr(os, "read", refuse_to_wait)
    with pytest.raises(FileDamaged, match=r"waits for data"):
        read(path)


@pytest.mark.parametrize("number", [errno.EACCES, errno.EIO])
@pytest.mark.parametrize("read", [read_json_file, read_npz, read_bytes, read_live_recording])
def test_a_file_that_the_system_cannot_read_needs_no_correction(
    tmp_path: Path, read: Callable[[Path], object], number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object) -> int:
        raise OSError(number, os.strerror(number))

    path = tmp_path / "take"
    path.touch()
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(FileDamaged, match=rf"cannot be read: {os.strerror(number)}") as caught:
        read(path)
    assert caught.value.hint == "Check its permissions and its disk."


def test_ordinary_files_are_opened_empty_or_not(tmp_path: Path) -> None:
    for content in (b"", b"ab"):
        (tmp_path / "a").write_bytes(content)
        with open_regular(tmp_path / "a") as stream:
            assert stream.read() == content
    assert read_video_header(tmp_path) is None
