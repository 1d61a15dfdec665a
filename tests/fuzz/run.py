"""Trying mutated files one after the other, each within a time limit, and counting how it ended."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from blender_addon._exchange.errors import MocapError as AddonError
from solver_backend.exchange.errors import MocapError
from tests.fuzz.corpus import FOLDER
from tests.fuzz.grammars.document import document
from tests.fuzz.mutations import mutated
from tests.fuzz.sense import broken_sense
from tests.fuzz.target import Target
from tests.fuzz.tried import Tried

_WAITING_S = 100  # Seconds on the wall after which a reader that takes no processor time waits for what never comes.
CHANGES, GRAMMAR, SPLICE, RADAMSA, BYTES = "changes", "grammar", "splice", "radamsa", "bytes"
MUTATORS = (CHANGES, GRAMMAR, SPLICE, RADAMSA)
"""Changes of files that are read, documents by the grammar of their format, pieces of files of any format put into
each other, and radamsa, if the package ``pyradamsa`` is installed. Atheris' own loop changes bytes."""
BATCH = 20_000  # Inputs a child, which take values of one stock.
_LINE = 100  # Characters of the line that names the input being tried.
_MEMORY_FOLDER = Path("/dev/shm")


class TooSlow(BaseException):
    """The time of one input is over."""


class Homes:
    """A folder of sound files for each dialect of each reader, made when it is needed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._homes: dict[tuple[str, int], tuple[Path, list[Path]]] = {}
        self._contents: dict[Path, bytes] = {}

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


def turns(targets: Sequence[Target]) -> list[Target]:
    """Return the readers, each as often as its weight says, well mixed."""
    places = [((i + 0.5) / target.weight, k) for k, target in enumerate(targets) for i in range(target.weight)]
    return [targets[k] for _, k in sorted(places)]


def fuzz(
    targets: Sequence[Target], count: int, seed: int, first: int = 0, current: Path | None = None,
    mutator: str = CHANGES,
) -> Tried:  # fmt: skip
    """Try so many inputs, spread over the readers by their weights.

    Args:
        targets: the readers.
        count: of inputs in all.
        seed: of the mutations; input n is the same whatever was tried before it.
        first: number of the first input.
        current: file that names the input being tried, for a parent that survives a crash.
        mutator: what makes the inputs, of ``MUTATORS``.
    """
    tried, order, begun = Tried(), turns(targets), time.process_time()
    with scratch_folder() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        homes = Homes(folder)
        place = None if current is None else os.open(current, os.O_WRONLY | os.O_CREAT)
        for number in range(first, first + count):
            target = order[number % len(order)]
            if place is not None:
                os.pwrite(place, f"{number} {target.name}".ljust(_LINE).encode(), 0)
            start = time.process_time()
            outcome, where = _outcome(target, homes, seed, number, mutator)
            tried.count(target.name, mutator, outcome, time.process_time() - start)
            if where:
                tried.bad.setdefault(f"{target.name}: {where}", f"input {number} of seed {seed} by {mutator}")
        if place is not None:
            os.close(place)
    tried.processor_s = time.process_time() - begun
    tried.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return tried


def mutate_one(
    target: Target, homes: Homes, seed: int, number: int, mutator: str = CHANGES
) -> tuple[Path, Path, bytes]:
    """Change one file of one dialect, and return the folder, the file and what it held."""
    rng = np.random.default_rng([seed, number])
    home, files = homes.of(target, int(rng.integers(len(target.dialects))))
    path = files[int(rng.integers(len(files)))]
    before = homes.content(path)
    kind = target.kinds[path.suffix]
    if mutator == CHANGES and target.sense and rng.random() < target.sense:
        path.write_bytes(broken_sense(before, kind, rng))
    else:
        path.write_bytes(drawn_input(mutator, before, kind, rng, number))
    return home, path, before


def drawn_input(mutator: str, sound: bytes, kind: str, rng: np.random.Generator, number: int) -> bytes:
    """Return what a mutator makes of a sound file of this kind; ``number`` is the input's."""
    if mutator == SPLICE:
        return _spliced(sound, rng)
    if mutator == RADAMSA:
        return _radamsa().fuzz(sound, seed=int(rng.integers(2**31)), max_mut=len(sound) + 4096)
    return document(sound, kind, rng, number // BATCH) if mutator == GRAMMAR else mutated(sound, kind, rng)


def _spliced(sound: bytes, rng: np.random.Generator) -> bytes:
    """Put a piece of a file of the corpus, of any format, in the place of a piece of the sound file."""
    other = _corpus()[int(rng.integers(len(_corpus())))]
    (a, b), (c, d) = (sorted(int(rng.integers(len(data) + 1)) for _ in range(2)) for data in (sound, other))
    end = sound[b:] if rng.random() < 0.7 else b""
    return sound[:a] + other[c:d] + end


@lru_cache
def _corpus() -> list[bytes]:
    return [path.read_bytes() for path in sorted(FOLDER.iterdir())]


@lru_cache
def _radamsa() -> Any:
    return import_module("pyradamsa").Radamsa()


def keep(target: Target, seed: int, number: int, folder: Path, mutator: str = CHANGES) -> Path:
    """Write the files of one input into a folder of its own, for a look."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return mutate_one(target, Homes(folder), seed, number, mutator)[1]


def _outcome(target: Target, homes: Homes, seed: int, number: int, mutator: str) -> tuple[str, str]:
    home, path, before = mutate_one(target, homes, seed, number, mutator)
    try:
        return how_it_ends(target, home)
    finally:
        path.write_bytes(before)


def how_it_ends(target: Target, home: Path) -> tuple[str, str]:
    """Return 'read', 'named', 'unnamed', 'warned' or 'slow', and for the last three where it broke."""
    outcome, warned = "read", list[str]()
    try:
        with _time_limit(target.limit_s), _heard(warned):
            target.read(home)
    except (MocapError, AddonError):
        outcome = "named"
    except TooSlow:
        return "slow", f"more than {target.limit_s:g} s"
    except Exception as error:
        where = _ours(traceback.extract_tb(error.__traceback__))
        return "unnamed", f"{type(error).__name__} at {where}: {str(error)[:100]}"
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
def _time_limit(limit_s: float) -> Iterator[None]:
    def over(number: int, frame: FrameType | None) -> None:
        raise TooSlow

    clocks = ((signal.SIGPROF, signal.ITIMER_PROF, limit_s), (signal.SIGALRM, signal.ITIMER_REAL, _WAITING_S))
    earlier = [signal.signal(kind, over) for kind, _, _ in clocks]
    for _, clock, seconds in clocks:
        signal.setitimer(clock, seconds)
    try:
        yield
    finally:
        for (kind, clock, _), before in zip(clocks, earlier, strict=True):
            signal.setitimer(clock, 0)
            signal.signal(kind, before)
