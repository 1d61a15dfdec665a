"""What came of the inputs, as a table and as a file that a later run goes on from."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from solver_backend.exchange.outputs import write_text

GOOD = ("read", "named")
OUTCOMES = (*GOOD, "unnamed", "warned", "slow", "hang", "crash")
"""Warned is what NumPy would have written to the console. An input is slow if it took too much time of the processor, a
hang if its process had to be ended."""


@dataclass
class Tried:
    """Counts of a run, or of a part of one."""

    counts: Counter[str] = field(default_factory=Counter)
    """By target, mutator and outcome, with bars between."""
    bad: dict[str, str] = field(default_factory=dict)
    """Where it broke, by target and sentence, with the input: one of each kind."""
    slowest: dict[str, float] = field(default_factory=dict)
    """Seconds of each target's slowest input."""
    following: dict[str, int] = field(default_factory=dict)
    """Number of each target's next input."""
    spent_s: dict[str, float] = field(default_factory=dict)
    """Processor time of each target's inputs."""
    peak_mb: float = 0.0
    """Most memory that a process of them had, the program itself included."""

    @property
    def total(self) -> int:
        """Number of inputs."""
        return sum(self.counts.values())

    @property
    def broke(self) -> bool:
        """Whether an input was neither read nor refused by name."""
        return any(key.rpartition("|")[2] not in GOOD for key in self.counts)

    def count(self, target: str, mutator: str, outcome: str, seconds: float = 0.0) -> None:
        """Count one input."""
        self.counts[f"{target}|{mutator}|{outcome}"] += 1
        self.slowest[target] = max(seconds, self.slowest.get(target, 0.0))
        self.spent_s[target] = self.spent_s.get(target, 0.0) + seconds

    def add(self, part: Tried) -> None:
        """Count the inputs of another part too."""
        self.counts.update(part.counts)
        self.bad = part.bad | self.bad
        self.following |= part.following
        for name, seconds in part.slowest.items():
            self.slowest[name] = max(seconds, self.slowest.get(name, 0.0))
        for name, seconds in part.spent_s.items():
            self.spent_s[name] = self.spent_s.get(name, 0.0) + seconds
        self.peak_mb = max(self.peak_mb, part.peak_mb)

    def line(self) -> str:
        """Return how many were tried, how fast, with how much memory, and how many kinds broke."""
        speed = f"{self.total / max(sum(self.spent_s.values()), 1e-9):,.0f} a second of processor time"
        return f"{self.total:,} inputs, {speed}, at most {self.peak_mb:,.0f} MB, {len(self.bad)} kinds broke"

    def table(self) -> str:
        """Return the counts by target, those of each mutator, and what broke."""
        keys = [key.split("|") for key in self.counts]
        sums: dict[str, Counter[str]] = {}
        for (target, mutator, outcome), n in zip(keys, self.counts.values(), strict=True):
            for row in (target, f"all by {mutator}"):
                sums.setdefault(row, Counter())[outcome] += n
        lines = [f"{'target':<34}" + "".join(f"{o:>10}" for o in OUTCOMES) + f"{'slowest s':>11}"]
        for row in sorted(sums, key=lambda row: (row.startswith("all by "), row)):
            slowest = f"{self.slowest[row]:>11.2f}" if row in self.slowest else ""
            lines.append(f"{row:<34}" + "".join(f"{sums[row][o]:>10,}" for o in OUTCOMES) + slowest)
        return "\n".join([*lines, self.line(), *(f"{what}: {where}" for what, where in self.bad.items())])

    def save(self, path: Path) -> None:
        """Write the counts."""
        write_text(path, json.dumps(vars(self), indent=1) + "\n", overwrite=True)

    @classmethod
    def load(cls, path: Path) -> Tried:
        """Return what was saved, or no counts where there is no file yet."""
        if not path.exists():
            return cls()
        values = json.loads(path.read_text(encoding="utf-8"))
        return cls(**values | {"counts": Counter(values["counts"])})
