"""Several processes write into one folder, some are killed: every file is whole, one writer wins, nothing is left."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from solver_backend.exchange import outputs
from solver_backend.exchange.errors import OutputExists, OutputNotWritable
from solver_backend.exchange.outputs import atomic_output, atomic_outputs, check_output, is_free, write_text

ROUNDS = 25
RACER = """
import sys, time
from pathlib import Path
from solver_backend.exchange.errors import OutputExists
from solver_backend.exchange.outputs import write_text
folder, name, start, overwrite = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]), sys.argv[4] == "True"
won = []
for number in range(int(sys.argv[5])):
    time.sleep(max(0.0, start + 0.02 * number - time.time()))
    try:
        write_text(folder / f"{number}.txt", name * 50_000, overwrite=overwrite)
        won.append(str(number))
    except OutputExists:
        pass
print(" ".join(won))
"""
WRITER = """
import os, sys
from pathlib import Path
from solver_backend.exchange.outputs import write_text
while True:
    write_text(Path(sys.argv[1]) / "x.txt", "a" * 300_000, overwrite=True)
"""


def python(code: str, *arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], stdout=subprocess.PIPE, text=True)


def aged(path: Path, seconds: float) -> Path:
    path.touch()
    os.utime(path, (time.time() - seconds,) * 2)
    return path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write_while_b_is_taken(folder: Path, files: tuple[str, ...]) -> None:
    with atomic_outputs(folder, files) as temporary:
        for part in temporary.values():
            part.write_text("mine")
        (folder / "b.txt").write_text("theirs")


@pytest.mark.slow
@pytest.mark.parametrize("overwrite", [False, True])
def test_of_two_racing_writers_one_wins_and_files_are_whole(tmp_path: Path, overwrite: bool) -> None:
    start = time.time() + 1.5
    racers = {name: python(RACER, tmp_path, name, start, overwrite, ROUNDS) for name in "ab"}
    won = {name: set(racer.communicate(timeout=60)[0].split()) for name, racer in racers.items()}
    every = {str(number) for number in range(ROUNDS)}
    if overwrite:
        assert won == {"a": every, "b": every}
    else:
        assert not won["a"] & won["b"]
        assert won["a"] | won["b"] == every
    assert set(names(tmp_path)) == {f"{number}.txt" for number in every}
    for number in every:
        text = (tmp_path / f"{number}.txt").read_text()
        assert len(text) == 50_000
        assert set(text) <= ({"a", "b"} if overwrite else {name for name in "ab" if number in won[name]})
        assert len(set(text)) == 1


def test_killed_writers_leave_the_file_whole_and_the_next_one_tidies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_text(tmp_path / "x.txt", "a" * 300_000)
    for wait in (0.0, 0.003, 0.007, 0.011, 0.017):
        writer = python(WRITER, tmp_path)
        deadline = time.monotonic() + 20
        while not any(name.startswith(".part") for name in names(tmp_path)) and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(wait)
        writer.kill()
        writer.communicate()
        assert set((tmp_path / "x.txt").read_text()) == {"a"}
        assert len((tmp_path / "x.txt").read_text()) == 300_000
    monkeypatch.setattr(outputs, "_YOUNG_S", 0.0)
    write_text(tmp_path / "x.txt", "b", overwrite=True)
    assert names(tmp_path) == ["x.txt"]


def test_files_of_a_writer_at_work_are_not_swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outputs, "_YOUNG_S", -1.0)
    with atomic_output(tmp_path / "a.txt") as temporary:
        temporary.write_text("a")
        write_text(tmp_path / "b.txt", "b")
    assert (tmp_path / "a.txt").read_text() == "a"
    assert names(tmp_path) == ["a.txt", "b.txt"]


def test_leftovers_are_swept_when_old_and_block_nothing(tmp_path: Path) -> None:
    token = "0123456789abcdef"
    old = [aged(tmp_path / f".part-{token}", 100), aged(tmp_path / f".part-{token}_x.txt", 5),
           aged(tmp_path / f".probe-{token}", 100), aged(tmp_path / f".part-{token}_y.txt", 90_000)]  # fmt: skip
    young = aged(tmp_path / ".part-fedcba9876543210", 5)
    mine = aged(tmp_path / ".partition", 100)
    assert not is_free(tmp_path)
    mine.rename(tmp_path.parent / "mine")
    assert is_free(tmp_path)
    mine.touch()
    write_text(tmp_path / "x.txt", "x")
    assert not any(path.exists() for path in old)
    assert young.exists()
    assert mine.exists()
    assert not is_free(tmp_path)
    assert is_free(tmp_path / "nowhere")


def test_ages_are_told_by_the_folders_clock_not_by_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another machine's clock may be days ahead: the files of those who are at work are not old for that."""
    young = aged(tmp_path / ".part-fedcba9876543210_x.txt", 5)
    wall = time.time
    monkeypatch.setattr(outputs.time, "time", lambda: wall() + 10 * 86400)
    write_text(tmp_path / "x.txt", "x")
    assert young.exists()


def test_a_clock_that_jumps_leaves_the_files_of_a_writer_at_work(tmp_path: Path) -> None:
    with atomic_output(tmp_path / "slow.txt") as unfinished:
        unfinished.write_text("whole")
        held = tmp_path / unfinished.name.removesuffix("_slow.txt")
        aged(unfinished, 3 * 86400)
        aged(held, 3 * 86400)
        write_text(tmp_path / "quick.txt", "x")
        assert held.exists() and unfinished.exists()
    assert (tmp_path / "slow.txt").read_text() == "whole" and not held.exists()


def test_permission_that_is_lost_on_the_way_is_named_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    for name in ("link", "replace"):
        monkeypatch.setattr(outputs.os, name, refuse)
    (tmp_path / "b.txt").write_text("before")
    files = atomic_outputs(tmp_path, ("a.txt", "b.txt"), overwrite=True)
    with pytest.raises(OutputNotWritable, match="Permission denied"), files as unfinished:
        [path.write_text("new") for path in unfinished.values()]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"b.txt": "before"}


NAMESPACE = ("unshare", "--pid", "--fork")
HOST = """
import os, sys, time
from pathlib import Path
from solver_backend.exchange.outputs import write_text
assert os.getpid() == 1
end = time.monotonic() + 2.0
while time.monotonic() < end:
    write_text(Path(sys.argv[1]) / "x.txt", sys.argv[2] * 300_000, overwrite=True)
"""


@pytest.mark.skipif(
    not shutil.which("unshare") or subprocess.run([*NAMESPACE, "true"], capture_output=True).returncode != 0,
    reason="hosts of their own need a PID namespace each",
)
def test_hosts_whose_writers_have_the_same_pid_damage_no_read(tmp_path: Path) -> None:
    write_text(tmp_path / "x.txt", "a" * 300_000)
    hosts = [subprocess.Popen([*NAMESPACE, sys.executable, "-c", HOST, str(tmp_path), name]) for name in "abc"]
    reads = 0
    while any(host.poll() is None for host in hosts):
        text = (tmp_path / "x.txt").read_bytes()
        assert len(text) == 300_000 and len(set(text)) == 1
        reads += 1
    assert [host.returncode for host in hosts] == [0, 0, 0] and reads > 50
    assert names(tmp_path) == ["x.txt"]


def test_a_name_that_is_taken_meanwhile_is_kept(tmp_path: Path) -> None:
    with pytest.raises(OutputExists, match=r"already exist.*b\.txt"):
        write_while_b_is_taken(tmp_path, ("a.txt", "b.txt"))
    assert names(tmp_path) == ["b.txt"]
    assert (tmp_path / "b.txt").read_text() == "theirs"


def test_without_links_a_free_name_is_taken_and_a_taken_one_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(outputs.os, "link", no_links)
    write_text(tmp_path / "a.txt", "a")
    assert (tmp_path / "a.txt").read_text() == "a"
    with pytest.raises(OutputExists):
        write_while_b_is_taken(tmp_path, ("b.txt",))
    assert (tmp_path / "b.txt").read_text() == "theirs"
    assert names(tmp_path) == ["a.txt", "b.txt"]


def test_links_and_pipes_are_not_replaced(tmp_path: Path) -> None:
    target = write_text(tmp_path / "target.txt", "kept")
    (tmp_path / "link.txt").symlink_to(target)
    (tmp_path / "dangling.txt").symlink_to(tmp_path / "nowhere")
    os.mkfifo(tmp_path / "pipe")
    for name, what in (("link.txt", "a link"), ("dangling.txt", "a link"), ("pipe", "a device or a pipe")):
        with pytest.raises(OutputNotWritable, match=f"is {what}, which is not replaced"):
            write_text(tmp_path / name, "new", overwrite=True)
        with pytest.raises(OutputExists):
            check_output(tmp_path / name)
    with pytest.raises(OutputNotWritable, match="is a link"), atomic_outputs(tmp_path, ("link.txt",), overwrite=True):
        pass
    assert target.read_text() == "kept"
    assert (tmp_path / "link.txt").is_symlink()


def test_temporary_names_cannot_be_guessed_and_are_made_exclusively(tmp_path: Path) -> None:
    seen = set()
    for _ in range(3):
        with atomic_output(tmp_path / "x.txt") as temporary:
            lock = next(path for path in tmp_path.iterdir())
            assert lock.stat().st_mode & 0o077 == 0
            assert temporary.parent == tmp_path
            assert str(os.getpid()) != temporary.name.partition("_")[0].removeprefix(".part")
            seen.add(temporary.name)
    assert len(seen) == 3
