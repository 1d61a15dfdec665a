"""Ten spoiled captures of four cameras, read and not solved: how far they are from what the unspoiled ones are read as.

The person is triangulated by the cameras that were read, laid over the same frames of the unspoiled reading rigidly.
What is read alike is solved alike, so a solve (``bench_spoiled``) adds nothing where this is less than a millimetre.
Where a stature is asked for, it is given; of those the scale against the unspoiled is measured beside.
``python -m tests.benchmarks.bench_spoiled_readings [--seeds FIRST END] [--record FILE] [KIND ...]`` prints every seed.
Needs the motions kept beside the repository (or MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict, dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.exchange.diagnostics import warnings_in
from solver_backend.geometry.alignment import umeyama
from solver_backend.io.load import load_capture
from solver_backend.types import Capture
from tests.benchmarks.bench_spoiled import FILM_FRAMES, SEEDS, TAKE_FRAMES, film, recording_from
from tests.benchmarks.metric import Metric
from tests.benchmarks.spoiled_views.kinds import KINDS
from tests.benchmarks.spoiled_views.trial import write_recording

TOGETHER = tuple(kind for kind in KINDS if "apart" not in kind)
"""Kinds of cameras that start together, whose frames are the unspoiled ones'."""
ALIKE_MM = 1.0
"""Up to which readings are the same; a solve's error is 8 to 25 mm."""
STATED_UNKNOWN = "own unit"
"""The kind whose scale only a stature gives."""


@dataclass(frozen=True)
class Reading:
    """What became of one seed of one kind."""

    kind: str
    seed: int
    off_mm: float
    """Mean distance of points from the unspoiled reading's, laid over them by a similarity."""
    scale: float
    """Of the unspoiled person against this one."""
    tilt_deg: float
    """Angle between the two worlds' up."""
    codes: tuple[str, ...]
    """What was warned of."""

    @property
    def alike(self) -> bool:
        """Whether it is read as the unspoiled one is."""
        return self.off_mm < ALIKE_MM and (abs(self.scale - 1) < 1e-3 or self.kind == STATED_UNKNOWN)


def run() -> list[Metric]:
    """Read every seed of every kind."""
    found = [read(kind, seed) for seed, kind in product(range(SEEDS), TOGETHER)]
    keys = {kind: kind.replace(",", "").replace(" ", "_") for kind in TOGETHER}
    return [
        Metric(keys[kind], sum(r.alike for r in found if r.kind == kind) / SEEDS, "of 1", "higher") for kind in TOGETHER
    ]


def read(kind: str, seed: int) -> Reading:
    """Return how a seed's capture is read if it is spoiled so."""
    whole = recording_from(film(seed), FILM_FRAMES - TAKE_FRAMES)
    spoiled = KINDS[kind](whole, np.random.default_rng(seed), seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial"
        write_recording(path, film(seed), spoiled)
        stature = _stature(seed) if kind == STATED_UNKNOWN else None
        capture = load_capture(path, stature=stature) if stature else load_capture(path)
    points, unspoiled = _points(capture), _unspoiled(seed)
    both = np.isfinite(points).all(-1) & np.isfinite(unspoiled).all(-1)
    a, b = points[both], unspoiled[both]
    scale = float(np.sqrt(((b - b.mean(0)) ** 2).sum() / ((a - a.mean(0)) ** 2).sum()))
    _, R, t = umeyama(scale * a, b)
    off = 1e3 * float(np.linalg.norm(scale * a @ R.T + t - b, axis=-1).mean())
    tilt = float(np.degrees(np.arccos(np.clip(R[2, 2], -1, 1))))
    codes = tuple(item.code for item in warnings_in(capture.problems))
    return Reading(kind, seed, round(off, 3), round(scale, 5), round(tilt, 2), codes)


@cache
def _unspoiled(seed: int) -> np.ndarray:
    cameras, keypoints = film(seed).require_multiview()
    rows = slice(FILM_FRAMES - TAKE_FRAMES, None)
    return np.asarray(triangulate(cameras, keypoints.xy[:, rows], keypoints.confidence[:, rows]).points)


def _points(capture: Capture) -> np.ndarray:
    cameras, keypoints = capture.require_multiview()
    return np.asarray(triangulate(cameras, keypoints.xy, keypoints.confidence).points)


def _stature(seed: int) -> float:
    body = load_body()
    rest = body.v_template + body.shapedirs[..., :10] @ film(seed).truth["betas"][:10]
    return float(np.ptp(rest[:, 1]))


def main(argv: list[str]) -> int:
    """Print what became of every seed, one line of JSON each."""
    parser = argparse.ArgumentParser(prog="bench_spoiled_readings", description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(TOGETHER)}; all if left out")
    parser.add_argument("--seeds", type=int, nargs=2, metavar=("FIRST", "END"), default=(0, SEEDS))
    parser.add_argument("--record", type=Path, help="file to which lines are added")
    args = parser.parse_args(argv)
    for seed, kind in product(range(*args.seeds), args.kinds or TOGETHER):
        line = json.dumps(asdict(read(kind, seed))) + "\n"
        sys.stdout.write(line)
        sys.stdout.flush()
        if args.record:
            with args.record.open("a", encoding="utf-8") as file:
                file.write(line)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
