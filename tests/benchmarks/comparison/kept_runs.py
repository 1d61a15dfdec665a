"""Measure methods on each take, and store every finished part in a committed file with the hash of its code."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any, Protocol

Runs = dict[str, dict[str, dict[str, Any]]]  # Figures by method, take and seed.


class Part(Protocol):
    """One method on one take with one noise seed."""

    @property
    def name(self) -> str:
        """Name of the method in the table."""
        ...

    @property
    def take(self) -> str:
        """Name of the take."""
        ...

    @property
    def seed(self) -> int:
        """Seed of the noise."""
        ...

    @property
    def code(self) -> str:
        """Hash of the code and the weights that the figures depend on."""
        ...

    def measure(self) -> dict[str, Any]:
        """Return the figures."""
        ...


def resume(parts: Sequence[Part], path: Path, argv: Sequence[str]) -> Runs:
    """Measure parts that the file lacks or other code measured, and return the figures of all parts.

    Every part is written immediately. Parts that wait for their measurement keep their old figures. ``--minutes N``
    starts no part after that time. ``--seeds`` and ``--methods`` select parts, and ``--missing`` those without figures.
    """
    parser = argparse.ArgumentParser(prog=path.stem)
    parser.add_argument("--minutes", type=float, default=math.inf, help="stop after so long. The next call resumes")
    parser.add_argument("--seeds", type=int, nargs="+", default=sorted({part.seed for part in parts}))
    names = list(dict.fromkeys(part.name for part in parts))
    parser.add_argument("--methods", nargs="+", choices=names, default=names, metavar="NAME")
    parser.add_argument("--missing", action="store_true", help="keep the figures of other code")
    args = parser.parse_args(argv)
    end = time.monotonic() + 60 * args.minutes
    known = json.loads(path.read_text(encoding="utf-8"))["runs"] if path.exists() else {}
    for part in parts:
        row = known.get(part.name, {}).get(part.take, {}).get(str(part.seed), {})
        if part.seed not in args.seeds or part.name not in args.methods:
            continue
        if (row and args.missing) or row.get("code") == part.code or time.monotonic() >= end:
            continue
        row = part.measure() | {"code": part.code}
        sys.stdout.write(f"{part.name}, {part.take}, seed {part.seed}: {json.dumps(row)}\n")
        sys.stdout.flush()
        known.setdefault(part.name, {}).setdefault(part.take, {})[str(part.seed)] = row
        partial = path.with_suffix(".partial")
        text = json.dumps({"recorded": date.today().isoformat(), "runs": in_order(known, parts)}, indent=1)
        partial.write_text(text + "\n", encoding="utf-8")
        partial.replace(path)
    return in_order(known, parts)


def in_order(known: Runs, parts: Sequence[Part]) -> Runs:
    """Return only the known figures of the parts, in their order."""
    runs: Runs = {}
    for part in parts:
        row = known.get(part.name, {}).get(part.take, {}).get(str(part.seed))
        if row is not None:
            runs.setdefault(part.name, {}).setdefault(part.take, {})[str(part.seed)] = row
    return runs
