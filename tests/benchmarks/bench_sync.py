"""Ten benchmark captures of a minute with four cameras started by hand within 3 s, and clocks off by up to 50 ppm.

The figure is the largest difference of estimated and true clocks in the take, in frames at 60 Hz, relative to the first
camera: with calibrated cameras (limit: 0.1 frames), and by keypoint speeds without any calibration. Needs the motions
next to the repository (or MOCAP_SHARED_DATA). ``python -m tests.benchmarks.bench_sync`` prints every seed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from research.simulation.benchmark import JOINT_SET, BenchmarkSettings
from research.simulation.filming import FilmSettings, around, film
from solver_backend.exchange.errors import MocapError
from solver_backend.synthesis.simulation.cast import Take, cast_person
from solver_backend.synthesis.simulation.keypoint_detector import miscalibrated
from solver_backend.videos.sync.clocks import Clocks
from solver_backend.videos.sync.synchronise import FilmedTracks, clocks_by_geometry, clocks_by_speeds
from tests.benchmarks.comparison.validation_takes import take_named
from tests.benchmarks.kept_parts import kept
from tests.benchmarks.metric import Metric

TAKES = (
    ("13_29", 0), ("salsa_07", 0), ("03_03", 0), ("salsa_11", 0), ("03_04", 0),
    ("13_29", 480), ("salsa_09", 0), ("03_03", 480), ("salsa_24", 0), ("03_04", 480),
)  # fmt: skip
SEEDS, FRAMES = 10, 3600
"""Number of seeds, and frames of a minute. The motions of 15 to 38 s are played forwards and backwards."""
REACH_S = 6.5
LARGEST_OFFSET_S, LARGEST_PPM = 3.0, 50.0
BOUND_FRAMES = 0.1
UNKNOWN_FRAMES = 100.0
"""Error of a seed whose clocks are not found."""


@dataclass(frozen=True)
class FilmedByHand:
    """A filmed take and its true clocks."""

    filmed: FilmedTracks  # Tracks in four views.
    offset_s: np.ndarray  # (C,) true offsets in seconds in the middle of the take.
    rate: np.ndarray  # (C,) true rates.
    middle_s: float  # Middle of the take on the first camera's clock.

    def error_frames(self, clocks: Clocks) -> np.ndarray:
        """Return the (C,) largest errors within the take in frames."""
        times = np.linspace(0.0, 2.0 * self.middle_s, 20)
        true = self.offset_s[:, None] + self.rate[:, None] * (times - self.middle_s)
        found = np.stack([clocks.in_video(c, times) - times for c in range(len(true))])
        return np.abs(found - true).max(axis=1) * self.filmed.fps


def run() -> list[Metric]:
    """Estimate the clocks of every seed, with and without calibration."""
    found = [kept("tests.benchmarks.bench_sync", f"seed {seed}", partial(errors_of, seed)) for seed in range(SEEDS)]
    calibrated, speeds = (np.array([row[way] for row in found]) for way in ("calibrated", "speeds"))
    return [
        Metric("largest_error", float(calibrated.max()), "frames", abs_tol=0.01),
        Metric("median_error", float(np.median(calibrated[:, 1:])), "frames", abs_tol=0.01),
        Metric("beyond_bound", float((calibrated > BOUND_FRAMES).sum()), "cameras"),
        Metric("uncalibrated_largest", float(speeds.max()), "frames", abs_tol=0.1),
        Metric("uncalibrated_median", float(np.median(speeds[:, 1:])), "frames", abs_tol=0.05),
    ]


def errors_of(seed: int) -> dict[str, list[float]]:
    """Return the largest error of each camera's clock in frames, with calibrated cameras and by speeds alone."""
    take = filmed_by_hand(seed)
    return {"calibrated": _with_cameras(take).tolist(), "speeds": _by_speeds(take).tolist()}


def _with_cameras(take: FilmedByHand) -> np.ndarray:
    try:
        return take.error_frames(clocks_by_geometry(take.filmed, REACH_S))
    except MocapError:
        return np.full(len(take.rate), UNKNOWN_FRAMES)


def _by_speeds(take: FilmedByHand) -> np.ndarray:
    filmed = take.filmed
    try:
        found = clocks_by_speeds(filmed.cameras.names, filmed.tracks, filmed.times_s, filmed.joint_set, REACH_S)
    except MocapError:
        return np.full(len(take.rate), UNKNOWN_FRAMES)
    return take.error_frames(found)


def filmed_by_hand(seed: int) -> FilmedByHand:
    """Return the take of a seed, with a different motion, person, noise and clocks for each."""
    name, start = TAKES[seed % len(TAKES)]
    take, settings = there_and_back(take_named(name, None, start)), BenchmarkSettings(seed=seed)
    count = len(take.rotations)
    rng = np.random.default_rng(1000 + seed)
    person = cast_person(take, rng)
    pelvis = person.landmarks(JOINT_SET).skeleton.joints[:, 0]
    cameras = around(pelvis, settings.num_views)
    late_s = np.r_[0.0, rng.uniform(0.0, LARGEST_OFFSET_S, len(cameras) - 1)]
    rate = np.r_[0.0, rng.uniform(-LARGEST_PPM, LARGEST_PPM, len(cameras) - 1) * 1e-6]
    # A camera with the delay late_s shows the time late_s + n (1 - rate) / fps in its frame n.
    frames = np.arange(count)
    cut = np.floor(late_s * take.fps).astype(int)
    part = late_s * take.fps - cut
    delays = np.stack([rate[c] * (frames - cut[c]) - part[c] for c in range(len(cameras))])
    offsets = 1e-3 * settings.anatomy_mm * rng.normal(size=(JOINT_SET.num_keypoints, 3))
    found = film(person, cameras, FilmSettings(JOINT_SET, take.fps, settings.detector, offsets, delays), rng)
    tracks = [found.xy[c, cut[c] : count - 1] for c in range(len(cameras))]
    middle_s = 0.5 * (count - 1) / take.fps
    # Its clock shows s = (t - late) / (1 - rate), which is t + offset + rate (t - middle) to first order in the rate.
    offset_s = (middle_s - late_s) / (1.0 - rate) - middle_s
    filmed = FilmedTracks(
        miscalibrated(cameras, pelvis.mean(axis=0), settings.calibration_mm, rng),
        tracks,
        [np.arange(len(track)) / take.fps for track in tracks],
        JOINT_SET,
        take.fps,
    )
    return FilmedByHand(filmed, offset_s, 1.0 / (1.0 - rate) - 1.0, middle_s)


def there_and_back(take: Take) -> Take:
    """Return a take of ``FRAMES`` frames, played forwards and backwards in turn."""
    count = len(take.rotations)
    turn = np.r_[np.arange(count), np.arange(count - 2, 0, -1)]
    order = np.resize(turn, FRAMES)
    return replace(take, rotations=take.rotations[order], root=take.root[order])


if __name__ == "__main__":
    for number in range(SEEDS):
        with_cameras, without = (np.round(errors, 3) for errors in errors_of(number).values())
        sys.stdout.write(f"seed {number}: calibrated {with_cameras}, speeds alone {without} frames\n")
        sys.stdout.flush()
