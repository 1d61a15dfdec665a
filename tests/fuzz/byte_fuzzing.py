"""Bytes changed by what atheris (libFuzzer) sees executed in the readers.

The readers are instrumented once, which takes seven seconds; each is then fuzzed in a fork of that process.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.campaign import MEMORY_BYTES
from tests.fuzz.corpus import corpus_files
from tests.fuzz.run import BYTES, Homes, how_it_ends, scratch_folder
from tests.fuzz.target import Target
from tests.fuzz.tried import GOOD, Tried

_LARGEST = 20_000  # Bytes of an input.
_FILES, _SAVED = 40, 500  # Files of a folder that are seeds; inputs after which the counts are saved.
_PATIENCE_S, _LOOK_S = 120.0, 0.2  # A reader that is not over so long after its time hangs.
KEPT = Path(tempfile.gettempdir()) / "mocap-fuzz"
"""What broke a reader is written there, not into the folder that somebody happens to stand in."""


def fuzz_bytes(targets: Sequence[Target], seconds: float, state: Path | None = None) -> int:
    """Fuzz each reader for its share of the time, print how it ended, and return 1 where one broke.

    Args:
        targets: readers and verbs; of folders, an input's first two bytes choose the dialect and the file.
        seconds: in all.
        state: file of counts, see ``Tried``, to which those of this run are added.
    """
    whole, seed, following = Tried(), 1, 0
    if state is not None and state.exists():
        whole, seed, following = Tried.load(state)
    for target in targets:
        part = _in_a_fork(target, seconds / len(targets), seed)
        whole.add(part)
        broke = [what for what in part.bad if what.startswith(target.name)]
        sys.stdout.write(f"{target.name:<32} {part.total:>9,} inputs, {'; '.join(broke) or 'nothing broke'}\n")
        sys.stdout.flush()
        if state is not None:
            whole.save(state, seed + 1, following)
    sys.stdout.write(whole.table().splitlines()[-1] + "\n")
    return int(whole.broke)


def _in_a_fork(target: Target, seconds: float, seed: int) -> Tried:
    with scratch_folder() as folder:
        counts = folder / "counts.json"
        pid = os.fork()
        if pid == 0:
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            _child(target, seconds, seed, counts)
            os._exit(1)
        code = _wait(pid, seconds + _PATIENCE_S)
        part = Tried.load(counts)[0] if counts.exists() else Tried()
        if code:
            part.count(target.name, BYTES, "hang" if code == -signal.SIGKILL else "crash")
            part.bad[f"{target.name}: the process ended with {code}"] = f"seed {seed} of atheris, see {KEPT}"
        return part


def _wait(pid: int, seconds: float) -> int:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(_LOOK_S)
    os.kill(pid, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def _child(target: Target, seconds: float, seed: int, counts: Path) -> None:
    """Be the process of one reader; libFuzzer ends it, so that counts are saved on the way."""
    import atheris

    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    KEPT.mkdir(exist_ok=True)
    homes, tried, end = Homes(counts.parent), Tried(), time.monotonic() + seconds
    seeds = counts.parent / "seeds"
    seeds.mkdir()
    write_seeds(target, homes, seeds)

    def save() -> None:
        tried.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        tried.save(counts, seed, 0)

    def try_one(data: bytes) -> None:
        if len(data) < 2 or time.monotonic() > end:  # libFuzzer looks at its clock only after the last seed
            return
        home, path = _chosen(target, homes, data)
        start = time.process_time()
        path.write_bytes(data[2:])
        try:
            outcome, where = how_it_ends(target, home)
        finally:
            path.write_bytes(homes.content(path))
        took = time.process_time() - start
        tried.count(target.name, BYTES, outcome, took)
        tried.processor_s += took
        if outcome not in GOOD:
            kept = KEPT / f"{target.name.replace(' ', '_')}-{seed}_{tried.total}"
            kept.write_bytes(data)
            tried.bad[f"{target.name}: {where}"] = str(kept)
        if outcome not in GOOD or tried.total % _SAVED == 0 or time.monotonic() > end - 1.0:
            save()

    limits = [f"-max_total_time={max(1, round(seconds))}", f"-timeout={2 * target.limit_s:.0f}", f"-seed={seed}"]
    limits += [f"-max_len={_LARGEST}", "-rss_limit_mb=2048", f"-artifact_prefix={KEPT}/"]
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
