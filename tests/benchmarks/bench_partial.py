"""Real takes without the markers above the pelvis, of an arm, or of both legs.

The solve is compared with the solve of all markers: the movement of measured joints, whether every frame is flagged,
whether a resting wrist is above its shoulder, and the number of resting joints inside their 50, 80 and 95 % ellipsoids.
Takes and kinds have equal weights, and the standard error for so few takes is given. Takes differ from those that
``tests.benchmarks.resting_spread`` is fitted to, except for CMU's. Relative to the skeletons of CMU's walk and fight:
the error of measured joints, without each joint's constant offset, for this solve and the solve of all markers. Needs
the recordings (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

from solver_backend.io.markers.read import read_markers
from solver_backend.types import SMPL_JOINTS, MarkerCloud, Motion
from tests.benchmarks.marker_takes.partial import BOUNDS, KINDS, Removed, at_rate, removed, solved
from tests.benchmarks.marker_takes.skeletons import fight_joints, walk_joints
from tests.benchmarks.marker_takes.takes import cmu, folder, ui_prmd
from tests.benchmarks.metric import Metric

RATE, FRAMES = 5.0, 24  # Frames per second and maximum number of frames of each take.
UI_PRMD = (
    "m01_s03_e05", "m02_s05_e08", "m02_s08_e02", "m03_s02_e02", "m03_s05_e02", "m04_s03_e05", "m04_s06_e05",
    "m05_s07_e08", "m06_s01_e02", "m06_s04_e05", "m07_s02_e02", "m07_s04_e05", "m08_s02_e05", "m08_s06_e08",
    "m09_s01_e02", "m09_s07_e05", "m10_s06_e02",
)  # fmt: skip
NIMBLE = ("Subject4/MarkerData/walkingTO1.trc", "Subject4/MarkerData/static1.trc", "c3d/squat.c3d")


def run() -> list[Metric]:
    """Solve and print the table."""
    folder()
    found: dict[str, list[Removed]] = {"CMU": [], "UI-PRMD": [], "nimble": []}
    ratios: dict[str, float] = {}
    step = round(120.0 / RATE)
    references = {"02_01": walk_joints(step), "135_02": fight_joints(600, step)}
    for group, name, take in _takes():
        cloud = at_rate(take, RATE, FRAMES)
        whole = solved(cloud)
        for kind in KINDS:
            part = removed(cloud, whole, kind)
            found[group].append(part)
            sys.stdout.write(f"  {name:<28} {part.kind:<17} {_row([part])}\n")
            sys.stdout.flush()
            if (reference := references.get(name)) is not None:
                ratios[f"{name} {kind}"] = _ratio(whole, part.motion, reference)
    for group, parts in found.items():
        sys.stdout.write(f"  {group:<46} {_row(parts)}\n")
    for kind, ratio in ratios.items():
        sys.stdout.write(f"  {kind:<24} removed: informed joints {ratio:.2f} times the error of all markers\n")
    every = [part for parts in found.values() for part in parts]
    by_take = np.array([_inside([part]) for part in every]).reshape(-1, len(KINDS), 3).mean(axis=1)
    inside, error = by_take.mean(axis=0), by_take.std(axis=0) / np.sqrt(len(by_take))
    texts = [f"{share:.1f} ± {own:.1f}" for share, own in zip(inside, error, strict=True)]
    sys.stdout.write(f"  {len(by_take)} takes, each counting alike: {', '.join(texts)} % inside 50, 80, 95 %\n")
    return [
        *(
            Metric(f"inside_{percent}", share, "%", rel_tol=0.0, abs_tol=tolerance, direction="higher")
            for percent, share, tolerance in zip((50, 80, 95), inside, (5.0, 5.0, 3.0), strict=True)
        ),
        Metric("flagged", 100 * min(part.flagged for part in every), "%", "higher", rel_tol=0.0),
        Metric("wrists_above", 100 * max(part.wrists_above for part in every), "%", rel_tol=0.0),
        Metric("informed_moved_mm", float(np.mean([np.median(part.moved_mm) for part in every])), "mm", rel_tol=0.15),
        *(Metric(f"ratio_{kind.replace(' ', '_')}", ratio, "", rel_tol=0.05) for kind, ratio in ratios.items()),
    ]


def _takes() -> Iterator[tuple[str, str, MarkerCloud]]:
    yield "CMU", "02_01", cmu("02_01")
    yield "CMU", "135_02", cmu("135_02", slice(600, 1100))
    for name in UI_PRMD:
        yield "UI-PRMD", name, ui_prmd(folder() / "ui_prmd" / f"{name}.npz")
    for name in NIMBLE:
        yield "nimble", name, read_markers(folder() / "nimble" / name).cloud


def _inside(parts: list[Removed]) -> np.ndarray:
    """Return the (3,) percentages of resting joints inside the ellipsoids, with equal weights for all parts."""
    return 100 * np.mean([(part.squared[:, None] < BOUNDS).mean(axis=0) for part in parts], axis=0)


def _row(parts: list[Removed]) -> str:
    inside = "/".join(f"{share:.0f}" for share in _inside(parts))
    moved = np.mean([np.median(part.moved_mm) for part in parts])
    flagged = 100 * min(part.flagged for part in parts)
    above = 100 * max(part.wrists_above for part in parts)
    return f"inside {inside:<9} % flagged {flagged:3.0f} % wrists above {above:3.0f} % informed moved {moved:5.1f} mm"


def _ratio(whole: Motion, part: Motion, reference: dict[str, np.ndarray]) -> float:
    """Return the error of measured joints against a recorded skeleton, relative to the solve of all markers."""
    assert part.resting is not None
    errors = []
    for motion in (whole, part):
        found = []
        for name, places in reference.items():
            j = SMPL_JOINTS.index(name)
            if not part.resting[:, j].any():
                off = motion.joints[: len(places), j] - places[: motion.num_frames]
                found.append(np.linalg.norm(off - off.mean(axis=0), axis=-1).mean())
        errors.append(float(np.mean(found)))
    return errors[1] / errors[0]
