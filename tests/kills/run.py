"""One kill: the command is started, killed at a moment, looked at, started again, and looked at again."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from solver_backend.exchange.npz import read_npz
from solver_backend.exchange.outputs import is_leftover, sweep
from solver_backend.io.markers.read import read_markers
from solver_backend.io.png import read_png
from tests.kills.frames import lost_frames, recorded_frames
from tests.kills.moments import Moment, follow
from tests.kills.operation import Operation
from tests.kills.operations import solve_command, write_solved
from tests.kills.processes import MARK, wait_for_the_end
from tests.support.verb_inputs import PLAYED_OAK

ROOT = Path(__file__).resolve().parents[2]
_LONG_AGO_S = 120.0
_KEPT = ("already exist", "there already")
"""Of the sentences by which an operation refuses to replace what is whole."""
_BLEND_BEGINS = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")  # Plain, and packed by Zstandard or gzip.


@dataclass(frozen=True)
class Measured:
    """An operation that ended well once."""

    operation: Operation
    seconds: float
    files: frozenset[str]
    """Everything that then lay in its folder."""
    changes: int = 0
    """How often that folder changed meanwhile."""


def solved_folder(folder: Path) -> Path:
    """Return a new folder with a capture, its motion and its report."""
    folder.mkdir()
    write_solved(folder)
    subprocess.run(solve_command(folder), check=True, capture_output=True, cwd=ROOT, env=_environment(folder))
    return folder


def measure(operation: Operation, folder: Path, solved: Path) -> Measured:
    """Let the operation end well once, and note how long that took and what lies there then."""
    _prepared(operation, folder, solved)
    start = time.monotonic()
    process = _started(operation, folder)
    changes = follow(folder, lambda: process.poll() is not None)
    said = process.communicate()[1].decode("utf-8", "replace")
    if process.returncode:
        raise RuntimeError(f"{operation.name} ends undisturbed with exit code {process.returncode}: {said[-300:]}")
    seconds = time.monotonic() - start
    files = frozenset(contents(folder))
    if not operation.outputs <= files:
        raise RuntimeError(f"{operation.name} did not write {sorted(operation.outputs - files)}")
    return Measured(operation, seconds, files, changes)


def kill_once(measured: Measured, folder: Path, solved: Path, moment: Moment) -> tuple[str, list[str]]:
    """Kill the operation at a moment; return what was there then and everything that is wrong."""
    operation = measured.operation
    before = _prepared(operation, folder, solved)
    process = _started(operation, folder)
    follow(folder, lambda: process.poll() is not None, moment, measured.seconds)
    ended = process.poll() is not None
    process.kill()  # it alone, as a system short of memory does: what it has started must find out
    process.communicate()
    stuck = wait_for_the_end(str(folder))
    left, recorded = contents(folder), recorded_frames(folder)
    when = "after its end" if ended else f"with {len(operation.outputs & set(left))} of {len(operation.outputs)} files"
    wrong = [f"still running after its parent was killed: {command}" for command in stuck]
    wrong += [f"killed: {what}" for what in [*damaged(folder, left), *_changed(before, left, operation, folder)]]
    failed, kept = _resume(operation, folder, again=bool(operation.outputs & set(left)))
    wrong += [failed] if failed else []
    _age_leftovers(folder)
    after = contents(folder)
    wrong += [f"resumed: {what}" for what in [*damaged(folder, after), *_changed(before, after, operation, folder)]]
    wrong += lost_frames(folder, recorded)
    backups = _backups(left) | {name for name in after if re.fullmatch(operation.kept, name)}
    wrong += [
        f"{name} is not what was saved over" for name in _backups(left) & set(after) if after[name] != left[name[:-1]]
    ]
    expected = set(left) if kept and operation.begins_apart else measured.files
    lost, doubled = expected - set(after), set(after) - measured.files - backups
    wrong += [f"lost {name}" for name in sorted(lost)] + [f"doubled {name}" for name in sorted(doubled)]
    return when, wrong


def _backups(left: Mapping[str, str]) -> set[str]:
    """Return the names under which Blender keeps the files that it saves over."""
    return {f"{name}1" for name in left if name.endswith(".blend")}


def contents(folder: Path) -> dict[str, str]:
    """Return the hash of every file by its name; unfinished ones, whose names tell them, are left out."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not is_leftover(path.name) and not name.startswith("home/"):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def damaged(folder: Path, names: Mapping[str, str]) -> list[str]:
    """Return a sentence for each file that is not whole."""
    wrong = []
    for name in names:
        try:
            _require_whole(folder / name)
        except Exception as error:  # whatever a reader says of it
            wrong.append(f"{name} is damaged: {type(error).__name__}: {error}")
    return wrong


def _require_whole(path: Path) -> None:
    if path.suffix == ".npz":
        read_npz(path)
    elif path.suffix == ".json":
        json.loads(path.read_text(encoding="utf-8"))
    elif path.suffix == ".html" and not path.read_text(encoding="utf-8").rstrip().endswith("</html>"):
        raise ValueError("it does not end as a page does")
    elif path.suffix == ".c3d":
        read_markers(path)
    elif path.suffix == ".png":
        read_png(path)
    elif path.suffix == ".blend" and not path.read_bytes().startswith(_BLEND_BEGINS):
        raise ValueError("it does not begin as Blender's files do")


def _changed(before: Mapping[str, str], now: Mapping[str, str], operation: Operation, folder: Path) -> list[str]:
    """Return a sentence for each file that was there before, is none of the outputs, and is gone or another."""
    kept = {name: digest for name, digest in before.items() if name not in operation.outputs}
    gone = [f"{name} is gone" for name in before if name not in now]
    return gone + [f"{name} was changed" for name, digest in kept.items() if now.get(name, digest) != digest]


def _prepared(operation: Operation, folder: Path, solved: Path) -> dict[str, str]:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    operation.prepare(folder, solved)
    (folder / "home").mkdir(exist_ok=True)
    return contents(folder)


def _started(operation: Operation, folder: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, *operation.command], cwd=folder, env=_environment(folder), start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip


def _resume(operation: Operation, folder: Path, *, again: bool = False) -> tuple[str, bool]:
    """Run the operation to its end; return what went wrong, and whether it kept what was there, with exit code 3."""
    process = _started(operation, folder)
    said = process.communicate()[1].decode("utf-8", "replace")
    kept = again and process.returncode == 3 and any(words in said for words in _KEPT)
    failed = "" if kept or process.returncode == 0 else f"resumed with exit code {process.returncode}: {said[-300:]}"
    return failed, kept


def _age_leftovers(folder: Path) -> None:
    """Let every unfinished file be as old as those that the next run removes, and remove them as it would."""
    then = time.time() - _LONG_AGO_S
    folders = {path.parent for path in folder.rglob("*") if is_leftover(path.name)}
    for path in [path for path in folder.rglob("*") if is_leftover(path.name)]:
        os.utime(path, (then, then))
    for parent in folders:
        sweep(parent)


def _environment(folder: Path) -> dict[str, str]:
    own = {"PYTHONPATH": f"{ROOT}{os.pathsep}{PLAYED_OAK}", "HOME": str(folder / "home"), MARK: str(folder)}
    return os.environ | own | {"PYTHONDONTWRITEBYTECODE": "1"}
