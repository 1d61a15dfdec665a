"""Benchmark captures by name, created once and stored under ``build/benchmark_captures`` by the hash of their inputs.

``python -m tests.benchmarks.comparison.captures [--views N ...] [--takes N] [--bad CASE ...]`` creates and describes
them.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import json
import re
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from research.simulation import bad_input, benchmark, filming, occlusion
from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.body.body import DEFAULT_BODY
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.synthesis import faults
from solver_backend.synthesis.simulation import cast, keypoint_detector
from solver_backend.synthesis.simulation import keypoint_detector as faces
from solver_backend.types import Capture
from tests.benchmarks.comparison import validation_takes
from tests.benchmarks.comparison.validation_takes import take_named

FOLDER = Path(__file__).resolve().parents[3] / "build" / "benchmark_captures"
_SOURCES = (
    benchmark, filming, cast, keypoint_detector, keypoint_detector, occlusion, faces, bad_input, faults,
    validation_takes,
)  # fmt: skip
TAKES = (
    "13_29:600+600", "salsa_07:20+600", "03_03:60+600", "salsa_11:270+600", "13_29:1200+600", "03_04:1200+600",
)  # fmt: skip
"""Name, first frame and number of frames: exercises, walking over obstacles, dance. They avoid the initial T-poses and
the tracking jumps of the recordings (up to 5,900 m/s², compared with 100-280 m/s² here)."""
LONG_TAKE = "13_29:200+2000"
WALKER = "08_01:10+125"
"""Take of the person who walks through the volume."""


def filmed(take: str, settings: BenchmarkSettings = BenchmarkSettings(), bad: str | None = None) -> Capture:
    """Return the capture of a take, optionally with one of ``BAD``, from the cache if it is there.

    Takes are "NAME:START+FRAMES" or, forwards and backwards in turn, "NAME:START+FRAMES*TIMES".

    Raises:
        BenchmarkSkipped: the validation motions are missing.
    """
    path = capture_path(take, settings, bad)
    if path.exists():
        return read_capture(path)
    capture = benchmark_capture(take_of(take), settings)
    if bad is not None:
        capture = BAD[bad](capture)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_capture(path, capture, overwrite=True)
    return read_capture(path)


def capture_path(take: str, settings: BenchmarkSettings, bad: str | None = None) -> Path:
    """Return the path at which a capture is stored."""
    stem = "_".join(re.split(r"[:+*]", take))
    return FOLDER / f"{stem}_{settings.num_views}views_{_key(take, settings, bad)}.npz"


def take_of(spec: str) -> cast.Take:
    """Return the take for "NAME:START+FRAMES*TIMES", see ``filmed``."""
    name, _, part = spec.partition(":")
    start, _, frames = part.partition("+")
    frames, _, times = frames.partition("*")
    return there_and_back(take_named(name, int(frames) if frames else None, int(start or 0)), int(times or 1))


def there_and_back(take: cast.Take, times: int) -> cast.Take:
    """Return a take ``times`` as long, played forwards and backwards in turn."""
    order = np.arange(len(take.rotations))
    frames = np.concatenate([order[:: 1 - 2 * (n % 2)] for n in range(times)])
    return replace(take, rotations=take.rotations[frames], root=take.root[frames])


def _key(take: str, settings: BenchmarkSettings, bad: str | None) -> str:
    parts = [take, json.dumps(asdict(settings), sort_keys=True), str(bad), *map(inspect.getsource, _SOURCES)]
    digest = hashlib.sha256("\0".join(parts).encode())
    digest.update(DEFAULT_BODY.read_bytes())
    return digest.hexdigest()[:12]


def _walker() -> cast.Take:
    return take_of(WALKER)


BAD: dict[str, Callable[[Capture], Capture]] = {
    "bumped": lambda c: bad_input.bumped(c, 1),
    "bumped_midway": lambda c: bad_input.bumped(c, 1, first=c.num_frames // 2),
    "exchanged_names": lambda c: bad_input.calibrations_exchanged(c, 0, 2),
    "unsynchronised": lambda c: bad_input.unsynchronised(c, 1),
    "passerby": lambda c: bad_input.with_passerby(c, _walker())[0],
    "passerby_stolen": lambda c: bad_input.with_passerby(c, _walker(), single_person_detector=True)[0],
    "away": lambda c: bad_input.away(c, c.num_frames // 3),
    "mirrored": lambda c: bad_input.mirrored(c, 1),
    "sides_exchanged": lambda c: bad_input.sides_exchanged(c, 1),
}
"""Functions that add a fault, by name."""


def main(argv: list[str]) -> int:
    """Create captures and describe them."""
    parser = argparse.ArgumentParser(prog="captures", description=__doc__)
    parser.add_argument("--views", type=int, nargs="+", default=[4])
    parser.add_argument("--takes", type=int, default=2)
    parser.add_argument("--bad", nargs="*", default=[], choices=sorted(BAD))
    args = parser.parse_args(argv)
    for number, take in enumerate(TAKES[: args.takes]):
        for views in args.views:
            for bad in (None, *args.bad):
                capture = filmed(take, BenchmarkSettings(num_views=views, seed=number), bad)
                sys.stdout.write(f"{take:<18} {views} views {bad or '':<16} {describe(capture)}\n")
    return 0


def describe(capture: Capture) -> str:
    """Return a line about the faults in a capture."""
    truth, seen = capture.truth, capture.require_multiview()[1].confidence > 0
    where = f", view {truth['bad_view'].tolist()} frames {truth['bad_frames'].tolist()}" if "bad_view" in truth else ""
    return (
        f"{capture.num_frames} frames, {100 * (1 - seen.mean()):.1f} % missing, {len(truth['swaps'])} exchanges over "
        f"{int(np.diff(truth['swaps'][:, 2:]).sum())} frames, {100 * truth['outlier'].mean():.1f} % outliers{where}"
    )


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
