"""Ten pairs of walkers who cross in four views: identities, and solves compared with separately filmed people.

Takes of CMU subject 08 on bodies of random shape. The people occlude each other, and the detector lists them in any
order. Needs the motions next to the repository (or MOCAP_SHARED_DATA). ``python -m tests.benchmarks.bench_people``
prints seeds.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from research.simulation.benchmark import BenchmarkSettings
from research.simulation.company import Crossing, crossing
from solver_backend.agreement.person_selection import SelectedPerson, select_people
from solver_backend.fitters.pipeline import solve
from solver_backend.metrics import mpjpe_mm
from solver_backend.types import Capture, Keypoints2D
from tests.benchmarks.comparison.validation_takes import take_named
from tests.benchmarks.kept_parts import kept
from tests.benchmarks.metric import Metric

TAKES = tuple(f"08_{number:02d}" for number in range(1, 11))
SEEDS = 10
BOUND_RATIO = 1.1


@dataclass(frozen=True)
class Outcome:
    """Result of one pair."""

    found: int  # Number of detected people, of two.
    mixed: int  # Number of detections with the wrong person.
    missed: float  # Share of their detections without a person.
    together_mm: tuple[float, float]  # Mean joint error of each person, recorded together.
    alone_mm: tuple[float, float]  # Mean joint error of each person, recorded alone.

    @property
    def ratio(self) -> float:
        """Larger of the two error ratios."""
        return max(a / b for a, b in zip(self.together_mm, self.alone_mm, strict=True))


def run() -> list[Metric]:
    """Separate and solve every pair."""
    pairs = [Outcome(**kept("tests.benchmarks.bench_people", f"pair {n}", partial(_pair, n))) for n in range(SEEDS)]
    together = np.array([p.together_mm for p in pairs])
    return [
        Metric("wrong_number", float(sum(p.found != 2 for p in pairs)), "pairs"),
        Metric("exchanged", float(sum(p.mixed for p in pairs)), "boxes"),
        Metric("missed", 100 * max(p.missed for p in pairs), "%", abs_tol=0.2),
        Metric("together", float(together.mean()), "mm", rel_tol=0.03),
        Metric("against_alone", max(p.ratio for p in pairs), "times", rel_tol=0.03),
        Metric("beyond_bound", float(sum(p.ratio > BOUND_RATIO for p in pairs)), "pairs"),
    ]


def pair(seed: int) -> Outcome:
    """Return the result of a seed's pair."""
    filmed = crossing(
        (take_named(TAKES[seed]), take_named(TAKES[(seed + 3) % len(TAKES)])), BenchmarkSettings(seed=seed)
    )
    found = select_people(filmed.cameras, filmed.detections, filmed.fps)
    counts = np.array([_counts(person, filmed) for person in found])
    owner = counts.argmax(axis=1)
    mixed = int(counts.sum() - counts.max(axis=1).sum())
    missed = 1.0 - counts.sum() / max((filmed.who >= 0).sum(), 1)
    together = [_error(filmed, i, found[int(np.flatnonzero(owner == i)[0])].keypoints) for i in (0, 1)]
    alone = [_error(filmed, i, filmed.alone[i]) for i in (0, 1)]
    return Outcome(len(found), mixed, float(missed), (together[0], together[1]), (alone[0], alone[1]))


def _pair(seed: int) -> dict[str, Any]:
    return asdict(pair(seed))


def _counts(person: SelectedPerson, filmed: Crossing) -> list[int]:
    """Return the number of a found person's detections that belong to each of the two people."""
    views, frames = np.indices(person.detection.shape)
    who = np.where(person.detection >= 0, filmed.who[views, frames, person.detection], -1)
    return [int((who == i).sum()) for i in (0, 1)]


def _error(filmed: Crossing, person: int, keypoints: Keypoints2D) -> float:
    """Return the mean joint error of a solve in mm."""
    motion = solve(Capture("pair", cameras=filmed.cameras, keypoints=keypoints)).motion
    return mpjpe_mm(motion.joints[:, :22], filmed.joints[person][:, :22])


if __name__ == "__main__":
    for number in range(SEEDS):
        sys.stdout.write(f"seed {number}: {pair(number)}\n")
        sys.stdout.flush()
