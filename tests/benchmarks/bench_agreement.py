"""Faults of calibrations and detections, one or two at once, on takes of recorded motions.

A capture is repaired if its error is at most 1.15 times the unspoiled error (triangulated keypoints after a similarity,
with the delays that the solve measures). Other captures are refused or named, silent, or explained wrongly. The noise
is simulated. The metrics count the held-out takes. AGREEMENT_RECORD is a file that keeps tried cases, so that an
interrupted run resumes. ``python -m tests.benchmarks.bench_agreement [--held-out] [--takes N ...] [KIND ...]`` prints
all cases.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from solver_backend.agreement.explain import Explanation, explain
from solver_backend.agreement.reading import Reading, apply_reading
from solver_backend.agreement.synchronisation import Delays, estimate_delays, synchronised
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import FEET, LIMBS, Detections, JointSet, Keypoints2D
from tests.benchmarks.metric import Metric
from tests.benchmarks.spoiled_views import kinds, lies
from tests.benchmarks.spoiled_views.kinds import Recording
from tests.benchmarks.spoiled_views.motion_takes import FITTED, FPS, HELD_OUT, MotionTake, film

WITHIN, LEAST_MM = 1.15, 1.0  # Largest factor of the original error, and smallest limit in mm.
Spoil = Callable[[Recording, np.random.Generator], Recording]


def _all(recording: Recording) -> np.ndarray:
    return np.arange(len(recording.cameras))


def _one(recording: Recording, rng: np.random.Generator) -> np.ndarray:
    return np.array([int(rng.integers(len(recording.cameras)))])


def _half_turn(recording: Recording, chosen: np.ndarray) -> Recording:
    xy = recording.xy.copy()
    xy[chosen] = recording.cameras.image_size[chosen][:, None, None] - 1 - xy[chosen]
    return replace(recording, xy=xy)


def _turned_camera(recording: Recording, rng: np.random.Generator) -> Recording:
    R = recording.cameras.R.copy()
    t = recording.cameras.t.copy()
    (c,) = _one(recording, rng)
    turn = exp_so3(np.radians(15.0) * np.array([0.3, 0.95, 0.05]))
    R[c], t[c] = turn @ R[c], turn @ t[c]
    return replace(recording, cameras=replace(recording.cameras, R=R, t=t))


def _moved_camera(recording: Recording, rng: np.random.Generator) -> Recording:
    t = recording.cameras.t.copy()
    (c,) = _one(recording, rng)
    t[c] += recording.cameras.R[c] @ np.array([0.36, -0.48, 0.0])
    return replace(recording, cameras=replace(recording.cameras, t=t))


def _another_take(recording: Recording, rng: np.random.Generator) -> Recording:
    (c,) = _one(recording, rng)
    xy = recording.xy.copy()
    xy[c] = xy[c, ::-1] + np.array([60.0, -40.0])
    return replace(recording, xy=xy)


STATIC: dict[str, Spoil] = {
    "half size": lambda r, g: kinds.half_size(r),
    "one half size": lambda r, g: kinds.half_size(r, _one(r, g)),
    "turned": lambda r, g: kinds.quarter_turn(r, _all(r), True),
    "one turned": lambda r, g: _half_turn(r, _one(r, g)),
    "camera to world": lambda r, g: kinds.camera_to_world(r),
    "v from below": lambda r, g: lies.upside_down(r),
    "one mirrored": lambda r, g: lies.mirrored(r, _one(r, g)),
    "all mirrored": lambda r, g: lies.mirrored(r, _all(r)),
    "names": lambda r, g: lies.exchanged(r, g),
}
UNKNOWN: dict[str, Spoil] = {
    "one turned by 15": _turned_camera, "one moved 0.6 m": _moved_camera, "one of another take": _another_take,
}  # fmt: skip
DELAYS: dict[str, Spoil] = {
    "one late by 10": lambda r, g: lies.late(r, int(_one(r, g)[0]), 10),
    "one late by 4": lambda r, g: lies.late(r, int(_one(r, g)[0]), 4),
}  # fmt: skip
TWO: dict[str, Spoil] = {
    "half, camera to world": lambda r, g: kinds.camera_to_world(kinds.half_size(r)),
    "turned, one half": lambda r, g: kinds.half_size(kinds.quarter_turn(r, _all(r), False), _one(r, g)),
    "half, names": lambda r, g: lies.exchanged(kinds.half_size(r), g),
}
KINDS: dict[str, Spoil] = {"as it should be": lambda r, g: r} | STATIC | UNKNOWN | DELAYS | TWO


def detections_of(recording: Recording) -> Detections:
    """Return the detections of a recording."""
    people = *recording.xy.shape[:2], -1, JointSet.BODY_25.num_keypoints
    xy, confidence = recording.xy.reshape(*people, 2), recording.confidence.reshape(people)
    return Detections(recording.cameras.names, xy, confidence, JointSet.BODY_25)


REACH = 24  # Largest delay in frames that a solve considers.
_LIMBS = [k for k, n in enumerate(JointSet.BODY_25.keypoints) if n.endswith(LIMBS["arms"] + LIMBS["legs"] + FEET)]


def error_mm(
    recording: Recording, detections: Detections, truth: np.ndarray, found: Explanation
) -> tuple[float, Delays]:
    """Return the median error in mm of the triangulated keypoints after a similarity, and the measured delays.

    Delays do not fix a common time, so the error is the smallest one with any camera's clock as the true clock.
    """
    cameras, read = apply_reading(recording.cameras, detections, found.reading)
    confidence = read.confidence[:, :, 0].copy()
    confidence[list(found.reading.left_out)] = 0.0
    width = float(np.linalg.norm(np.ptp(cameras.centres, axis=0)))
    size = np.array([picture.size for picture in found.reading.pictures])[:, None, None]
    K = cameras.K.copy()  # the detector's noise has the same size in pixels of the calibrated pictures
    K[:, :2, :2], K[:, :2, 2] = K[:, :2, :2] / size, (K[:, :2, 2] + 0.5) / size[:, 0] - 0.5
    cameras = replace(cameras, K=K, t=cameras.t * (6.0 / max(width, 1e-6)))
    keypoints = Keypoints2D((read.xy[:, :, 0] + 0.5) / size[..., None] - 0.5, confidence, JointSet.BODY_25, FPS)
    delays = estimate_delays(cameras, np.where(confidence[..., None] > 0, keypoints.xy, np.nan)[:, :, _LIMBS], REACH)
    shift = np.where(delays.moved[:, None], np.nan_to_num(delays.at(keypoints.num_frames)), 0.0)
    keypoints = synchronised(keypoints, shift)
    points = np.asarray(triangulate(cameras, keypoints.xy, keypoints.confidence).points)
    lags = {0, *(-np.round(np.where(delays.moved, delays.frames, 0.0))).astype(int).tolist()}
    return min((_distance_mm(points, np.roll(truth, -lag, axis=0)) for lag in lags), default=float("nan")), delays


def _distance_mm(points: np.ndarray, truth: np.ndarray) -> float:
    known = np.isfinite(points).all(-1) & np.isfinite(truth).all(-1)
    if known.sum() < 0.2 * np.isfinite(truth).all(-1).sum():
        return float("nan")
    a, b = points[known], truth[known]
    a, b = a - a.mean(0), b - b.mean(0)
    a = a * np.sqrt((b**2).sum() / (a**2).sum())
    _, R, t = umeyama(a, b)
    return 1e3 * float(np.median(np.linalg.norm(a @ R.T + t - b, axis=-1)))


def try_case(take: MotionTake, kind: str, seed: int) -> tuple[str, str]:
    """Return the result for a take with faults, and a line of text about it."""
    filmed = film(take, seed)
    plain = filmed.recording
    unspoiled = Explanation(Reading.as_written(len(plain.cameras)), (), agrees=True, margin=np.inf, runner_up="")
    usual, _ = error_mm(plain, detections_of(plain), filmed.truth, unspoiled)
    spoiled = KINDS[kind](plain, np.random.default_rng(seed + 1000))
    detections = detections_of(spoiled)
    start = time.process_time()
    found = explain(spoiled.cameras, detections)
    cpu = time.process_time() - start
    error, delays = error_mm(spoiled, detections, filmed.truth, found)
    good, changed = error <= max(WITHIN * usual, LEAST_MM), found.changed or bool(delays.moved.any())
    in_time = all(applied.code == "camera_late" for applied in found.applied)
    if kind == "as it should be":
        state = "wrong" if changed and not good else "changed" if changed else "right"
    elif good or (kind == "one of another take" and found.reading.left_out):
        state = "repaired" if changed else "harmless"
    elif found.open or found.reading.left_out or not found.agrees or (in_time and np.isnan(delays.frames).any()):
        state = "named"  # The solve reports unknown delays.
    else:
        state = "wrong" if changed else "silent"
    what = "; ".join(f"{a.code} {a.meaning} {a.gain:.0f}" for a in found.applied) or " | ".join(found.open)
    what += f" late {np.round(delays.frames, 1).tolist()}" if delays.moved.any() else ""
    line = f"{take.clip:22}{take.layout:9} {kind:22} {state:9} {error:7.1f} of {usual:5.1f} margin {found.margin:7.1f}"
    return state, f"{line} cpu {cpu:4.1f} {what} [next: {found.runner_up}]"


def tried_cases(takes: Mapping[int, MotionTake], kinds: Iterable[str]) -> Iterator[tuple[str, str, str]]:
    """Yield the kind, state and line of each case. The keys of ``takes`` are seeds of their noise."""
    place, known = os.environ.get("AGREEMENT_RECORD", ""), dict[str, list[str]]()
    if place and Path(place).exists():
        known = dict(json.loads(line) for line in Path(place).read_text("utf-8").splitlines())
    for (seed, take), kind in product(takes.items(), kinds):
        name = f"{take} {kind}"
        state, line = known.get(name) or try_case(take, kind, seed)
        if place and name not in known:
            with Path(place).open("a", encoding="utf-8") as lines:
                lines.write(json.dumps([name, [state, line]]) + "\n")
        yield kind, state, line


GROUPS = {"plain": {"as it should be"}, "static": STATIC, "unknown": UNKNOWN, "delay": DELAYS, "two": TWO}


def run() -> list[Metric]:
    """Count the results of the held-out takes, with separate counts for takes with two people."""
    states = dict[str, Counter[str]]()
    for seed, take in enumerate(HELD_OUT):
        for kind, state, _ in tried_cases({seed: take}, KINDS):
            group = next(name for name, kinds in GROUPS.items() if kind in kinds)
            states.setdefault("company" if take.company else group, Counter())[state] += 1
    metrics = list[Metric]()
    for group, counts in states.items():
        good = counts["right"] + counts["repaired"] + counts["harmless"]
        metrics.append(Metric(f"{group}_good_percent", 100 * good / counts.total(), "%", "higher", abs_tol=3.0))
        metrics += [Metric(f"{group}_{state}", float(count), "cases") for state, count in sorted(counts.items())]
    total = sum(states.values(), Counter[str]())
    metrics.append(Metric("all_cases", float(total.total()), "cases", "higher"))
    metrics += [Metric(f"all_{state}", float(total[state]), "cases", abs_tol=2.0) for state in ("wrong", "silent")]
    return metrics


def main(argv: list[str]) -> int:
    """Print every case, and counts of each kind."""
    parser = argparse.ArgumentParser(prog="bench_agreement", description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    parser.add_argument("--held-out", action="store_true", help="the takes that constants were not fitted to")
    parser.add_argument("--takes", type=int, nargs="*", help="numbers of takes", default=())
    args = parser.parse_args(argv)
    counts: dict[str, Counter[str]] = {}
    takes = dict(enumerate(HELD_OUT if args.held_out else FITTED))
    takes = {seed: take for seed, take in takes.items() if seed in (args.takes or takes)}
    for kind, state, line in tried_cases(takes, args.kinds or KINDS):
        counts.setdefault(kind, Counter())[state] += 1
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
    for kind, states in counts.items():
        sys.stdout.write(f"{kind:24} {dict(states)}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
