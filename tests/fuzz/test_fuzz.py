"""A short run of the fuzzing that ``python -m tests.fuzz`` does at length, and what it found before."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from blender_addon._exchange.errors import MocapError as AddonError
from solver_backend.exchange.errors import MocapError
from tests.fuzz import campaign as campaigns
from tests.fuzz.campaign import campaign
from tests.fuzz.corpus import corpus_files, put_in_place
from tests.fuzz.mutations import mutated
from tests.fuzz.run import fuzz
from tests.fuzz.sense import broken_sense
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS, chosen
from tests.fuzz.tried import GOOD, Tried
from tests.fuzz.verbs.running import nothing_left

CORPUS = corpus_files(TARGETS)
ROOT = Path(__file__).parents[2]
READERS = chosen("readers")
QUICK = [target for target in chosen("verb") if target.weight >= 20]
"""Verbs of which an input takes some 20 ms."""


def test_every_reader_bears_mutated_files() -> None:
    tried = fuzz(READERS, sum(target.weight for target in READERS), seed=2026)
    assert {reader for reader, *_ in tried.counts} == {target.name for target in READERS}
    assert {outcome for *_, outcome in tried.counts} == set(GOOD), tried.table()


@pytest.mark.parametrize("targets", [QUICK, pytest.param(chosen("verb"), marks=pytest.mark.slow)], ids=["quick", "all"])
def test_verbs_bear_files_whose_meaning_is_broken(targets: list[Target]) -> None:
    tried = fuzz(targets, sum(target.weight for target in targets) // 10, seed=2026)
    assert {outcome for *_, outcome in tried.counts} == set(GOOD), tried.table()


@pytest.mark.parametrize(
    "target",
    [
        pytest.param(t, marks=[pytest.mark.slow] * (t.name.startswith(("OpenPose trial", "verb")) and t not in QUICK))
        for t in TARGETS
    ],
    ids=lambda target: target.name,
)
def test_the_sound_files_are_read_and_the_odd_ones_are_read_or_named(target: Target, tmp_path: Path) -> None:
    for number, write in enumerate((*target.dialects, *target.once)):
        folder = tmp_path / str(number)
        folder.mkdir()
        write(folder)
        assert number >= len(target.dialects) or any(file.suffix in target.kinds for file in folder.rglob("*"))
        with suppress(*((MocapError, AddonError) if number >= len(target.sound) else ())):
            target.read(folder)


@pytest.mark.parametrize(("target", "path"), CORPUS, ids=lambda value: getattr(value, "name", None))
def test_what_was_found_before_is_named(target: Target, path: Path, tmp_path: Path) -> None:
    put_in_place(target, path, tmp_path)
    with suppress(MocapError, AddonError):
        target.read(tmp_path)


def test_every_file_of_the_corpus_has_a_reader() -> None:
    assert len(CORPUS) == len(list((Path(__file__).parent / "corpus").iterdir()))


@pytest.mark.parametrize("kind", ["text", "json", "npz", "pickle", "binary"])
def test_mutations_are_the_same_for_a_seed(kind: str) -> None:
    data = b'{"a": [1, 2.5, "x"], "b": {"c": null}}'
    first, second = (mutated(data, kind, np.random.default_rng(5)) for _ in range(2))
    assert first == second


def stand_in(read: object) -> Target:
    return Target("bad", (lambda folder: (folder / "a.txt").write_text("1"),), read, {".txt": "text"})


def test_a_reader_that_breaks_is_seen() -> None:
    def breaks(folder: Path) -> None:
        raise ZeroDivisionError("by design")

    tried = fuzz((stand_in(breaks),), 3, seed=0)
    assert tried.counts == {("bad", "changes", "unnamed"): 3}
    assert tried.broke
    assert "ZeroDivisionError" in tried.table()


def test_what_would_stand_on_the_console_is_seen() -> None:
    tried = fuzz((stand_in(lambda folder: np.log(np.zeros(1))),), 2, seed=0)
    assert tried.counts == {("bad", "changes", "warned"): 2} and "divide by zero" in tried.table()


def test_what_is_left_half_written_is_seen(tmp_path: Path) -> None:
    def write_badly() -> None:
        with nothing_left(tmp_path):
            (tmp_path / "kept.txt").unlink()
            (tmp_path / "a.json").write_text("[")

    (tmp_path / "kept.txt").write_text("1")
    with pytest.raises(AssertionError, match=r"a\.json is damaged.*kept\.txt is gone"):
        write_badly()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["npz", "json", "text"])
def test_broken_sense_is_well_formed(kind: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", xy=np.zeros((6, 17, 2)), names=np.array(["a", "b"]), fps=np.array(30.0))
    sound = {"npz": (tmp_path / "a.npz").read_bytes(), "json": b'{"a": [1, 2.5], "b": 3}', "text": b"a = 1.5\nb = 2\n"}
    changed = [broken_sense(sound[kind], kind, np.random.default_rng(k)) for k in range(20)]
    assert changed == [broken_sense(sound[kind], kind, np.random.default_rng(k)) for k in range(20)]
    assert sum(data != sound[kind] for data in changed) > 12
    for data in changed:
        parse = {"npz": lambda d: dict(np.load(io.BytesIO(d))), "json": json.loads, "text": bytes.decode}[kind]
        parse(data)


@pytest.mark.slow
def test_an_input_that_ends_its_process_is_counted_with_those_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every third input kills the child; a stand-in of its program does what ``python -m tests.fuzz --child`` does."""
    program = (
        "import os, signal, sys; from pathlib import Path; from tests.fuzz.campaign import run_child\n"
        "from tests.fuzz.test_fuzz import stand_in\n"
        "given = dict(zip(sys.argv[3::2], sys.argv[4::2]))\n"
        "place = Path(given['--child']) / 'current'\n"
        "def read(folder):\n"
        "    if int(place.read_text().split()[0]) % 3 == 2: os.kill(os.getpid(), signal.SIGKILL)\n"
        "run_child((stand_in(read),), int(given['--count']), 0, int(given['--first']), Path(given['--child']))\n"
    )
    popen = subprocess.Popen
    monkeypatch.setattr(
        campaigns.subprocess, "Popen", lambda command: popen([command[0], "-c", program, "-m", *command[2:]], cwd=ROOT)
    )
    seen: list[int] = []
    tried = campaign(Tried(), 5, 0, 0, "", lambda whole, following: seen.append(following))
    assert tried.counts == {("bad", "changes", "read"): 4, ("bad", "changes", "crash"): 1}
    assert seen == [3, 5]
    assert f"ended with {-signal.SIGKILL}" in tried.table()


@pytest.mark.slow
def test_the_command_prints_its_table_as_it_goes_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    command = [sys.executable, "-m", "tests.fuzz", "--only", "job", "--state", str(state), "--count"]
    for count in (20, 50):
        done = subprocess.run([*command, str(count)], capture_output=True, text=True, check=False, cwd=ROOT)
        assert done.returncode == 0, done.stdout + done.stderr
        assert done.stdout.splitlines()[-2].startswith(f"{count} inputs")
    whole = Tried.load(state)[0].counts
    assert whole == fuzz([t for t in TARGETS if t.name.startswith("job")], 50, seed=0).counts


@pytest.mark.slow
def test_the_table_of_reached_lines() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--coverage", "--only", "job", "--count", "20"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    rows = {line.split()[0]: float(line.split()[2]) for line in done.stdout.splitlines()}
    assert rows["solver_backend/job.py"] > 70
    assert rows["solver_backend/io/motions/bvh.py"] == 0


@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris is not installed in this Python")
def test_atheris_changes_bytes() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--bytes", "3", "--only", "job"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=dict(os.environ))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "job file" in done.stdout
