"""Bytes changed by what atheris (libFuzzer) sees executed in the readers, each reader in a process of its own."""

from __future__ import annotations

import multiprocessing
import resource
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from tests.fuzz.campaign import MEMORY_BYTES
from tests.fuzz.corpus import corpus_files
from tests.fuzz.run import LIMIT_S, Homes, how_it_ends, scratch_folder
from tests.fuzz.target import Target
from tests.fuzz.tried import GOOD

WHY_NOT = "" if find_spec("atheris") is not None else "atheris is not installed in this Python"
_LARGEST = 20_000
"""Bytes of an input."""


class Broke(Exception):
    """A reader neither read nor named what was wrong."""


def fuzz_bytes(targets: Sequence[Target], seconds: float) -> int:
    """Fuzz each reader for its share of the time, print how it ended, and return 1 where one broke.

    Readers with one kind of file and one file each are tried; a reader of folders has no bytes of its own.
    """
    if WHY_NOT:
        sys.stderr.write(f"skipped: {WHY_NOT}\n")
        return 0
    single = [target for target in targets if len(target.kinds) == 1]
    failed = 0
    for target in single:
        child = multiprocessing.get_context("spawn").Process(target=_child, args=(target.name, seconds / len(single)))
        child.start()
        child.join()
        failed |= child.exitcode != 0
        how = "nothing broke" if child.exitcode == 0 else f"broke, exit code {child.exitcode}"
        sys.stdout.write(f"{target.name:<28} {how}\n")
        sys.stdout.flush()
    return failed


def _child(name: str, seconds: float) -> None:
    """Be the process of one reader; libFuzzer ends it."""
    import atheris  # pyright: ignore[reportMissingImports]

    with atheris.instrument_imports(  # pyright: ignore[reportAttributeAccessIssue]
        include=["solver_backend.io", "solver_backend.exchange", "solver_backend.body.files"]
    ):
        from tests.fuzz.targets import TARGETS
    target = next(target for target in TARGETS if target.name == name)
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    with scratch_folder() as folder:
        seeds = folder / "seeds"
        seeds.mkdir()
        home, [path, *_] = Homes(folder).of(target, 0)
        _write_seeds(target, seeds, folder)

        def try_one(data: bytes) -> None:
            path.write_bytes(data)
            outcome, where = how_it_ends(target, home)
            if outcome not in GOOD:
                raise Broke(where)

        limits = [f"-max_total_time={max(1, round(seconds))}", f"-timeout={2 * LIMIT_S}", f"-max_len={_LARGEST}"]
        atheris.Setup(["fuzz", str(seeds), "-rss_limit_mb=2048", "-print_final_stats=1", *limits], try_one)
        atheris.Fuzz()


def _write_seeds(target: Target, seeds: Path, folder: Path) -> None:
    """Write every dialect's file and the corpus of the reader into a folder."""
    for dialect in range(len(target.dialects)):
        home = folder / f"dialect{dialect}"
        home.mkdir()
        target.dialects[dialect](home)
        for path in home.rglob("*"):
            if path.is_file() and path.suffix in target.kinds:
                (seeds / f"{dialect}_{path.name}").write_bytes(path.read_bytes())
    for _, path in corpus_files([target]):
        (seeds / path.name).write_bytes(path.read_bytes())
