"""Running a verb in this process as the command line runs it, and looking at what it leaves behind."""

from __future__ import annotations

import argparse
import io
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import lru_cache
from pathlib import Path
from unittest import mock

from solver_backend.cli import live_sources
from solver_backend.cli.main import function_of
from solver_backend.cli.program import parse
from solver_backend.exchange.command import Report
from solver_backend.exchange.errors import MocapError, NoDetections
from solver_backend.exchange.outputs import is_leftover
from solver_backend.exchange.progress import silent
from tests.fuzz.target import Target, Write
from tests.kills.run import damaged

LIMIT_S = 20.0  # CPU seconds that an input of a verb may take.
SENSE = 0.8
"""Share of changes that a verb's input is read with; the others stop at the reader, where a million were tried."""


def verb_target(
    name: str, writes: Sequence[Write], run: Callable[[Path], object], kinds: dict[str, str],
    odd: Sequence[Write] = (),
) -> Target:  # fmt: skip
    """Return a verb as what is attacked; ``kinds`` as in ``Target``."""
    return Target(f"verb {name}", tuple(writes), run, kinds, tuple(odd), limit_s=LIMIT_S, sense=SENSE)


def verb(line: str) -> Callable[[Path], object]:
    """Return what runs a command line in a folder, and takes away what it writes; see ``run_verb``."""

    def run(folder: Path) -> object:
        with nothing_left(folder):
            return run_verb(folder, line)

    return run


def run_verb(folder: Path, line: str) -> object:
    """Run a verb and report its outcome, or its error, as both kinds of reports do.

    Args:
        folder: of its files, whose names begin with ``./`` in the line.
        line: verb and arguments, blanks between.
    """
    words = tuple(str(folder / word[2:]) if word.startswith("./") else word for word in line.split())
    reports = [Report(io.StringIO(), io.StringIO(), as_json=as_json) for as_json in (False, True)]
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        try:
            # What makes a live run ready takes longer than a short run, and what it freezes is never freed.
            with mock.patch.object(live_sources, "make_ready"):
                args = argparse.Namespace(**vars(_parsed(*words)))
                outcome = function_of(args.verb)(args, silent)
        except MocapError as error:
            for report in reports:
                report.error(error)
            raise
        for report in reports:
            report.result(outcome.data, outcome.text, outcome.summary)
    return outcome


@lru_cache(maxsize=512)
def _parsed(*words: str) -> argparse.Namespace:
    """Return a parsed command line; the parser of all verbs takes as long as many an input."""
    return parse(list(words))


@contextmanager
def nothing_left(folder: Path) -> Iterator[None]:
    """Take away what a verb writes into a folder, and raise ``AssertionError`` where something is not whole."""
    before = {path: path.stat().st_mtime_ns for path in _files(folder)}
    try:
        yield
    finally:
        after = {path: path.stat().st_mtime_ns for path in _files(folder)}
        new = [path for path in after if path not in before]
        wrong = _not_whole(folder, new) + [f"{path.name} is gone" for path in before.keys() - after.keys()]
        wrong += [f"{path.name} was changed" for path in before.keys() & after.keys() if after[path] != before[path]]
        _remove(folder, new)
        if wrong:
            raise AssertionError("; ".join(wrong))


@contextmanager
def in_a_copy(folder: Path) -> Iterator[Path]:
    """Yield a copy of a folder for a verb that replaces its files, and raise where one of them is not whole."""
    copy = folder.with_name(f"{folder.name}_copy")
    shutil.copytree(folder, copy)
    try:
        yield copy
        before = {path.relative_to(folder) for path in _files(folder)}
        if wrong := _not_whole(copy, [path for path in _files(copy) if path.relative_to(copy) not in before]):
            raise AssertionError("; ".join(wrong))
    finally:
        shutil.rmtree(copy)


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def _not_whole(folder: Path, files: list[Path]) -> list[str]:
    names = [path.relative_to(folder).as_posix() for path in files]
    left = [name for name in names if is_leftover(Path(name).name)]
    broken = damaged(folder, {name: "" for name in names if name not in left})
    # Of a take that shows nobody, markers that nobody sees are written.
    return [f"{name} was left" for name in left] + [what for what in broken if NoDetections.__name__ not in what]


def _remove(folder: Path, files: list[Path]) -> None:
    for path in files:
        path.unlink()
        for parent in path.parents:
            if parent == folder or any(parent.iterdir()):
                break
            parent.rmdir()


@contextmanager
def standard_input(path: Path | None) -> Iterator[None]:
    """Let a file come by standard input."""
    if path is None:
        yield
        return
    with path.open("rb") as stream, mock.patch.object(sys, "stdin", stream):
        yield
