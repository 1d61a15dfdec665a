"""``python -m tests.kills --count 300 --seed 0`` kills programs early, while they write and at their end; exits with 1
where one is not resumed with every file whole. ``--only`` names operations. With ``--state FILE`` the kills are counted
there, and the same command goes on where an earlier one ended; ``--seconds`` ends it after so long.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.outputs import write_text
from tests.kills.moments import Moment, drawn
from tests.kills.operation import Operation
from tests.kills.operations import OPERATIONS
from tests.kills.run import Measured, kill_once, measure, solved_folder


@dataclass
class Kills:
    """Counts of a run and of those before it."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    """By operation and kind of moment."""
    wrong: list[str] = field(default_factory=list)
    """A sentence for each kill after which something was wrong."""
    known: dict[str, list[Any]] = field(default_factory=dict)
    """Seconds, files and changes of each operation that was let end, by its name."""

    @property
    def total(self) -> int:
        """Number of kills."""
        return sum(self.counts.values())

    def of(self, name: str) -> int:
        """Return how often an operation was killed."""
        return sum(n for (operation, _), n in self.counts.items() if operation == name)

    def count(self, name: str, moment: Moment, wrong: list[str]) -> None:
        """Count one kill."""
        self.counts[name, moment.kind] += 1
        if wrong:
            self.wrong.append(f"{name} ({moment}): {'; '.join(wrong)}")

    def table(self) -> str:
        """Return the kills of each operation by the kind of moment, and what was wrong."""
        kinds = sorted({kind for _, kind in self.counts})
        lines = [f"{'':<14}" + "".join(f"{kind:>10}" for kind in kinds)]
        for name in sorted({name for name, _ in self.counts}):
            lines.append(f"{name:<14}" + "".join(f"{self.counts[name, kind]:>10}" for kind in kinds))
        whole = self.total - len(self.wrong)
        return "\n".join([*lines, f"{self.total} kills, {whole} resumed with every file whole", *self.wrong])

    def save(self, path: Path) -> None:
        """Write the counts."""
        counts = [[*key, n] for key, n in sorted(self.counts.items())]
        values = {"counts": counts, "wrong": self.wrong, "known": self.known}
        write_text(path, json.dumps(values, indent=1) + "\n", overwrite=True)

    def measured(self, operation: Operation, folder: Path, solved: Path) -> Measured:
        """Return what an operation takes when it is let end, of this run or of an earlier one."""
        if operation.name not in self.known:
            found = measure(operation, folder, solved)
            self.known[operation.name] = [found.seconds, sorted(found.files), found.changes]
        seconds, files, changes = self.known[operation.name]
        return Measured(operation, seconds, frozenset(files), changes)

    @classmethod
    def load(cls, path: Path | None) -> Kills:
        """Return what was saved, or no kills."""
        if path is None or not path.exists():
            return cls()
        values = json.loads(path.read_text(encoding="utf-8"))
        counts = Counter({(name, kind): n for name, kind, n in values["counts"]})
        return cls(counts, values["wrong"], values.get("known", {}))


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.kills", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=300, help="kills in all, those of earlier runs with them")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="operations, commas between")
    parser.add_argument("--state", type=Path, metavar="FILE", help="count the kills here, and go on from them")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no kill after so long")
    args = parser.parse_args()
    operations = [operation for operation in OPERATIONS if not args.only or operation.name in args.only.split(",")]
    kills, begin = Kills.load(args.state), time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        solved = solved_folder(folder / "solved")
        while kills.total < args.count and time.monotonic() - begin < args.seconds:
            operation = min(operations, key=lambda one: kills.of(one.name))
            one, number = kills.measured(operation, folder / "work", solved), kills.of(operation.name)
            moment = drawn(np.random.default_rng([args.seed, kills.total]), number, one.changes)
            when, wrong = kill_once(one, folder / "work", solved, moment)
            kills.count(operation.name, moment, wrong)
            line = f"{operation.name:<12} {moment!s:<20} {when:<24} {'; '.join(wrong) or 'whole'}"
            sys.stdout.write(f"{kills.total:4}  {time.monotonic() - begin:6.0f} s  {line}\n")
            sys.stdout.flush()
            if args.state is not None:
                kills.save(args.state)
    sys.stdout.write(kills.table() + "\n")
    return int(bool(kills.wrong))


if __name__ == "__main__":
    sys.exit(main())
