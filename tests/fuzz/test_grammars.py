"""Documents by grammar are well-formed, differ, and are the same for a number; the corpus is as small as it can be."""

from __future__ import annotations

import io
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.fuzz.corpus import corpus_files
from tests.fuzz.grammars.document import document
from tests.fuzz.minimise import cover, minimise
from tests.fuzz.run import CHANGES, GRAMMAR, fuzz
from tests.fuzz.targets import TARGETS
from tests.fuzz.tried import GOOD, OUTCOMES, Tried

COUNT = 40


def _npz() -> bytes:
    out = io.BytesIO()
    np.savez(out, a=np.arange(6.0).reshape(2, 3), b=np.array("x"))
    return out.getvalue()


def _load(data: bytes) -> object:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


SOUND: dict[str, tuple[str, bytes, Callable[[bytes], object]]] = {
    "JSON": ("json", b'{"a": [1, 2.5, "x"], "b": {"c": null}}', json.loads),
    "TOML": ("text", b'[cam]\nname = "a"\nmatrix = [[1.0, 2.0], [3.0, 4.0]]\n', lambda d: tomllib.loads(d.decode())),
    "XML": ("text", b'<calibration><camera name="a" fov="40">text</camera></calibration>', ElementTree.fromstring),
    "npz": ("npz", _npz(), _load),
}


@pytest.mark.parametrize("name", SOUND)
def test_documents_are_well_formed_mostly_and_differ(name: str) -> None:
    kind, sound, parse = SOUND[name]
    drawn = [document(sound, kind, np.random.default_rng([1, k])) for k in range(COUNT)]
    assert drawn == [document(sound, kind, np.random.default_rng([1, k])) for k in range(COUNT)]
    assert len(set(drawn)) > COUNT / 8
    parsed = 0
    for data in drawn:
        try:
            parse(data)
        except (ValueError, ElementTree.ParseError):
            continue
        parsed += 1
    assert parsed > 0.6 * COUNT


def test_readers_bear_documents_by_grammar() -> None:
    readers = [target for target in TARGETS if not target.name.startswith(("verb", "body"))]
    tried = fuzz(readers, 200, seed=2026, mutator=GRAMMAR)
    assert {outcome for *_, outcome in tried.counts} <= set(GOOD), tried.table()
    assert {mutator for _, mutator, _ in tried.counts} == {GRAMMAR}


def test_counts_are_kept_by_reader_mutator_and_outcome(tmp_path: Path) -> None:
    tried = Tried()
    for mutator, outcome in ((CHANGES, "read"), (GRAMMAR, "read"), (GRAMMAR, "named")):
        tried.count("a", mutator, outcome)
    tried.save(tmp_path / "state.json", 5, 9)
    again, seed, following = Tried.load(tmp_path / "state.json")
    assert (again.counts, seed, following) == (tried.counts, 5, 9)
    rows = [line.split() for line in tried.table().splitlines()]
    assert ["all", GRAMMAR, *("1" if outcome in GOOD else "0" for outcome in OUTCOMES)] in rows


def test_a_cover_needs_every_file_it_keeps() -> None:
    lines = {"a": frozenset({("x", 1), ("x", 2)}), "b": frozenset({("x", 2)}), "c": frozenset({("x", 3)})}
    assert cover(lines, frozenset()) == ["a", "c"]
    assert cover(lines, frozenset({("x", 1), ("x", 2), ("x", 3)})) == []


def test_the_corpus_is_minimised_and_faults_stay(tmp_path: Path) -> None:
    (target,) = [target for target in TARGETS if target.name == "clocks"]
    for _, path in corpus_files([target]):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    before = {path.name for path in tmp_path.iterdir()}
    (first,) = minimise([target], 30, 1, CHANGES, tmp_path)
    assert first.files and first.added > 0
    assert {path.name for path in tmp_path.iterdir()} == before | set(first.files)
    (again,) = minimise([target], 0, 1, CHANGES, tmp_path)
    assert set(again.files) == set(first.files) and again.added == first.added
