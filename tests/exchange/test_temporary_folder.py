"""Folders of the moment leave nothing behind, not even of processes that were killed."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from solver_backend.exchange import outputs
from solver_backend.exchange.outputs import full_disk, is_held, temporary_folder

ROOT = Path(__file__).parents[2]
_WAITS = """
import time
from solver_backend.exchange.outputs import temporary_folder
with temporary_folder() as folder:
    (folder / "a").write_text("a")
    print(folder, flush=True)
    time.sleep(60)
"""


def test_a_folder_is_there_and_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with temporary_folder() as folder, temporary_folder() as other:
        assert folder != other and folder.is_dir() and folder.stat().st_mode & 0o077 == 0
        (folder / "below").mkdir()
        (folder / "below" / "a").write_text("a")
    assert os.listdir(tmp_path) == []


def test_the_next_removes_what_a_killed_process_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fcntl", reason="this system has no locks to see that a process is gone")
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", _WAITS], stdout=subprocess.PIPE, cwd=ROOT, env=environment) as child:
        assert child.stdout is not None
        left = Path(child.stdout.readline().decode().strip())
        old = time.time() - 3600.0
        for path in tmp_path.iterdir():
            os.utime(path, (old, old))
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        with temporary_folder():
            assert (left / "a").exists()  # its process is alive
        child.send_signal(signal.SIGKILL)
        child.wait()
    with temporary_folder():
        assert not left.exists()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS])
def test_a_full_disk_is_named_wherever_it_is_met(number: int) -> None:
    found = full_disk(OSError(number, os.strerror(number), "a/b.npz"))
    assert found is not None and found.where == "a/b.npz" and os.strerror(number) in found.message


def test_other_failures_are_not_the_disks() -> None:
    assert full_disk(OSError(errno.ENOENT, "gone")) is None and full_disk(ValueError()) is None


@pytest.mark.skipif(outputs.fcntl is None, reason="Windows has no such locks")
@pytest.mark.parametrize(("answer", "held"), [(errno.EAGAIN, True), (errno.EACCES, True), (errno.ENOLCK, False)])
def test_a_file_that_another_machine_has_locked_is_held(
    answer: int, held: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shares answer EACCES, and a file system without locks ENOLCK."""

    def refuse(handle: int, what: int) -> None:
        raise OSError(answer, os.strerror(answer))

    path = tmp_path / "a"
    path.touch()
    monkeypatch.setattr(outputs.fcntl, "flock", refuse)
    assert is_held(path) == held
