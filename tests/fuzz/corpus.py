"""The regression corpus: files that broke a reader once, and those that reach lines which mutations seldom do.

A file ``<reader>--<number>.<ending>`` stands in for the sound file of that reader.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.target import Target

FOLDER = Path(__file__).parent / "corpus"


def corpus_files(targets: Sequence[Target], folder: Path = FOLDER) -> list[tuple[Target, Path]]:
    """Return the files of the corpus, or of another folder of such files, each with its reader."""
    by_name = {file_name_of(target): target for target in targets}
    found = [(by_name.get(path.name.partition("--")[0]), path) for path in sorted(folder.iterdir())]
    return [(target, path) for target, path in found if target is not None]


def file_name_of(target: Target) -> str:
    """Return how the names of a reader's files in the corpus begin."""
    return target.name.replace(",", "").replace(".", "").replace(" ", "_")


def put_in_place(target: Target, path: Path, home: Path) -> None:
    """Write the reader's sound files into a folder, and a file of the corpus over the first of its kind."""
    target.sound[0](home)
    sound = next(p for p in sorted(home.rglob("*")) if p.suffix == path.suffix)
    shutil.copyfile(path, sound)
