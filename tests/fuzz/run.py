"""Trying mutated files one after the other, each within a time limit, and counting how it ended."""

from __future__ import annotations

import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

import numpy as np

from solver_backend.exchange.errors import MocapError
from tests.fuzz.mutations import mutated
from tests.fuzz.targets import Target

LIMIT_S = 10
GOOD = ("read", "named")


class TooSlow(BaseException):
    """The time of one input is over."""


@dataclass
class Tried:
    """What came of the inputs."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    """By reader and outcome: 'read', 'named', 'unnamed' or 'slow'."""
    bad: dict[str, str] = field(default_factory=dict)
    """Where it broke, by reader, number and sentence: one of each kind."""
    slowest: dict[str, float] = field(default_factory=dict)
    """Seconds of each reader's slowest input."""


def fuzz(targets: Sequence[Target], count: int, seed: int, first: int = 0, current: Path | None = None) -> Tried:
    """Try so many inputs, spread over the readers by their weights.

    Args:
        targets: the readers.
        count: of inputs in all.
        seed: of the mutations; input n is the same whatever was tried before it.
        first: number of the first input.
        current: file that names the input being tried, for a parent that survives a crash.
    """
    turns = [target for target in targets for _ in range(target.weight)]
    tried = Tried()
    with tempfile.TemporaryDirectory() as folder:
        homes = {target.name: Path(folder) / str(i) for i, target in enumerate(targets)}
        for target in targets:
            homes[target.name].mkdir()
            target.write(homes[target.name])
        for number in range(first, first + count):
            target = turns[number % len(turns)]
            if current is not None:
                current.write_text(f"{number} {target.name}")
            start = time.monotonic()
            outcome, where = _outcome(target, homes[target.name], np.random.default_rng([seed, number]))
            tried.slowest[target.name] = max(tried.slowest.get(target.name, 0.0), time.monotonic() - start)
            tried.counts[target.name, outcome] += 1
            if outcome not in GOOD:
                tried.bad.setdefault(f"{target.name}: {where}", f"input {number}")
    return tried


def mutate_one(target: Target, folder: Path, rng: np.random.Generator) -> tuple[Path, bytes]:
    """Change one of the folder's files, and return it with what it held."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.suffix in target.kinds)
    path = files[int(rng.integers(len(files)))]
    before = path.read_bytes()
    path.write_bytes(mutated(before, target.kinds[path.suffix], rng))
    return path, before


def _outcome(target: Target, folder: Path, rng: np.random.Generator) -> tuple[str, str]:
    path, before = mutate_one(target, folder, rng)
    try:
        with _time_limit(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target.read(folder)
        return "read", ""
    except MocapError:
        return "named", ""
    except TooSlow:
        return "slow", f"more than {LIMIT_S} s"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)
        ours = next((f for f in reversed(last) if "solver_backend" in f.filename), last[-1])
        return "unnamed", f"{type(error).__name__} at {Path(ours.filename).name}:{ours.lineno}: {str(error)[:100]}"
    finally:
        path.write_bytes(before)


@contextmanager
def _time_limit() -> Iterator[None]:
    def over(number: int, frame: FrameType | None) -> None:
        raise TooSlow

    earlier = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, earlier)


def keep(target: Target, seed: int, number: int, folder: Path) -> Path:
    """Write the files of one input into a folder of its own, for a look."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    target.write(folder)
    return mutate_one(target, folder, np.random.default_rng([seed, number]))[0]


def table(tried: Tried) -> str:
    """Return the counts by reader and outcome."""
    outcomes = ("read", "named", "unnamed", "slow", "crash")
    lines = [f"{'reader':<28}" + "".join(f"{name:>10}" for name in outcomes) + f"{'slowest s':>12}"]
    for name in sorted({reader for reader, _ in tried.counts}):
        counts = "".join(f"{tried.counts[name, outcome]:>10,}" for outcome in outcomes)
        lines.append(f"{name:<28}{counts}{tried.slowest.get(name, 0.0):>12.2f}")
    total = "".join(f"{sum(n for (_, o), n in tried.counts.items() if o == outcome):>10,}" for outcome in outcomes)
    return "\n".join([*lines, f"{'all':<28}{total}", *(f"{where}: {what}" for what, where in tried.bad.items())])
