"""Bytes changed by what atheris (libFuzzer) sees executed: ``python -m tests.fuzz.guided READERS SECONDS STATE GROW``.

The product is instrumented as it is imported, which takes seven seconds and is why nothing of it may have been imported
before. Each target is then fuzzed in a fork of that process. ``python -m tests.fuzz --guided`` starts this.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import redirect_stderr
from pathlib import Path

import atheris

_INSTRUMENTED = ["solver_backend.io", "solver_backend.exchange", "solver_backend.body.files"]
with open(os.devnull, "w") as _nowhere, redirect_stderr(_nowhere), atheris.instrument_imports(include=_INSTRUMENTED):
    from tests.fuzz.corpus import BY_LINES, LARGEST, corpus, file_name_of, files_of, smallest, write_corpus
    from tests.fuzz.driver import MEMORY_BYTES, Homes, how_it_ends, scratch_folder
    from tests.fuzz.target import Target
    from tests.fuzz.targets import chosen
    from tests.fuzz.tried import GOOD, Tried

_FILES, _SAVED = 40, 500  # Files of a folder that are seeds; inputs after which the counts are saved.
_PATIENCE_S, _LOOK_S = 120.0, 0.1  # A target that is not over so long after its time hangs.
_CANDIDATES = 300  # New inputs that are compared by the lines they reach.
KEPT = Path(tempfile.gettempdir()) / "mocap-fuzz"
"""What broke a target is written there, not into the folder that somebody happens to stand in."""


def fuzz_bytes(targets: Sequence[Target], seconds: float, state: Path | None, grow: bool) -> int:
    """Fuzz each target for its share of the time, print how it ended, and return 1 where one broke.

    Args:
        targets: readers and verbs; of folders, an input's first two bytes choose the dialect and the file.
        seconds: in all.
        state: file of counts, see ``Tried``, to which those of this run are added.
        grow: whether inputs that reach new lines go into the corpus.
    """
    whole = Tried() if state is None else Tried.load(state)
    for target in targets:
        with scratch_folder() as folder:
            part = _in_a_fork(target, seconds / len(targets), folder)
            new = _grown(target, folder) if grow else 0
        whole.add(part)
        broke = [what for what in part.bad if what.startswith(target.name)]
        sys.stdout.write(f"{target.name:<32} {part.total:>9,} inputs, {new} kept, {'; '.join(broke) or 'none broke'}\n")
        sys.stdout.flush()
        if state is not None:
            whole.save(state)
    sys.stdout.write(whole.line() + "\n")
    return int(whole.broke)


def _grown(target: Target, folder: Path) -> int:
    """Give the corpus those of a run's inputs that reach new lines, and return how many files the target has then."""
    begin, files = f"{file_name_of(target)}--", files_of(target)
    found = sorted((folder / "found").iterdir(), key=lambda path: path.stat().st_size)
    (folder / "chosen").mkdir()
    homes = Homes(folder / "chosen")
    for path in found[:_CANDIDATES]:
        data = path.read_bytes()
        if 2 < len(data) <= LARGEST and data[0] % len(target.dialects) == 0:
            suffix = _chosen(target, homes, data)[1].suffix
            files[f"{begin}{BY_LINES}_{path.name[:10]}{suffix}"] = data[2:]
    (folder / "homes").mkdir()
    kept = smallest(target, files, lambda home: how_it_ends(target, home), folder / "homes")
    rest = {name: data for name, data in corpus().items() if not name.startswith(begin)}
    write_corpus(rest | kept)
    return len(kept)


def _in_a_fork(target: Target, seconds: float, folder: Path) -> Tried:
    counts = folder / "counts.json"
    (folder / "found").mkdir()
    pid = os.fork()
    if pid == 0:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        _child(target, seconds, folder, counts)
        os._exit(1)
    code = _wait(pid, seconds + _PATIENCE_S)
    part = Tried.load(counts)
    if code:
        part.count(target.name, "guided", "hang" if code == -signal.SIGKILL else "crash")
        part.bad[f"{target.name}: the process ended with {code}"] = f"an input of atheris, see {KEPT}"
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


def _child(target: Target, seconds: float, folder: Path, counts: Path) -> None:
    """Be the process of one target. Counts are saved on the way, because an input may end it."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    KEPT.mkdir(exist_ok=True)
    seeds = folder / "seeds"
    for name in ("dialects", "seeds"):
        (folder / name).mkdir()
    homes, tried, end = Homes(folder / "dialects"), Tried(), time.monotonic() + seconds
    write_seeds(target, homes, seeds)

    def save() -> None:
        tried.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        tried.save(counts)

    def try_one(data: bytes) -> None:
        if time.monotonic() > end:  # libFuzzer looks at its clock seldom, and the end of a fork of its process hangs
            save()
            os._exit(0)
        if len(data) < 2:
            return
        home, path = _chosen(target, homes, data)
        start = time.process_time()
        homes.change(home, path, data[2:])
        outcome, where = how_it_ends(target, home)
        tried.count(target.name, "guided", outcome, time.process_time() - start)
        if outcome not in GOOD:
            kept = KEPT / f"{file_name_of(target)}-{os.getpid()}_{tried.total}"
            kept.write_bytes(data)
            tried.bad[f"{target.name}: {where}"] = str(kept)
        if outcome not in GOOD or tried.total % _SAVED == 0:
            save()

    limits = [f"-timeout={2 * target.limit_s:.0f}", f"-max_len={LARGEST}", "-rss_limit_mb=2048"]
    limits += [f"-artifact_prefix={KEPT}/"]
    atheris.Setup(["fuzz", str(folder / "found"), str(seeds), *limits], try_one)
    atheris.Fuzz()


def _chosen(target: Target, homes: Homes, data: bytes) -> tuple[Path, Path]:
    """Return the folder of the dialect, and the file in it, that an input's first two bytes choose."""
    home, files = homes.of(target, data[0] % len(target.dialects))
    return home, files[data[1] % len(files)]


def write_seeds(target: Target, homes: Homes, seeds: Path) -> None:
    """Write every dialect's files and the corpus of the target into a folder, behind the bytes that choose them."""
    for dialect in range(len(target.dialects)):
        files = homes.of(target, dialect)[1]
        for number, path in enumerate(files[:_FILES]):
            (seeds / f"{dialect}_{number}_{path.name}").write_bytes(bytes([dialect, number]) + path.read_bytes())
    for name, content in files_of(target).items():
        (seeds / name).write_bytes(bytes(2) + content)


if __name__ == "__main__":
    only, given, kept, grow = sys.argv[1:]
    sys.exit(fuzz_bytes(chosen(only), float(given), Path(kept) if kept else None, bool(grow)))
