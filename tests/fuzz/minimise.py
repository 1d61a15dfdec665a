"""The smallest part of the corpus, and of new inputs, that reaches every line which all of them reach."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.fuzz.corpus import FOLDER, corpus_files, file_name_of, put_in_place
from tests.fuzz.reader_coverage import TracedLines, reader_files
from tests.fuzz.run import drawn_input, how_it_ends, scratch_folder
from tests.fuzz.target import Target
from tests.fuzz.tried import GOOD

_LARGEST = 8_192  # Bytes of a new file: the corpus is a part of every clone.
BY_LINES = "lines"
"""How the number of a file begins that is kept for the lines it reaches; others broke a reader once, and stay."""
Lines = frozenset[tuple[str, int]]


@dataclass(frozen=True)
class Kept:
    """What a reader's corpus became."""

    reader: str
    sound: int
    """Lines that the sound file reaches."""
    added: int
    """Lines that the corpus reaches beside them."""
    files: tuple[str, ...]
    """Names of the files that are kept for their lines."""


def minimise(targets: Sequence[Target], count: int, seed: int, mutator: str, corpus: Path = FOLDER) -> list[Kept]:
    """Keep of each reader's corpus, and of ``count`` new inputs, the fewest files that reach all the lines (greedily).

    Args:
        targets: the readers.
        count: new inputs a reader.
        seed: of the mutations.
        mutator: what makes them.
        corpus: the folder, which is changed.
    """
    return [_of_reader(target, count, seed, mutator, corpus) for target in targets]


def cover(candidates: dict[str, Lines], reached: Lines) -> list[str]:
    """Return names of candidates, the one that adds most lines first, until none adds any."""
    chosen, rest = list[str](), {name: lines - reached for name, lines in candidates.items()}
    while rest and (best := max(rest, key=lambda name: (len(rest[name]), name))) and rest[best]:
        chosen.append(best)
        gained = rest[best]
        rest = {name: lines - gained for name, lines in rest.items()}
    return chosen


def _of_reader(target: Target, count: int, seed: int, mutator: str, corpus: Path) -> Kept:
    files = {path.name: path.read_bytes() for _, path in corpus_files([target], corpus)}
    begin = f"{file_name_of(target)}--"
    faults = {name for name in files if not name.startswith(f"{begin}{BY_LINES}")}
    with scratch_folder() as folder:
        sound = folder / "sound"
        sound.mkdir()
        target.dialects[0](sound)
        first = {p.suffix: p for p in sorted(sound.rglob("*"), reverse=True) if p.suffix in target.kinds}
        for number in range(count):
            rng = np.random.default_rng([seed, number])
            suffix = sorted(first)[int(rng.integers(len(first)))]
            content = drawn_input(mutator, first[suffix].read_bytes(), target.kinds[suffix], rng, number)
            if len(content) <= _LARGEST:
                files[f"{begin}{BY_LINES}_{seed}_{number}{suffix}"] = content
        reached = _lines_of(target, sound)
        found = {name: _lines_of_file(target, name, content, folder) for name, content in files.items()}
    base = reached.union(*(found[name] for name in faults))
    chosen = cover({name: lines for name, lines in found.items() if name not in faults}, base)
    for name in set(files) - faults - set(chosen):
        (corpus / name).unlink(missing_ok=True)
    for name in chosen:
        (corpus / name).write_bytes(files[name])
    whole = base.union(*(found[name] for name in chosen))
    return Kept(target.name, len(reached), len(whole - reached), tuple(chosen))


def _lines_of_file(target: Target, name: str, content: bytes, folder: Path) -> Lines:
    """Return the lines that a file reaches in the place of the sound one."""
    home = folder / f"home of {name}"
    home.mkdir()
    path = folder / f"a{Path(name).suffix}"
    path.write_bytes(content)
    put_in_place(target, path, home)
    return _lines_of(target, home)


def _lines_of(target: Target, home: Path) -> Lines:
    lines = TracedLines(reader_files())
    before = sys.gettrace()
    sys.settrace(lines)
    try:
        outcome, where = how_it_ends(target, home)
    finally:
        sys.settrace(before)
    if outcome not in GOOD:
        raise RuntimeError(f"{target.name} broke: {where}")
    return Lines((name, line) for name, seen in lines.seen.items() for line in seen)
