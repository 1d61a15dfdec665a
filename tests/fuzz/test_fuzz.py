"""A short run of the fuzzing that ``python -m tests.fuzz`` does at length, and what it found before."""

from __future__ import annotations

import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import MocapError
from tests.fuzz.mutations import mutated
from tests.fuzz.run import GOOD, fuzz, table
from tests.fuzz.targets import TARGETS, Target

CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())


def test_every_reader_bears_mutated_files() -> None:
    tried = fuzz(TARGETS, 360, seed=2026)
    assert {reader for reader, _ in tried.counts} == {target.name for target in TARGETS}
    assert {outcome for _, outcome in tried.counts} == set(GOOD), table(tried)


def test_the_sound_files_are_read(tmp_path: Path) -> None:
    for number, target in enumerate(TARGETS):
        folder = tmp_path / str(number)
        folder.mkdir()
        target.write(folder)
        target.read(folder)


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_what_was_found_before_is_named(path: Path, tmp_path: Path) -> None:
    """A file ``<reader>--<number>.<ending>`` stands in for the sound file of that reader."""
    name = path.name.partition("--")[0].replace("_", " ")
    target = next(t for t in TARGETS if t.name.replace(",", "").replace(".", "") == name)
    replayed = Target(target.name, lambda folder: _with(target, folder, path), target.read, target.kinds)
    home = tmp_path / "home"
    home.mkdir()
    replayed.write(home)
    with suppress(MocapError):
        target.read(home)


def _with(target: Target, folder: Path, path: Path) -> None:
    target.write(folder)
    sound = next(p for p in sorted(folder.rglob("*")) if p.suffix == path.suffix)
    shutil.copyfile(path, sound)


def test_mutations_are_the_same_for_a_seed() -> None:
    for kind in ("text", "json", "npz", "bytes"):
        data = b'{"a": [1, 2.5, "x"], "b": {"c": null}}'
        first, second = (mutated(data, kind, np.random.default_rng(5)) for _ in range(2))
        assert first == second


def test_a_reader_that_breaks_is_seen(tmp_path: Path) -> None:
    def breaks(folder: Path) -> None:
        raise ZeroDivisionError("by design")

    bad = Target("bad", lambda folder: (folder / "a.txt").write_text("1") and None, breaks, {".txt": "text"})
    tried = fuzz((bad,), 3, seed=0)
    assert tried.counts == {("bad", "unnamed"): 3}
    assert "ZeroDivisionError" in table(tried)


def test_the_command_prints_the_table_and_exits_with_0() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--count", "20", "--only", "job"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].split()[:1] == ["all"]
