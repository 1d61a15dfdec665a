"""Warnings about good captures: 40 takes without a fault, solved by the command line without options.

Half of them chose limits, and the other half is held out. Every warning about a good capture is a false alarm, or
reports a property of the take that a user wants to know. Skeletons of recorded motions and studio shots are simulated
captures. ``views`` and ``markers`` are recordings. Crowds are four people who enter and leave, solved with ``--person
all``. ``python -m tests.benchmarks.bench_good_captures [--held-out] [--record FILE] [NAME ...]`` prints every warning,
then counts of each code. FILE keeps solved takes, so that an interrupted run resumes.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from solver_backend.cli.main import function_of
from solver_backend.cli.program import parse
from solver_backend.exchange.diagnostics import Diagnostic, read_diagnostics, sentence
from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.progress import silent
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.studio.perturb import clean_capture, perturbed_capture
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import list_shots, set_up
from solver_backend.synthesis.studio.truth import find_truth, true_motion
from solver_backend.types import JointSet
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.benchmarks.spoiled_views.motion_takes import FPS, MotionTake, cameras_of, detect, keypoints_of
from tests.support.recordings import recordings_folder
from tests.support.trial_files import Person, write_trial

Height = Callable[[np.ndarray], np.ndarray]  # Height of the ground under a person at (F, 3) metres.
Try = Callable[[Path], "Solved"]


@dataclass(frozen=True)
class Solved:
    """Result for a capture."""

    people: int = 0  # Number of solved people.
    real: int = 1  # Number of real people.
    error_mm: float = float("nan")  # Largest median distance of a solved person's hips from the true ones.
    refused: str = ""  # Code of an error.
    found: tuple[dict, ...] = ()  # Diagnostics.
    texts: tuple[str, ...] = ()  # Messages of warnings and errors.
    seconds: float = 0.0


def _trampoline(points: np.ndarray) -> np.ndarray:
    return np.full(len(points), 0.9)


def _stairs(points: np.ndarray) -> np.ndarray:
    way = np.linalg.norm(points[:, :2] - points[0, :2], axis=-1)
    return 0.17 * np.floor(way / 0.3)


def _ramp(points: np.ndarray) -> np.ndarray:
    return 0.15 * np.linalg.norm(points[:, :2] - points[0, :2], axis=-1)


def skeleton(take: MotionTake, folder: Path, fps: float = 60.0, ground: Height | None = None) -> Solved:
    """Solve the skeleton of a recorded motion, seen by cameras."""
    points = take.size * keypoints_of(take.clip, take.start, int(np.ceil(take.frames * FPS / fps)))
    points = points[np.round(np.arange(take.frames) * FPS / fps).astype(int).clip(0, len(points) - 1)]
    points = points - np.r_[np.nanmean(points[..., :2], axis=(0, 1)), np.nanmin(points[..., 2])]
    if ground is not None:
        points = points + np.array([0.0, 0.0, 1.0]) * ground(_middle(points))[:, None, None]
    return _solve_views(folder, take, [points], [detect_in(take, points)], fps)


def detect_in(take: MotionTake, points: np.ndarray) -> Person:
    """Return the detections of points in the cameras of a take."""
    return detect(cameras_of(take.layout), points, take, np.random.default_rng(len(take.clip) + take.start))


def _middle(points: np.ndarray) -> np.ndarray:
    return points[:, JointSet.BODY_25.keypoints.index("mid_hip")]


_WALKS = ("35_01", "16_15", "02_01", "16_31", "16_21", "16_47")


def crowd(seed: int, folder: Path, layout: str = "ring 4", fps: float = 30.0) -> Solved:
    """Solve a crowd, see ``film_crowd``."""
    return _solve_views(folder, *film_crowd(seed, layout), fps, "--person", "all")


def film_crowd(seed: int, layout: str, frames: int = 150) -> tuple[MotionTake, list[np.ndarray], list[Person]]:
    """Film four people: two walk past each other, one enters through a door, and one leaves early."""
    rng = np.random.default_rng(seed)
    take = MotionTake("", layout, frames=frames)
    cameras, everybody, seen = cameras_of(layout), [], []
    spans = ((0, frames), (0, frames), (frames // 3, frames), (0, frames // 2))
    for n, (first, stop) in enumerate(spans):
        points = keypoints_of(_WALKS[(seed + n) % len(_WALKS)], 0, 2 * frames)[::2]
        points = points - np.r_[np.nanmean(points[..., :2], axis=(0, 1)), np.nanmin(points[..., 2])]
        angle = 0.5 * np.pi * n + rng.uniform(-0.4, 0.4)
        c, s = np.cos(angle), np.sin(angle)
        points = points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
        points = points + [1.1 * c + rng.normal(0, 0.3), 1.1 * s + rng.normal(0, 0.3), 0.0]
        xy, confidence = detect(cameras, points, take, rng)
        points[:first] = points[stop:] = np.nan
        confidence[:, :first] = confidence[:, stop:] = 0.0
        everybody.append(points)
        seen.append((xy, confidence))
    for c in range(len(cameras)):  # people in front hide the others
        depth = [np.linalg.norm(_middle(points) - cameras.centres[c], axis=-1) for points in everybody]
        boxes = [_box(xy[c], confidence[c]) for xy, confidence in seen]
        for n, (_, confidence) in enumerate(seen):
            for other in range(len(seen)):
                if other != n:
                    hidden = (depth[other] < depth[n]) & (_cover(boxes[n], boxes[other]) > 0.5)
                    confidence[c, hidden] = 0.0
    return take, everybody, seen


def _box(xy: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Return the (F, 4) smallest and largest pixels of a person, empty if the person is not visible."""
    known = (confidence > 0)[..., None]
    return np.concatenate([np.where(known, xy, np.inf).min(1), np.where(known, xy, -np.inf).max(1)], axis=-1)


def _cover(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the (F,) share of one box that another box covers."""
    size = np.maximum(one[:, 2:] - one[:, :2], 0.0)
    with np.errstate(invalid="ignore"):
        common = np.minimum(one[:, 2:], other[:, 2:]) - np.maximum(one[:, :2], other[:, :2])
    common = np.where(np.isfinite(common), np.maximum(common, 0.0), 0.0)
    return common.prod(-1) / np.maximum(np.where(np.isfinite(size), size, 1.0).prod(-1), 1.0)


def _solve_views(
    folder: Path, take: MotionTake, truths: Sequence[np.ndarray], seen: list[Person], fps: float, *words: str
) -> Solved:
    cameras = cameras_of(take.layout)
    config = f"[project]\nframe_rate = {fps:g}\n"
    write_trial(
        folder / "trial", cameras=cameras, people=seen, names=cameras.names, calibrated=cameras.names, config=config
    )
    return solve_path(folder / "trial", folder, *words, truths=[_middle(points) for points in truths])


def studio(motion: str, folder: Path, array: dict, fps: float = 60.0, **more: object) -> Solved:
    """Solve a studio shot: a clip on a body of random shape and unusual proportions."""
    from solver_backend.synthesis.studio.write_pictures import write_trial as write_studio_trial

    values = {
        "motions": [str(recordings_folder() / motion)], "frames": 90, "fps": fps, "camera_arrays": [array],
        "people": {"strange": True}, "perturb": "detector", "markers": None, "film": [], **more,
    }  # fmt: skip
    spec = spec_of(values)
    stage = set_up(spec, list_shots(spec)[0])
    truth = find_truth(stage, spec.fps)
    clean = clean_capture(spec, stage, truth, true_motion(stage.person, stage.joints, truth.contacts, spec.fps))
    path = write_studio_trial(folder / "trial", perturbed_capture(spec, stage, truth, clean))
    return solve_path(path, folder, truths=[stage.joints[:, 0]])


def recorded(path: str, folder: Path, *words: str, real: int = 1) -> Solved:
    """Solve a recording."""
    return solve_path(recordings_folder() / path, folder, *words, real=real)


def solve_path(
    path: Path, folder: Path, *words: str, truths: Sequence[np.ndarray] = (), real: int | None = None
) -> Solved:
    """Solve a path by the command line, and compare all people with the true (F, 3) hip centres in metres."""
    if not path.exists():
        raise BenchmarkSkipped(f"{path.name} is not here.", hint="Set MOCAP_SHARED_DATA to its folder.")
    start, real = time.process_time(), len(truths) or real or 1
    try:
        outcome = function_of("solve")(parse(["solve", str(path), "--out", str(folder / "m.npz"), *words]), silent)
    except MocapError as error:
        return Solved(real=real, refused=error.code, texts=(str(error),), seconds=time.process_time() - start)
    takes, failed = outcome.data.get("takes", [outcome.data]), outcome.data.get("failed", [])
    found: list[Diagnostic] = []
    errors, texts = [], [f"failed: {item}" for item in failed]
    for take in takes:
        motion = read_motion(Path(take["motion"]))
        own = read_diagnostics(take["diagnostics"])
        found += own
        texts += [sentence(item, motion.fps) for item in own if item.severity != "note"]
        hips = motion.joints[:, [motion.body_layout.joints.index(f"{side}_hip") for side in ("left", "right")]].mean(1)
        with suppress(ValueError):
            errors.append(min(float(np.nanmedian(np.linalg.norm(hips - t, axis=-1))) for t in _of_length(truths, hips)))
    worst = 1e3 * max(errors) if errors else float("nan")
    items = tuple(item.as_dict() for item in found)
    refused = ", ".join(item["code"] for item in failed)
    return Solved(len(takes), real, worst, refused, items, tuple(texts), time.process_time() - start)


def _of_length(truths: Sequence[np.ndarray], hips: np.ndarray) -> list[np.ndarray]:
    return [truth for truth in truths if len(truth) == len(hips)]


def _clip(clip: str, layout: str = "ring 4", fps: float = 60.0, ground: Height | None = None, **more: float) -> Try:
    frames = max(60, min(110, int(2.2 * fps)))
    values = {"start": 60, "frames": frames, **more}
    return partial(skeleton, MotionTake(clip, layout, **values), fps=fps, ground=ground)


_RING: dict[str, object] = {"layout": "ring", "count": 4, "radius_m": 4.2, "height_m": 1.7}
_ROOM: dict[str, object] = {"layout": "corners", "room_m": [7.0, 6.0]}
FITTED: dict[str, Try] = {
    "walk": _clip("35_01"),
    "leaning dancer": _clip("gsimchoni_charleston1", start=0),
    "lambada, 25 fps": _clip("gsimchoni_lambada", fps=25.0, start=0),
    "modern dance, 24 fps": _clip("49_02", "side 3", fps=24.0),
    "trampoline": _clip("16_01", ground=_trampoline),
    "stairs": _clip("16_15", ground=_stairs),
    "toddler, 25 fps": _clip("02_01", size=0.52, fps=25.0),
    "child": _clip("16_21", "ring 8", size=0.68),
    "floor work": _clip("135_02", "overhead"),
    "standing": _clip("17_03", standing=True),
    "hands over, 25 fps": _clip("14_24", fps=25.0),
    "flips": _clip("gsimchoni_backflip", "ring 8", start=0),
    "two cameras": _clip("127_03", "two", noise=0.5),
    "far detector": _clip("49_17", "ring 8", noise=2.0),
    "four people 0": partial(crowd, 0),
    "four people 1": partial(crowd, 1, layout="ring 8"),
    "studio martial": lambda folder: studio("bvh_samples/cmu_daz_martial_07.bvh", folder, _RING, 120.0),
    "studio 10_01": lambda folder: studio("poses_makehuman_cc0/makehuman_data_bvhs_10_01.bvh", folder, _ROOM, 50.0),
    "studio bvh": lambda folder: studio("bvh_samples/cmu_max_131_03.bvh", folder, _RING, 30.0),
    "real balance": lambda f: recorded("multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial", f),
    "real pair": lambda f: recorded(
        "multiview/pose2sim_session/S00_P01_MultiParticipants/S00_P01_T02_Participants1-2", f, "--person", "all", real=3
    ),
    "markers run": lambda f: recorded("markers/nimble/Sprinter/run0350cms.trc", f),
    "markers walk": lambda f: recorded("markers/opensim/walking2.c3d", f, "--frames", "600", "699"),
    "markers serve": lambda f: recorded("markers/kineticstoolkit/tennis_serve.c3d", f, "--frames", "300", "420"),
    "markers cmu": lambda f: recorded("markers/cmu_pairs/02_01.c3d", f, "--frames", "0", "119"),
}
HELD_OUT: dict[str, Try] = {
    "walk, 30 fps": _clip("16_31", fps=30.0),
    "lean": _clip("gsimchoni_charleston2", "side 3", start=0),
    "dance, 50 fps": _clip("49_07", fps=50.0),
    "acting, 24 fps": _clip("14_02", "overhead", fps=24.0),
    "trampoline held": _clip("16_05", "ring 8", ground=_trampoline),
    "stairs held": _clip("16_47", "ring 8", ground=_stairs),
    "ramp": _clip("35_01", ground=_ramp, start=100),
    "toddler held": _clip("16_15", size=0.5),
    "child, 25 fps": _clip("29_09", size=0.65, fps=25.0),
    "floor work held": _clip("127_20", "ring 8"),
    "kata": _clip("135_05"),
    "standing held, 25 fps": _clip("14_14", fps=25.0, standing=True),
    "two cameras held": _clip("02_05", "two", noise=0.5),
    "missing": _clip("02_07", missing=0.2),
    "four people 2": partial(crowd, 2),
    "four people 3": partial(crowd, 3, layout="ring 8", fps=25.0),
    "studio walk held": lambda folder: studio("bvh_samples/cmu_mb2_02_01.bvh", folder, _ROOM, 30.0),
    "studio tai chi held": lambda folder: studio(
        "poses_makehuman_cc0/makehuman_data_bvhs_cmu_12_03.bvh", folder, _RING, 120.0
    ),
    "studio bvh held": lambda folder: studio("bvh_samples/cmu_mb2_09_01.bvh", folder, _RING, 25.0),
    "real static": lambda f: recorded("multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T00_StaticTrial", f),
    "real one of two": lambda f: recorded(
        "multiview/pose2sim_session/S00_P01_MultiParticipants/S00_P01_T00_StaticTrialParticipant1", f
    ),
    "markers sprint": lambda f: recorded("markers/nimble/Sprinter/run0700cms.trc", f),
    "markers squat": lambda f: recorded("markers/nimble/c3d/squat.c3d", f, "--frames", "0", "119"),
    "markers walk held": lambda f: recorded("markers/opensim/walking5.c3d", f, "--frames", "600", "699"),
    "markers cmu held": lambda f: recorded("markers/cmu_pairs/135_02.c3d", f, "--frames", "200", "319"),
}


def run() -> list[Metric]:
    """Count warnings of the held-out half."""
    solved = [_tried(one) for one in HELD_OUT.values()]
    counts = Counter(code for one in solved for code in codes(one))
    people = [Metric("people_missed", float(sum(max(0, s.real - s.people) for s in solved)), "people")]
    people += [Metric("people_invented", float(sum(max(0, s.people - s.real) for s in solved)), "people")]
    return [*people, *(Metric(f"warned_{code}", float(n), "captures") for code, n in sorted(counts.items()))]


def codes(one: Solved) -> set[str]:
    """Return the codes of a capture's warnings and errors."""
    refused = {code for code in one.refused.split(", ") if code}
    return refused | {str(item["code"]) for item in one.found if item["severity"] != "note"}


def _tried(attempt: Try) -> Solved:
    with TemporaryDirectory() as folder:
        return attempt(Path(folder))


def main(argv: list[str]) -> int:
    """Print the result of each capture, and counts of each code."""
    parser = argparse.ArgumentParser(prog="bench_good_captures", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--held-out", action="store_true", help="the half that no limit was chosen on")
    parser.add_argument("--record", type=Path, help="file of solved takes, which is continued")
    args = parser.parse_args(argv)
    rows = HELD_OUT if args.held_out else FITTED
    known: dict[str, dict] = {}
    if args.record and args.record.exists():
        known = dict(json.loads(line) for line in args.record.read_text("utf-8").splitlines())
    counts = Counter[str]()
    for name in args.names or rows:
        if name in known:
            one = Solved(**known[name])
        else:
            one = _tried(rows[name])
            if args.record:
                with args.record.open("a", encoding="utf-8") as lines:
                    lines.write(json.dumps([name, one.__dict__], default=str) + "\n")
        counts.update(codes(one))
        head = f"{name}: {one.people} of {one.real} people, {one.error_mm:.0f} mm, {one.seconds:.0f} s {one.refused}"
        sys.stdout.write("\n    ".join([head, *one.texts]) + "\n")
        sys.stdout.flush()
    for code, count in counts.most_common():
        sys.stdout.write(f"{count:4} {code}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
