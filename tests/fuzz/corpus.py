"""The regression corpus: files that broke a reader once, and those that reach lines which mutations seldom do.

It is one archive. A member ``<target>--<name>.<ending>`` stands in for the first sound file of that ending. The corpus
is kept small: ``smallest`` chooses the files that reach all the lines which any of them reaches.
"""

from __future__ import annotations

import shutil
import sys
import zipfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from solver_backend.exchange.outputs import atomic_output
from tests.fuzz.target import Target

ARCHIVE = Path(__file__).with_name("corpus.zip")
LARGEST = 8_192  # Bytes of a file that is kept for its lines: the corpus is a part of every clone.
BY_LINES = "lines"
"""How the name of a file begins that is kept for the lines it reaches; others broke a reader once, and stay."""
_PRODUCT = tuple(str(Path(__file__).resolve().parents[2] / name) for name in ("solver_backend", "blender_addon"))
Lines = frozenset[tuple[str, int]]


@lru_cache
def corpus(archive: Path = ARCHIVE) -> dict[str, bytes]:
    """Return the files of the corpus by their names."""
    with zipfile.ZipFile(archive) as files:
        return {name: files.read(name) for name in sorted(files.namelist())}


def write_corpus(files: dict[str, bytes], archive: Path = ARCHIVE) -> None:
    """Write the corpus. Equal files make an equal archive."""
    deflated = zipfile.ZIP_DEFLATED
    with atomic_output(archive, overwrite=True) as path, zipfile.ZipFile(path, "w", deflated, compresslevel=9) as out:
        for name in sorted(files):
            out.writestr(zipfile.ZipInfo(name), files[name], deflated)
    corpus.cache_clear()


def files_of(target: Target, archive: Path = ARCHIVE) -> dict[str, bytes]:
    """Return the files of the corpus that a target reads."""
    return {name: data for name, data in corpus(archive).items() if name.partition("--")[0] == file_name_of(target)}


def file_name_of(target: Target) -> str:
    """Return how the names of a target's files in the corpus begin."""
    return "".join("_" if mark in " /" else mark for mark in target.name if mark not in ",.'")


def put_in_place(target: Target, name: str, content: bytes, home: Path) -> None:
    """Write files of the first dialect with this ending into a folder, and a file of the corpus over the first one."""
    for write in target.dialects:
        write(home)
        if found := [path for path in sorted(home.rglob("*")) if path.suffix == Path(name).suffix]:
            found[0].write_bytes(content)
            return
        shutil.rmtree(home)
        home.mkdir()
    raise ValueError(f"{target.name} reads no file like {name}.")


def smallest(
    target: Target, files: dict[str, bytes], ends: Callable[[Path], tuple[str, str]], folder: Path
) -> dict[str, bytes]:
    """Return the files that broke the target once, and the fewest others that reach all lines which any file reaches.

    Args:
        target: what reads the files.
        files: those of the corpus and new ones, by name.
        ends: reads a folder, and returns how that ends.
        folder: empty one for the files.
    """
    found: dict[str, Lines] = {}
    for number, (name, content) in enumerate(files.items()):
        home = folder / str(number)
        home.mkdir()
        put_in_place(target, name, content, home)
        found[name] = lines_of(lambda home=home: ends(home))  # type: ignore[misc]
    faults = {name for name in files if not name.partition("--")[2].startswith(BY_LINES)}
    sound = folder / "sound"
    sound.mkdir()
    (target.sound or target.odd)[0](sound)
    base = lines_of(lambda: ends(sound)).union(*(found[name] for name in faults))
    kept = faults | set(cover({name: lines for name, lines in found.items() if name not in faults}, base))
    return {name: files[name] for name in sorted(kept)}


def cover(candidates: dict[str, Lines], reached: Lines) -> list[str]:
    """Return names of candidates, the one that adds most lines first, until none adds any."""
    chosen, rest = list[str](), {name: lines - reached for name, lines in candidates.items()}
    while rest and (best := max(rest, key=lambda name: (len(rest[name]), name))) and rest[best]:
        chosen.append(best)
        gained = rest[best]
        rest = {name: lines - gained for name, lines in rest.items()}
    return chosen


def lines_of(read: Callable[[], object]) -> Lines:
    """Return the lines of the product that run; a function whose lines were all seen costs no more time."""
    missing: dict[CodeType, set[int]] = {}
    seen: set[tuple[str, int]] = set()

    def call(frame: FrameType, event: str, argument: Any) -> Any:
        code = frame.f_code
        if not code.co_filename.startswith(_PRODUCT):
            return None
        left = missing.setdefault(code, {line for *_, line in code.co_lines() if line} - {code.co_firstlineno})

        def line(frame: FrameType, event: str, argument: Any) -> Any:
            seen.add((code.co_filename, frame.f_lineno))
            left.discard(frame.f_lineno)
            return line if left else None

        return line if left else None

    before = sys.gettrace()
    sys.settrace(call)
    try:
        read()
    finally:
        sys.settrace(before)
    return frozenset(seen)
