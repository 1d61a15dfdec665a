"""The one driver: it tries inputs of a target in a forked worker with limits, and goes from target to target.

A worker tries thousands of inputs. Its files lie in memory where the system has such a place. An input that ends its
worker, or hangs, is counted as any other finding.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from hashlib import blake2b
from importlib import import_module
from importlib.util import find_spec
from mmap import mmap
from pathlib import Path
from struct import Struct
from types import FrameType
from typing import Any

import numpy as np

from blender_addon._exchange.errors import MocapError as AddonError
from solver_backend.exchange.errors import MocapError
from tests.fuzz.corpus import corpus
from tests.fuzz.mutations import mutated
from tests.fuzz.sense import broken_sense
from tests.fuzz.target import Target
from tests.fuzz.tried import Tried

MEMORY_BYTES = 2 * 2**30
HANG_S, WAIT_S = 60, 600
"""A worker that stays at one input for so long of processor time, or on the wall, is ended: its own limits did not
reach it."""
WORKER_S, MOST = 12.0, 6000
"""A worker gets inputs for so much processor time by what its target's inputs took so far, and at most so many."""
CHANGES, SPLICE, RADAMSA = "changes", "splice", "radamsa"
MUTATORS = (CHANGES, SPLICE) * 7 + (CHANGES, RADAMSA if find_spec("pyradamsa") else SPLICE)
"""Changes of files that are read, pieces of files of any format put into each other, and radamsa, if the package
``pyradamsa`` is installed. They take turns, radamsa seldom, because each of its inputs takes 2 to 4 ms. Atheris changes
bytes in its own loop, see ``guided``."""
_SMALL, _LARGE_SHARE = 20_000, 0.1  # Larger files are changed seldom.
_WAITING_S = 100  # Seconds on the wall after which a reader that takes no processor time waits for what never comes.
_POLL_S = 0.05
_MEMORY_FOLDER = Path("/dev/shm")
_NUMBER, _NONE = Struct("q"), -1
_GENERATOR = np.random.Generator(np.random.PCG64(0))
_until = np.inf, np.inf  # Processor time and time on the wall that end the input being read.


class TooSlow(BaseException):
    """The time of one input is over."""


class Homes:
    """A folder of sound files for each dialect of a target, made when it is needed. One file at a time is changed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._homes: dict[tuple[str, int], tuple[Path, list[Path]]] = {}
        self._contents: dict[Path, bytes] = {}
        self._changed: dict[Path, Path] = {}

    def of(self, target: Target, dialect: int) -> tuple[Path, list[Path]]:
        """Return the folder, and those of its files that are changed."""
        if (target.name, dialect) not in self._homes:
            home = self._folder / f"{len(self._homes)}"
            home.mkdir()
            target.dialects[dialect](home)
            files = sorted(p for p in home.rglob("*") if p.is_file() and p.suffix in target.kinds)
            self._homes[target.name, dialect] = home, files
        return self._homes[target.name, dialect]

    def content(self, path: Path) -> bytes:
        """Return what a file held when it was made."""
        if path not in self._contents:
            self._contents[path] = path.read_bytes()
        return self._contents[path]

    def change(self, home: Path, path: Path, data: bytes) -> None:
        """Let a file of a folder have another content, and the one that was changed before its own again."""
        self.content(path)
        before = self._changed.get(home, path)
        if before != path:
            _write(before, self.content(before))
        self._changed[home] = path
        _write(path, data)


def _write(path: Path, data: bytes) -> None:
    place = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.write(place, data)
    os.close(place)


def campaign(
    targets: Sequence[Target], whole: Tried, count: int, seed: int, after: Callable[[Tried], None], seconds: float
) -> Tried:
    """Try inputs in workers until there are so many in all, or the time is over, and add their counts to ``whole``.

    Args:
        targets: the one that had least processor time is next.
        whole: counts of earlier inputs.
        count: of inputs, the earlier ones included.
        seed: of the mutations.
        after: called with the counts after every worker.
        seconds: on the wall, after which no further worker begins.
    """
    until = time.monotonic() + seconds
    while whole.total < count and time.monotonic() < until:
        target = min(targets, key=lambda target: whole.spent_s.get(target.name, 0.0))
        first, spent = whole.following.get(target.name, 0), whole.spent_s.get(target.name, 0.0)
        inputs = min(MOST, 8 + round(first * WORKER_S / spent) if spent else 8, count - whole.total)
        whole.add(in_worker(target, first, inputs, seed))
        after(whole)
    return whole


def in_worker(target: Target, first: int, count: int, seed: int) -> Tried:
    """Try inputs in a fork within limits. The last of them may be one that ended its process."""
    with scratch_folder() as folder:
        counts, current = folder / "tried", mmap(-1, _NUMBER.size)
        _NUMBER.pack_into(current, 0, _NONE)
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                # What it takes, not what it maps: Blender's module alone maps more than half without touching it.
                resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
                fuzz(target, count, seed, first, current).save(counts)
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        code, hung = _watch(pid, current)
        if code == 0:
            return Tried.load(counts)
        (number,) = _NUMBER.unpack_from(current)
        if number == _NONE:
            raise RuntimeError(f"The worker of {target.name} ended with {code} before its first input.")
    part = in_worker(target, first, number - first, seed) if number > first else Tried()
    mutator = MUTATORS[number % len(MUTATORS)]
    part.count(target.name, mutator, "hang" if hung else "crash")
    part.bad[f"{target.name}: the process ended with {code}"] = f"input {number} of seed {seed} by {mutator}"
    part.following[target.name] = number + 1
    return part


def fuzz(target: Target, count: int, seed: int, first: int = 0, current: mmap | None = None) -> Tried:
    """Try so many inputs of a target in this process.

    Args:
        target: what reads them.
        count: of inputs.
        seed: of the mutations; input n of a target is the same whatever was tried before it.
        first: number of the first input.
        current: memory for the number of the input being tried, for a parent that survives a crash.
    """
    tried = Tried(following={target.name: first + count})
    with scratch_folder() as folder, warnings.catch_warnings(), clocks():
        warnings.simplefilter("ignore")
        homes = Homes(folder)
        for number in range(first, first + count):
            if current is not None:
                _NUMBER.pack_into(current, 0, number)
            start = time.process_time()
            home, mutator = mutate_one(target, homes, seed, number)
            outcome, where = how_it_ends(target, home)
            tried.count(target.name, mutator, outcome, time.process_time() - start)
            if where:
                tried.bad.setdefault(f"{target.name}: {where}", f"input {number} of seed {seed} by {mutator}")
    tried.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return tried


def _random(*words: object) -> np.random.Generator:
    """Return random numbers that follow from words. NumPy's own seeding takes ten times as long."""
    digest = int.from_bytes(blake2b(repr(words).encode(), digest_size=32).digest(), "little")
    state = {"state": digest >> 128, "inc": digest % 2**128 | 1}
    _GENERATOR.bit_generator.state = {"bit_generator": "PCG64", "state": state, "has_uint32": 0, "uinteger": 0}
    return _GENERATOR


def mutate_one(target: Target, homes: Homes, seed: int, number: int) -> tuple[Path, str]:
    """Change one file of one dialect, and return the folder and the mutator."""
    rng = _random(seed, target.name, number)
    home, files = homes.of(target, int(rng.integers(len(target.dialects))))
    path = files[int(rng.integers(len(files)))]
    if len(homes.content(path)) > _SMALL and rng.random() > _LARGE_SHARE:
        home, files = homes.of(target, 0)
        path = files[int(rng.integers(len(files)))]
    before, mutator = homes.content(path), MUTATORS[number % len(MUTATORS)]
    kind = target.kinds[path.suffix]
    if mutator == CHANGES and target.sense and rng.random() < target.sense:
        homes.change(home, path, broken_sense(before, kind, rng))
    else:
        homes.change(home, path, drawn_input(mutator, before, kind, rng))
    return home, mutator


def drawn_input(mutator: str, sound: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Return what a mutator makes of a sound file of this kind."""
    if mutator == SPLICE:
        return _spliced(sound, rng)
    if mutator == RADAMSA:
        return _radamsa().fuzz(sound, seed=int(rng.integers(2**31)), max_mut=len(sound) + 4096)
    return mutated(sound, kind, rng)


def _spliced(sound: bytes, rng: np.random.Generator) -> bytes:
    """Put a piece of a file of the corpus, of any format, in the place of a piece of the sound file."""
    others = list(corpus().values())
    other = others[int(rng.integers(len(others)))]
    (a, b), (c, d) = (sorted(int(rng.integers(len(data) + 1)) for _ in range(2)) for data in (sound, other))
    end = sound[b:] if rng.random() < 0.7 else b""
    return sound[:a] + other[c:d] + end


@lru_cache
def _radamsa() -> Any:
    return import_module("pyradamsa").Radamsa()


def keep(target: Target, seed: int, number: int, folder: Path) -> Path:
    """Write the files of one input into a folder of its own, for a look."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return mutate_one(target, Homes(folder), seed, number)[0]


def how_it_ends(target: Target, home: Path) -> tuple[str, str]:
    """Return 'read', 'named', 'unnamed', 'warned' or 'slow', and for the last three where it broke."""
    global _until
    outcome, warned = "read", list[str]()
    _until = time.process_time() + target.limit_s, time.monotonic() + _WAITING_S
    try:
        with _heard(warned):
            target.read(home)
    except (MocapError, AddonError):
        outcome = "named"
    except TooSlow as slow:
        return "slow", f"more than {target.limit_s:g} s at {_ours(traceback.extract_tb(slow.__traceback__))}"
    except Exception as error:
        where = _ours(traceback.extract_tb(error.__traceback__))
        return "unnamed", f"{type(error).__name__} at {where}: {str(error)[:100]}"
    finally:
        _until = np.inf, np.inf
    return ("warned", warned[0]) if warned else (outcome, "")


@contextmanager
def _heard(found: list[str]) -> Iterator[None]:
    """Note where NumPy would warn on the console; it means that numbers went on which nobody looked at."""

    def note(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        found.append(f"{category.__name__} at {_ours(traceback.extract_stack())}: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = note  # type: ignore[assignment]
        yield


def _ours(frames: traceback.StackSummary) -> str:
    """Return the place of the innermost line that is the product's."""
    product = {"solver_backend", "blender_addon"}
    last = next((frame for frame in reversed(frames) if product & {*Path(frame.filename).parts}), frames[-1])
    return f"{'/'.join(Path(last.filename).parts[-2:])}:{last.lineno}"


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a folder that vanishes, in memory where the system has such a place."""
    in_memory = _MEMORY_FOLDER.is_dir() and os.access(_MEMORY_FOLDER, os.W_OK)
    with tempfile.TemporaryDirectory(dir=_MEMORY_FOLDER if in_memory else None) as folder:
        yield Path(folder)


@contextmanager
def clocks() -> Iterator[None]:
    """End an input in ``how_it_ends`` whose time is over, by a look every second: a timer for each would cost more."""

    def look(number: int, frame: FrameType | None) -> None:
        if time.process_time() > _until[0] or time.monotonic() > _until[1]:
            raise TooSlow

    kinds = ((signal.SIGPROF, signal.ITIMER_PROF), (signal.SIGALRM, signal.ITIMER_REAL))
    earlier = [signal.signal(kind, look) for kind, _ in kinds]
    for _, clock in kinds:
        signal.setitimer(clock, 1.0, 1.0)
    try:
        yield
    finally:
        for (kind, clock), before in zip(kinds, earlier, strict=True):
            signal.setitimer(clock, 0)
            signal.signal(kind, before)


def _processor_s(pid: int) -> float:
    """Return the seconds of processor time of a process; where the system has no /proc, those on the wall."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError):
        return time.monotonic()


def _watch(pid: int, current: mmap) -> tuple[int, bool]:
    """Wait for a worker, end it if it stays at one input for too long, and return its exit code and whether it did."""
    seen, since, used = _NONE, time.monotonic(), 0.0
    while True:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status), False
        (now,) = _NUMBER.unpack_from(current)
        if now != seen:
            seen, since, used = now, time.monotonic(), _processor_s(pid)
        elif _processor_s(pid) - used > HANG_S or time.monotonic() - since > WAIT_S:
            os.kill(pid, signal.SIGKILL)
            return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), True
        time.sleep(_POLL_S)
