"""What came of the inputs, as a table and as a file that a later run goes on from."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from solver_backend.exchange.outputs import write_text

GOOD = ("read", "named")
OUTCOMES = (*GOOD, "unnamed", "warned", "slow", "hang", "crash")
"""Warned is what NumPy would have written to the console. An input is slow where its time ended it, a hang where its
process had to be ended."""


@dataclass
class Tried:
    """Counts of a run, or of a part of one."""

    counts: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    """By reader, mutator and outcome."""
    bad: dict[str, str] = field(default_factory=dict)
    """Where it broke, by reader and sentence, with the input: one of each kind."""
    slowest: dict[str, float] = field(default_factory=dict)
    """Seconds of each reader's slowest input."""
    processor_s: float = 0.0
    """Processor time of all inputs."""
    peak_mb: float = 0.0
    """Most memory that a process of them had, the program itself with it."""

    @property
    def total(self) -> int:
        """Number of inputs."""
        return sum(self.counts.values())

    @property
    def broke(self) -> bool:
        """Whether an input was neither read nor refused by name."""
        return any(outcome not in GOOD for *_, outcome in self.counts)

    def count(self, reader: str, mutator: str, outcome: str, seconds: float = 0.0) -> None:
        """Count one input."""
        self.counts[reader, mutator, outcome] += 1
        self.slowest[reader] = max(seconds, self.slowest.get(reader, 0.0))

    def add(self, part: Tried) -> None:
        """Count the inputs of another part too."""
        self.counts.update(part.counts)
        self.bad = part.bad | self.bad
        for name, seconds in part.slowest.items():
            self.slowest[name] = max(seconds, self.slowest.get(name, 0.0))
        self.processor_s += part.processor_s
        self.peak_mb = max(self.peak_mb, part.peak_mb)

    def table(self) -> str:
        """Return the counts by reader, mutator and outcome, and below what broke."""
        lines = [f"{'reader':<32}{'mutator':<10}" + "".join(f"{o:>10}" for o in OUTCOMES) + f"{'slowest s':>12}"]
        for reader, mutator in sorted({(reader, mutator) for reader, mutator, _ in self.counts}):
            counts = "".join(f"{self.counts[reader, mutator, outcome]:>10,}" for outcome in OUTCOMES)
            lines.append(f"{reader:<32}{mutator:<10}{counts}{self.slowest.get(reader, 0.0):>12.2f}")
        for mutator in sorted({mutator for _, mutator, _ in self.counts}):
            lines.append(f"{'all':<32}{mutator:<10}" + "".join(f"{self._by(mutator, o):>10,}" for o in OUTCOMES))
        rate = self.total / self.processor_s if self.processor_s else 0.0
        lines.append(f"{self.total:,} inputs, {rate:,.0f} a second of processor time, at most {self.peak_mb:,.0f} MB")
        return "\n".join([*lines, *(f"{where}: {what}" for what, where in self.bad.items())])

    def _by(self, mutator: str, outcome: str) -> int:
        return sum(n for (_, m, o), n in self.counts.items() if (m, o) == (mutator, outcome))

    def save(self, path: Path, seed: int, following: int) -> None:
        """Write the counts, and the number of the input that comes next."""
        counts = [[*key, n] for key, n in sorted(self.counts.items())]
        values = {"seed": seed, "next": following, "counts": counts, "bad": self.bad, "slowest": self.slowest}
        values |= {"processor_s": self.processor_s, "peak_mb": self.peak_mb}
        write_text(path, json.dumps(values, indent=1) + "\n", overwrite=True)

    @classmethod
    def load(cls, path: Path) -> tuple[Tried, int, int]:
        """Return what was saved: the counts, the seed and the number of the next input."""
        values = json.loads(path.read_text(encoding="utf-8"))
        counts = Counter({(reader, mutator, outcome): n for reader, mutator, outcome, n in values["counts"]})
        tried = cls(counts, values["bad"], values["slowest"], values["processor_s"], values["peak_mb"])
        return tried, values["seed"], values["next"]
