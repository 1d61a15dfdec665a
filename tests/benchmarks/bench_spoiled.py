"""Ten benchmark captures of four cameras with typical faults of recordings: each one with every one of ``KINDS``.

Each is written as a Pose2Sim trial, read and solved without options. If a stature is requested, the benchmark supplies
it. If a reading equals the original one (triangulated within 0.1 mm), it gets the same result without a solve. Solved
captures are within 1.15 times the error of the original frames (joints, rigidly aligned with the truth), with a world
that is level within 5 degrees. Silent captures exceed that without a warning or refusal. If a stature was requested,
the scale has a stated deviation, and within twice this deviation the error is measured at the truth's size. Needs the
motions next to the repository (or MOCAP_SHARED_DATA). ``python -m tests.benchmarks.bench_spoiled [--seeds FIRST END]
[--page PAGE] [KIND ...]`` prints every seed and records it under ``build``, so that it can run in parts. The page and
``dev.py bench spoiled`` use the record. ``LIES`` only run by name.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import solver_backend
from research.simulation.benchmark import BenchmarkSettings
from solver_backend.body.body import load_body
from solver_backend.exchange.outputs import write_text
from solver_backend.types import Capture
from tests.benchmarks.bench_sync import TAKES
from tests.benchmarks.comparison.captures import filmed
from tests.benchmarks.metric import Metric
from tests.benchmarks.spoiled_views.kinds import KINDS, Recording
from tests.benchmarks.spoiled_views.lies import LIES
from tests.benchmarks.spoiled_views.page import page_of
from tests.benchmarks.spoiled_views.readings import difference, points_of
from tests.benchmarks.spoiled_views.trial import CHANGES, Result, result_of

SEEDS, SEEDS_OF_TWO = 10, 3  # Number of captures per kind, and per kind with two faults.
RECORD = Path(__file__).resolve().parents[2] / "build" / "benchmark_spoiled.jsonl"
SOURCES = Path(solver_backend.__file__).parent
FILM_FRAMES, TAKE_FRAMES = 900, 240
"""Frames of a film, long enough for cameras that start apart, and of other takes, its last four seconds."""
WITHIN, LEVEL_DEG = 1.15, 5.0
"""Largest factor of the unspoiled error, and largest tilt of a level world. A person's stance has up to 3°."""
SCALE_SIGMAS, STATURE_SHARE = 2.0, 0.015
"""Deviations of a scale from a stature, and the deviation that its note states. Equal statures have different legs."""


@dataclass(frozen=True)
class Found:
    """Result of one seed of one kind."""

    result: Result
    unspoiled_mm: float
    stature_given: bool = False

    @property
    def solved(self) -> bool:
        """True if the error is similar to the original capture's, in a level world."""
        found = self.result
        sized = self.stature_given and abs(found.scale - 1) <= SCALE_SIGMAS * STATURE_SHARE
        error = found.shape_mm if sized else found.error_mm
        return error <= WITHIN * self.unspoiled_mm and found.tilt_deg <= LEVEL_DEG

    @property
    def silent(self) -> bool:
        """True if the result is wrong without a warning."""
        return not self.solved and self.result.silent


def run() -> list[Metric]:
    """Count the results of every seed of every kind. Recorded results of this program are not repeated."""
    rows = _recorded(RECORD, _all_kinds())
    metrics = []
    for kind in KINDS:
        found = [row for row in rows if row["kind"] == kind]
        key = kind.replace(",", "").replace(" ", "_")
        metrics += [
            Metric(f"{key}_solved", sum(r["state"] == "solved" for r in found) / len(found), "of 1", "higher"),
            Metric(f"{key}_silent", float(sum(r["state"] == "silent" for r in found)), "seeds"),
        ]
    plain = [row for row in rows if row["kind"] == "as it should be"]
    return [*metrics, Metric("unspoiled_corrected", float(sum(bool(r["changes"]) for r in plain)), "seeds")]


def tried(kind: str, seed: int) -> Found:
    """Add a fault to a seed's capture, read it, and solve it unless the reading equals the original capture's."""
    capture = film(seed)
    rng, first = np.random.default_rng(seed), FILM_FRAMES - TAKE_FRAMES
    if kind in LIES:
        spoiled = LIES[kind](recording_from(capture, first), rng, seed)
    else:
        spoiled = KINDS[kind](_recording(capture), rng, seed)
        first = first if spoiled.starts is None else int(spoiled.starts.max())
        spoiled = spoiled if spoiled.starts is not None else _from(spoiled, first)
    joints = np.asarray(capture.truth["joints"])
    if kind == "still":
        joints = np.repeat(joints[first : first + 1], len(joints), axis=0)
    unspoiled = _unspoiled(seed, first)

    def known(read: Capture) -> Result | None:
        unlike = difference(points_of(read), unspoiled.points)
        return unspoiled.result if unlike is not None and unlike.alike else None

    result = result_of(capture, spoiled, joints, known)
    asked = "--stature" in result.refused
    if asked:
        body = load_body()
        rest = body.v_template + body.shapedirs[..., :10] @ capture.truth["betas"][:10]
        result = result_of(capture, spoiled, joints, stature=float(np.ptp(rest[:, 1])))
    return Found(result, unspoiled.result.error_mm, asked)


@dataclass(frozen=True)
class _Unspoiled:
    """Capture of a seed without faults."""

    result: Result
    points: np.ndarray
    """(F, K, 3) triangulated points in metres."""


@cache
def _unspoiled(seed: int, first: int) -> _Unspoiled:
    capture, points = film(seed), []

    def known(read: Capture) -> None:
        points.append(points_of(read))

    result = result_of(capture, recording_from(capture, first), np.asarray(capture.truth["joints"])[first:], known)
    return _Unspoiled(result, points[0])


@lru_cache(maxsize=2)
def film(seed: int) -> Capture:
    """Return fifteen seconds of a take as a seed's capture."""
    name, start = TAKES[seed % len(TAKES)]
    start = min(start, 200) if name == "03_04" else start
    return filmed(f"{name}:{start}+{FILM_FRAMES}", BenchmarkSettings(seed=seed))


def recording_from(capture: Capture, first: int) -> Recording:
    """Return the files of the capture from a frame on."""
    return _from(_recording(capture), first)


def _recording(capture: Capture) -> Recording:
    cameras, keypoints = capture.require_multiview()
    return Recording(keypoints.xy, keypoints.confidence, cameras, cameras.names)


def _from(recording: Recording, first: int) -> Recording:
    return replace(recording, xy=recording.xy[:, first:], confidence=recording.confidence[:, first:])


def main(argv: list[str]) -> int:
    """Print the result of every seed as a line of JSON, without recorded results."""
    parser = argparse.ArgumentParser(prog="bench_spoiled", description=__doc__)
    kinds = ", ".join(KINDS | LIES).replace("%", "%%")
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {kinds}; those that can be corrected if left out")
    parser.add_argument("--seeds", type=int, nargs=2, metavar=("FIRST", "END"), help="of the kinds that are named")
    parser.add_argument("--record", type=Path, default=RECORD, help="file to which lines are added")
    parser.add_argument("--page", type=Path, help="page that is written of the record, instead of solving")
    args = parser.parse_args(argv)
    if args.page:
        write_text(args.page, page_of(rows_of(args.record)), overwrite=True)
        return 0
    named = product(range(*args.seeds or (0, SEEDS)), args.kinds)
    _recorded(args.record, list(named) if args.kinds else _all_kinds())
    return 0


def _all_kinds() -> list[tuple[int, str]]:
    """Return seeds and kinds, all kinds of one seed together, because they share its film."""
    two = [kind for kind in KINDS if "," in kind]
    return [*product(range(SEEDS), [kind for kind in KINDS if kind not in two]), *product(range(SEEDS_OF_TWO), two)]


def _recorded(record: Path, wanted: Sequence[tuple[int, str]]) -> list[dict[str, Any]]:
    """Return the rows of these seeds and kinds. Missing rows are measured, printed and recorded."""
    rows = {(row["kind"], row["seed"]): row for row in rows_of(record)}
    record.parent.mkdir(parents=True, exist_ok=True)
    for seed, kind in wanted:
        if (kind, seed) not in rows:
            row = rows[kind, seed] = row_of(kind, seed, tried(kind, seed))
            line = json.dumps(row) + "\n"
            sys.stdout.write(line)
            sys.stdout.flush()
            with record.open("a", encoding="utf-8") as file:
                file.write(line)
    return [rows[kind, seed] for seed, kind in wanted]


def row_of(kind: str, seed: int, found: Found) -> dict[str, Any]:
    """Return a seed's result as plain values."""
    state = "solved" if found.solved else "silent" if found.silent else "refused" if found.result.refused else "warned"
    result = found.result
    return {
        "kind": kind, "seed": seed, "state": state, "error_mm": round(result.error_mm, 2),
        "unspoiled_mm": round(found.unspoiled_mm, 2), "tilt_deg": round(result.tilt_deg, 2), "refused": result.refused,
        "shape_mm": round(result.shape_mm, 2), "scale": round(result.scale, 4), "program": program(),
        "changes": sorted(CHANGES.intersection(result.codes)), "warnings": list(result.warnings),
    }  # fmt: skip


def rows_of(record: Path) -> list[dict[str, Any]]:
    """Return the rows of a record from this version of the program."""
    lines = record.read_text("utf-8").splitlines() if record.is_file() else []
    return [row for line in lines if (row := json.loads(line))["program"] == program()]


@cache
def program() -> str:
    """Return a digest of the code that reads and solves."""
    digest = hashlib.sha256()
    for path in sorted(SOURCES.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
