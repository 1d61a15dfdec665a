"""Bytes changed by what atheris (libFuzzer) sees executed in the readers, each reader in a process of its own."""

from __future__ import annotations

import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from tests.fuzz.campaign import MEMORY_BYTES
from tests.fuzz.corpus import corpus_files
from tests.fuzz.run import BYTES, Homes, how_it_ends, scratch_folder
from tests.fuzz.target import Target
from tests.fuzz.tried import GOOD, Tried

WHY_NOT = "" if find_spec("atheris") is not None else "atheris is not installed in this Python"
_LARGEST = 20_000
"""Bytes of an input."""
_FILES, _SAVED = 40, 500
"""Files of a folder that are seeds; inputs after which the counts are saved."""


class Broke(Exception):
    """A reader neither read nor named what was wrong."""


def fuzz_bytes(targets: Sequence[Target], seconds: float, state: Path | None = None) -> int:
    """Fuzz each reader for its share of the time, print how it ended, and return 1 where one broke.

    Args:
        targets: readers and verbs; of folders, an input's first two bytes choose the dialect and the file.
        seconds: in all.
        state: file of counts, see ``Tried``, to which those of this run are added.
    """
    if WHY_NOT:
        sys.stderr.write(f"skipped: {WHY_NOT}\n")
        return 0
    failed, (whole, seed, following) = 0, (Tried(), 0, 0)
    if state is not None and state.exists():
        whole, seed, following = Tried.load(state)
    with scratch_folder() as folder:
        for target in targets:
            counts, limit_s = folder / "counts.json", seconds / len(targets)
            counts.unlink(missing_ok=True)
            child = multiprocessing.get_context("spawn").Process(target=_child, args=(target.name, limit_s, counts))
            child.start()
            child.join()
            failed |= child.exitcode != 0
            how = "nothing broke" if child.exitcode == 0 else f"broke, exit code {child.exitcode}"
            part = Tried.load(counts)[0] if counts.exists() else Tried()
            whole.add(part)
            sys.stdout.write(f"{target.name:<32} {part.total:>9,} inputs, {how}\n")
            sys.stdout.flush()
            if state is not None:
                whole.save(state, seed, following)
    return failed


def _child(name: str, seconds: float, counts: Path) -> None:
    """Be the process of one reader; libFuzzer ends it, so that counts are saved on the way."""
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
        homes, tried, end = Homes(folder), Tried(), time.monotonic() + seconds
        write_seeds(target, homes, seeds)

        def try_one(data: bytes) -> None:
            if len(data) < 2:
                return
            home, path = _chosen(target, homes, data)
            before, start = path.read_bytes(), time.process_time()
            path.write_bytes(data[2:])
            try:
                outcome, where = how_it_ends(target, home)
            finally:
                path.write_bytes(before)
            took = time.process_time() - start
            tried.count(target.name, BYTES, outcome, took)
            tried.processor_s += took
            if outcome not in GOOD:
                tried.bad[f"{target.name}: {where}"] = "an input of atheris"
            if outcome not in GOOD or tried.total % _SAVED == 0 or time.monotonic() > end - 1.0:
                tried.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                tried.save(counts, 0, 0)
            if outcome not in GOOD:
                raise Broke(where)

        limits = [f"-max_total_time={max(1, round(seconds))}", f"-timeout={2 * target.limit_s:.0f}"]
        limits += [f"-max_len={_LARGEST}", "-rss_limit_mb=2048", "-print_final_stats=1"]
        # What was slow or broke is written there, not into the folder that somebody happens to stand in.
        limits.append(f"-artifact_prefix={Path(tempfile.gettempdir()) / 'mocap-fuzz-'}")
        atheris.Setup(["fuzz", str(seeds), *limits], try_one)
        atheris.Fuzz()


def _chosen(target: Target, homes: Homes, data: bytes) -> tuple[Path, Path]:
    """Return the folder of the dialect, and the file in it, that an input's first two bytes choose."""
    home, files = homes.of(target, data[0] % len(target.dialects))
    return home, files[data[1] % len(files)]


def write_seeds(target: Target, homes: Homes, seeds: Path) -> None:
    """Write every dialect's files and the corpus of the reader into a folder, behind the bytes that choose them."""
    for dialect in range(len(target.dialects)):
        files = homes.of(target, dialect)[1]
        for number, path in enumerate(files[:_FILES]):
            (seeds / f"{dialect}_{number}_{path.name}").write_bytes(bytes([dialect, number]) + path.read_bytes())
    for _, path in corpus_files([target]):
        (seeds / path.name).write_bytes(bytes(2) + path.read_bytes())
