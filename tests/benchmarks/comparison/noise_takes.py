"""Fit markers with three kinds of noise on each take: ``python -m tests.benchmarks.comparison.noise_takes``.

Twelve takes have 50 frames at 30 Hz and one simulated body each. They start like ``many_takes``, so no prior and no
network was trained on them. Markers are exactly at the layout's positions. Every finished part is written to
``noise_takes.json`` immediately, as in ``many_takes``. Inference noise has no randomness and therefore one seed. Needs
the validation motions (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from research.baselines import marker_fits
from research.baselines.marker_fits import AdaptiveRobust, MoSh
from research.simulation import marker_noise
from research.simulation.marker_noise import DataNoise
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import pipeline
from solver_backend.fitters.label_first import labelled_capture
from solver_backend.fitters.pipeline import solve, solve_problem
from solver_backend.fitters.problem import Problem
from solver_backend.geometry.rotations import exp_so3
from solver_backend.labelling import point_network
from solver_backend.labelling.outputs import MARKERS
from solver_backend.metrics import angle_mae_deg, pck_percent, rmse_mm
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture, MarkerCloud, Motion
from tests.benchmarks.comparison.code_version import code_version
from tests.benchmarks.comparison.kept_runs import resume
from tests.benchmarks.comparison.landmark_takes import NOISES, LandmarkTake
from tests.benchmarks.comparison.many_takes import TAKES as LONGER_TAKES
from tests.benchmarks.comparison.validation_takes import take_named, training_take

RESULTS = Path(__file__).parents[1] / "noise_takes.json"
TAKES = tuple(take.partition("+")[0] for take in LONGER_TAKES)
"""Name and first frame."""
FRAMES, HZ = 50, 30.0
SEEDS = (0, 1, 2)  # Seeds of the data noise.
SEARCHED = ("09_01", 20, 24)  # Training clip of the grid search, its first frame, and its number of frames.
ALPHAS = (-7.0, -4.5, -2.0, -1.0, 0.0, 1.0, 2.0)
"""Coarse grid within the thesis' range. Midpoints between the best value and its neighbours follow."""
ALPHA = 0.5
"""Shape of Barron's loss with the smallest error on ``SEARCHED``, as ``best_alpha`` finds it."""
PUBLISHED, OURS, LEAST_SQUARES, BARRON = "noise-aware", "ours", "MoSh++", "Barron"
JOINTS = "markers and joints"
POINTS = {"markers": (LEAST_SQUARES, BARRON, PUBLISHED, OURS), JOINTS: (PUBLISHED,)}
"""Fitted landmarks, and the methods that fit them. The thesis has joints only for its own method."""
NAMELESS = "no names"
"""Kind of the clouds without point names, with markers moved by up to 2 cm as in the network's training."""
MILD = DataNoise(displacement_m=0.02)

Row = dict[str, float]
Solver = Callable[[Problem], Motion]


def solvers(alpha: float = ALPHA) -> dict[str, Solver]:
    """Return every method for named points by its table name."""
    return {
        LEAST_SQUARES: MoSh().motion_of,
        BARRON: AdaptiveRobust(alpha).motion_of,
        PUBLISHED: lambda problem: solve_problem(problem, SolveSettings(method="noise-aware")).motion,
        OURS: lambda problem: solve_problem(problem, SolveSettings()).motion,
    }


def cloud_solvers() -> dict[str, Callable[[Capture], Motion]]:
    """Return the methods from points without names to a motion, which the paper's table 4 compares."""
    published = SolveSettings(method="noise-aware")
    return {
        "labels first, noise-aware": lambda capture: solve(labelled_capture(capture)[0], published).motion,
        "direct, markers": lambda capture: solve(capture, replace(published, landmarks="network")).motion,
    }


@dataclass(frozen=True)
class Part:
    """One method on one take with one noise."""

    noise: str  # One of ``NOISES`` or ``NAMELESS``.
    points: str  # One of ``POINTS``, empty for clouds.
    method: str
    take: str
    seed: int

    @property
    def name(self) -> str:
        """Name of the part in the tables."""
        return ", ".join(part for part in (self.noise, self.points, self.method) if part)

    @property
    def code(self) -> str:
        """Hash of the code and the weights that the figures depend on."""
        solving = marker_fits if self.method in (LEAST_SQUARES, BARRON) else pipeline
        modules = (solving, marker_noise, point_network)
        return "".join(code_version(module.__name__)[:4] for module in modules)

    def measure(self) -> Row:
        """Solve and return the figures."""
        number = TAKES.index(self.take)
        take, seed = performed(number), 100 * self.seed + number
        if self.noise == NAMELESS:
            row = of_cloud(take, cloud_solvers()[self.method], seed)
        else:
            row = row_of(take, self.noise, self.points == JOINTS, solvers()[self.method], seed)
        return {column: float(f"{value:.4g}") for column, value in row.items()}


def parts() -> Iterator[Part]:
    """Yield the parts in order: all parts of one seed before the next, and published methods before the others."""
    fits = [(noise, points, method) for noise in NOISES for points, methods in POINTS.items() for method in methods]
    fits += [(NAMELESS, "", method) for method in cloud_solvers()]
    published, rest = ([fit for fit in fits if (fit[2] == OURS) is ours] for ours in (False, True))
    for seed in SEEDS:
        for group in (published, rest):
            for take in TAKES:
                yield from (Part(*fit, take, seed) for fit in group if fit[0] != "inference" or seed == SEEDS[0])


@cache
def performed(number: int) -> LandmarkTake:
    """Return the take with this number, performed by a body of random shape."""
    name, _, first = TAKES[number].partition(":")
    step = round(take_named(name, 1).fps / HZ)
    take = take_named(name, step * FRAMES, int(first))
    take = replace(take, rotations=take.rotations[::step], root=take.root[::step], fps=take.fps / step)
    return LandmarkTake.of(take, number)


def row_of(take: LandmarkTake, noise: str, joints: bool, solver: Solver, seed: int) -> Row:
    """Return the figures of a method on one take."""
    measured = take.measured(noise, joints=joints, seed=seed)
    return _figures(take, solver(Problem.of(take.body, load_sposer(), measured)))


def of_cloud(take: LandmarkTake, solver: Callable[[Capture], Motion], seed: int) -> Row:
    """Return the figures of a method on a cloud without names."""
    points = MILD.cloud(take.points[:, : len(MARKERS)], np.random.default_rng(seed))
    return _figures(take, solver(Capture(take.name, markers=MarkerCloud(points, take.fps))))


def _figures(take: LandmarkTake, motion: Motion) -> Row:
    found, local = motion.joints, exp_so3(motion.body_pose[:, :63].reshape(-1, 21, 3))
    pck = {f"pck{cm}": pck_percent(found, take.joints, 0.01 * cm) for cm in (1, 3, 7)}
    return {"rmse_mm": rmse_mm(found, take.joints), "mae_deg": angle_mae_deg(local, take.local), **pck}


@lru_cache(maxsize=1)
def best_alpha() -> tuple[float, Mapping[float, float]]:
    """Return the α with the smallest RMSE on a training motion with data noise, and all tried values (figure 5.2)."""
    name, start, count = SEARCHED
    take = LandmarkTake.of(training_take(name, count, start), 9)
    tried: dict[float, float] = {}

    def attempt(alpha: float) -> None:
        tried[alpha] = row_of(take, "data", False, solvers(alpha)[BARRON], 9)["rmse_mm"]

    for alpha in ALPHAS:
        attempt(alpha)
    ordered, best = sorted(tried), min(tried, key=tried.__getitem__)
    place = ordered.index(best)
    for neighbour in ordered[max(place - 1, 0) : place] + ordered[place + 1 : place + 2]:
        attempt(0.5 * (best + neighbour))
    return min(tried, key=tried.__getitem__), dict(sorted(tried.items()))


def measured(argv: list[str]) -> dict[str, dict[str, dict[str, Any]]]:
    """Measure missing parts, and return the figures by method, take and seed."""
    return resume(list(parts()), RESULTS, argv)


if __name__ == "__main__":
    measured(sys.argv[1:])
