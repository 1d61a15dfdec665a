"""One camera compared with all: separate views of a real recording, and recorded motion with a simulated detector.

Figures are mean distances over 12 limb joints, after the best similarity of each frame (pa) and about the hips in the
world (hip). Real views are compared with the solve of all four cameras. Simulated takes of subjects 03, 13, 49 and 135,
on whom the view lifter is not trained, are compared with the truth. ``lifted_pa`` is the lifter alone, ``frame_pa`` a
separate solve of each frame from there, ``manifold_pa`` Pose-NDF's image fitting of every tenth frame from there, and
``inside_95`` the share of joints within their 95 % ellipsoids. ``acceleration_error`` is the mean, and relative to all
three cameras together. ``flips`` is the share of limbs with the wrong direction along the line of sight,
``flips_flagged`` the share of these with a reported ambiguity, and ``limbs_flagged`` the same share of all limbs.
``skating`` and ``below_floor`` are of the feet, and ``cpu_s_300`` is CPU seconds of 300 frames.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Mapping

import numpy as np

from solver_backend.fitters.pipeline import solve
from solver_backend.metrics import foot_skating_cm_per_frame
from tests.benchmarks.metric import Metric
from tests.benchmarks.one_view_baselines import frame_pa_mm, manifold_pa_mm
from tests.benchmarks.one_view_takes import OneViewTake, filmed_takes, lifted_pa_mm, real_takes
from tests.support.limb_errors import TOES, acceleration, coverage, flagged, flipped, limb_errors

BASELINES = {"lifted_pa": lifted_pa_mm, "frame_pa": frame_pa_mm, "manifold_pa": manifold_pa_mm}


def run() -> list[Metric]:
    """Solve every view alone."""
    metrics, filmed = [], defaultdict[str, list[dict[str, float]]](list)
    for take in real_takes():
        figures = _figures(take)
        metrics += [Metric(f"{take.name}_{key}", figures[key], "mm") for key in ("pa", "hip", *BASELINES)]
    for take in filmed_takes():
        filmed[take.name].append(_figures(take))
    by_subject = {name: _mean(rows) for name, rows in filmed.items()}
    metrics += [Metric(f"{name}_{key}", row[key], "mm") for name, row in by_subject.items() for key in ("pa", "hip")]
    mean = _mean(list(by_subject.values()))
    return [
        *metrics,
        Metric("filmed_pa", mean["pa"], "mm"),
        Metric("filmed_hip", mean["hip"], "mm"),
        *(Metric(f"filmed_{key}", mean[key], "mm") for key in BASELINES),
        Metric("inside_95", mean["inside_95"], "%", "higher", abs_tol=1.0),
        Metric("acceleration_error", mean["acceleration"], "m/s²"),
        Metric("acceleration_ratio", mean["acceleration"] / mean["acceleration_together"], "", abs_tol=0.05),
        Metric("flips", mean["flips"], "%", abs_tol=0.5),
        Metric(
            "flips_flagged", 100.0 * _total(filmed, "caught") / _total(filmed, "turned"), "%", "higher", abs_tol=5.0
        ),
        Metric("limbs_flagged", mean["flagged"], "%", abs_tol=3.0),
        Metric("skating", mean["skating"], "cm/frame", abs_tol=0.02),
        Metric("below_floor", max(row["below"] for rows in filmed.values() for row in rows), "cm", abs_tol=0.5),
        Metric("cpu_s_300", mean["cpu_s_300"], "s", rel_tol=1.0),
    ]


def _figures(take: OneViewTake) -> dict[str, float]:
    began = time.process_time()
    motion = solve(take.capture).motion
    seconds = time.process_time() - began
    pa, hip = limb_errors(motion.joints, take.joints)
    true = acceleration(take.joints, motion.fps)
    off, off_together = (acceleration(joints, motion.fps) - true for joints in (motion.joints, take.together))
    cameras, _ = take.capture.require_views()
    flips, flags = flipped(motion.joints, take.joints, cameras.R[0, 2]), flagged(motion)
    return {
        "pa": pa, "hip": hip, **{key: of(take) for key, of in BASELINES.items()},
        "inside_95": coverage(motion, take.joints),
        "acceleration": float(np.linalg.norm(off, axis=-1).mean()),
        "acceleration_together": float(np.linalg.norm(off_together, axis=-1).mean()),
        "flips": 100 * float(flips.mean()), "turned": float(flips.sum()), "caught": float((flips & flags).sum()),
        "flagged": 100 * float(flags.mean()),
        "skating": foot_skating_cm_per_frame(motion.joints[:, TOES]),
        "below": -100 * min(float(motion.keypoints3d[..., 2].min()), 0.0) if motion.keypoints3d is not None else 0.0,
        "cpu_s_300": 300 * seconds / motion.num_frames,
    }  # fmt: skip


def _total(filmed: Mapping[str, list[dict[str, float]]], key: str) -> float:
    return sum(row[key] for rows in filmed.values() for row in rows)


def _mean(rows: list[dict[str, float]]) -> dict[str, float]:
    return {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
