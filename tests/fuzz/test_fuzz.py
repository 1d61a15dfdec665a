"""A short run of the fuzzing that ``python -m tests.fuzz`` does at length, and what it found before."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from contextlib import nullcontext, suppress
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from blender_addon._exchange.errors import MocapError as AddonError
from solver_backend.exchange.errors import MocapError
from tests.fuzz import driver
from tests.fuzz.corpus import corpus, cover, files_of, put_in_place, smallest, write_corpus
from tests.fuzz.driver import CHANGES, MUTATORS, campaign, drawn_input, fuzz, how_it_ends, in_worker
from tests.fuzz.mutations import mutated
from tests.fuzz.sense import broken_sense
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS, chosen
from tests.fuzz.tried import GOOD, Tried
from tests.fuzz.verbs.running import nothing_left

ROOT = Path(__file__).parents[2]
READERS = chosen("readers")
QUICK = [
    chosen(f"verb {name}")[0]
    for name in (
        "studio, plan", "markers layout", "live, motion", "markers export", "motion convert", "motion, skeleton",
        "motion, AMASS", "hands add", "hands add, MANUS", "motion props", "board",
    )
]  # fmt: skip
"""Verbs of which an input takes some 20 ms."""


def outcomes(targets: list[Target], each: int) -> Tried:
    """Try the first inputs of each target."""
    whole = Tried()
    for target in targets:
        whole.add(fuzz(target, each, seed=2026))
    return whole


def test_every_reader_bears_mutated_files() -> None:
    tried = outcomes(READERS, 6)
    assert {key.split("|")[0] for key in tried.counts} == {target.name for target in READERS}
    assert not tried.broke, tried.table()


@pytest.mark.parametrize("targets", [QUICK, pytest.param(chosen("verb"), marks=pytest.mark.slow)], ids=["quick", "all"])
def test_verbs_bear_files_whose_meaning_is_broken(targets: list[Target]) -> None:
    tried = outcomes(targets, 3)
    assert not tried.broke, tried.table()


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


@pytest.mark.parametrize("target", [target for target in TARGETS if files_of(target)], ids=lambda target: target.name)
def test_what_was_found_before_is_named(target: Target, tmp_path: Path) -> None:
    for number, (name, content) in enumerate(files_of(target).items()):
        home = tmp_path / str(number)
        home.mkdir()
        put_in_place(target, name, content, home)
        ended, where = how_it_ends(target, home)
        assert ended in GOOD, f"{name}: {where}"


def test_every_file_of_the_corpus_has_a_reader() -> None:
    assert sum(len(files_of(target)) for target in TARGETS) == len(corpus()) > 300


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

    tried = fuzz(stand_in(breaks), 2 * len(MUTATORS), seed=0)
    assert tried.counts == {f"bad|{name}|unnamed": 2 * MUTATORS.count(name) for name in MUTATORS}
    assert tried.broke
    assert "ZeroDivisionError" in tried.table()


def test_what_would_stand_on_the_console_is_seen() -> None:
    tried = fuzz(stand_in(lambda folder: np.log(np.zeros(1))), 1, seed=0)
    assert tried.counts == {f"bad|{CHANGES}|warned": 1} and "divide by zero" in tried.table()


def test_a_file_has_pieces_of_others() -> None:
    rng = np.random.default_rng(1)
    made = [drawn_input(driver.SPLICE, bytes(50), "text", rng) for _ in range(20)]
    assert sum(any(data) for data in made) > 10


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


def test_an_input_that_ends_its_worker_is_counted_with_those_before_it() -> None:
    tried = in_worker(stand_in(lambda folder: None), 0, 2, 0)

    def dies(folder: Path) -> None:
        tried.count("", "", "read")
        if tried.total == 5:
            os.kill(os.getpid(), signal.SIGKILL)

    part = in_worker(stand_in(dies), 7, 5, 0)
    assert part.total == 3 and part.following == {"bad": 10} and f"ended with {-signal.SIGKILL}" in part.table()
    assert sorted(key.rpartition("|")[2] for key in part.counts) == ["crash", "read", "read"]


def test_what_takes_more_memory_than_the_limit_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = in_worker(stand_in(lambda folder: bytearray(3 * 2**30)), 0, 1, 0)
    assert "MemoryError" in tried.table() and tried.broke


def test_a_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    state, targets = tmp_path / "state.json", chosen("job of")
    for count in (20, 50):
        campaign(targets, Tried.load(state), count, 0, lambda whole: whole.save(state), 60.0)
    assert Tried.load(state).counts == fuzz(targets[0], 50, seed=0).counts
    assert campaign(targets, Tried.load(state), 50, 0, lambda whole: None, 60.0).following == {"job of a batch": 50}


@pytest.mark.slow
def test_the_command_prints_its_table() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--only", "job of", "--count", "20"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0 and done.stdout.splitlines()[-1].startswith("20 inputs"), done.stdout + done.stderr


def test_inputs_of_atheris_go_into_the_corpus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Atheris itself is not needed for that."""
    stand_in_module = SimpleNamespace(instrument_imports=lambda include: nullcontext())
    if find_spec("atheris") is None:
        monkeypatch.setitem(sys.modules, "atheris", stand_in_module)
    from tests.fuzz import guided

    (target,), written = chosen("job of"), dict[str, bytes]()
    (tmp_path / "found").mkdir()
    for number in range(3):
        (tmp_path / "found" / f"input_{number}").write_bytes(bytes(2) + b'{"a": %d}' % number)
    monkeypatch.setattr(guided, "write_corpus", written.update)
    kept = guided._grown(target, tmp_path)
    assert len(list((tmp_path / "found").iterdir())) == 3
    assert kept == sum(name.startswith("job_of_a_batch--") for name in written) > 0


@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris is not installed in this Python")
def test_atheris_changes_bytes() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--guided", "3", "--only", "job of"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "job of a batch" in done.stdout


def test_a_cover_needs_every_file_it_keeps() -> None:
    lines = {"a": frozenset({("x", 1), ("x", 2)}), "b": frozenset({("x", 2)}), "c": frozenset({("x", 3)})}
    assert cover(lines, frozenset()) == ["a", "c"]
    assert cover(lines, frozenset({("x", 1), ("x", 2), ("x", 3)})) == []


def test_the_corpus_is_minimised_and_faults_stay(tmp_path: Path) -> None:
    (target,) = chosen("clocks")
    rng = np.random.default_rng(1)
    files = files_of(target)
    new = {f"clocks--lines_{k}.json": mutated(next(iter(files.values())), "json", rng) for k in range(20)}
    kept = smallest(target, files | new | files, lambda home: how_it_ends(target, home), tmp_path)
    assert len(kept) < len(files | new) and "clocks--names.json" in kept


def test_equal_files_make_an_equal_corpus(tmp_path: Path) -> None:
    for name in ("a.zip", "b.zip"):
        write_corpus({"b--1.txt": b"1", "a--2.txt": b"2"}, tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert corpus(tmp_path / "a.zip") == {"a--2.txt": b"2", "b--1.txt": b"1"}
