"""Faults of captures with random cameras, lenses, noise and clips. Half of the captures have two people.

The faults, the states of a case and AGREEMENT_RECORD are those of ``bench_agreement``. No constant was fitted to the
captures of ``HELD_OUT_SEEDS``. ``python -m tests.benchmarks.bench_random_rigs FIRST LAST [--two]`` prints the captures
of other seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import astuple

import numpy as np

from tests.benchmarks import bench_agreement
from tests.benchmarks.metric import Metric
from tests.benchmarks.spoiled_views.motion_takes import HELD_OUT, MotionTake
from tests.support.recordings import recordings_folder

HELD_OUT_SEEDS = range(1000, 1060)
MEASURED = {name for take in HELD_OUT for name in (take.clip, take.company)}  # Clips of ``bench_agreement``.


def capture(seed: int, *, two: bool) -> tuple[MotionTake, str]:
    """Return a random take and the kind of its fault."""
    rng = np.random.default_rng(seed)
    folder = recordings_folder() / "motion_cmu" / "asfamc"
    clips = [path.stem for path in sorted(folder.glob("*.npz")) if path.stem not in MEASURED]
    clip, company = rng.choice(clips, 2, replace=False).tolist() if clips else ("", "")
    take = MotionTake(
        clip, f"random {seed}", float(rng.choice([0.5, 1.0, 1.0, 2.0])), int(rng.choice([60, 120, 240, 240, 480])),
        float(rng.choice([1.0, 1.0, 1.0, 0.7])), float(rng.choice([0.0, 0.0, 0.1, 0.3])), int(rng.integers(60)),
        company=company if two else "",
    )  # fmt: skip
    return take, str(rng.choice(list(bench_agreement.KINDS)))


def tried_captures(seeds: Iterable[int], *, two: bool) -> Iterator[tuple[str, str]]:
    """Yield the state and the line of each capture."""
    for seed in seeds:
        take, kind = capture(seed, two=two)
        for _, state, line in bench_agreement.tried_cases({seed: take}, [kind]):
            yield state, f"{line} {astuple(take)}"


def run() -> list[Metric]:
    """Count the results of the held-out captures."""
    metrics = list[Metric]()
    for name, two in (("one_person", False), ("two_people", True)):
        counts = Counter(state for state, _ in tried_captures(HELD_OUT_SEEDS, two=two))
        good = counts["right"] + counts["repaired"] + counts["harmless"]
        metrics.append(Metric(f"{name}_good_percent", 100 * good / counts.total(), "%", "higher", abs_tol=5.0))
        metrics += [Metric(f"{name}_{state}", float(counts[state]), "cases") for state in ("wrong", "silent")]
    return metrics


def main(argv: list[str]) -> int:
    """Print every capture, and counts of the states."""
    parser = argparse.ArgumentParser(prog="bench_random_rigs", description=__doc__)
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--two", action="store_true", help="two people")
    args = parser.parse_args(argv)
    counts = Counter[str]()
    for state, line in tried_captures(range(args.first, args.last + 1), two=args.two):
        counts[state] += 1
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
    sys.stdout.write(f"{dict(counts)}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
