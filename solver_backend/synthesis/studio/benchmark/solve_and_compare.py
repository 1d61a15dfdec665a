"""Solve every shot of a data set by several methods, and compare the results with the ground truth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from solver_backend.evaluation.evaluate import triangulate_and_filter
from solver_backend.exchange.errors import CommandLineInvalid, MocapError
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import METHOD_NAMES, SolveSettings
from solver_backend.fitters.pipeline import solve
from solver_backend.io.native.capture_file import read_capture
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm, pa_mpjpe_mm
from solver_backend.synthesis.studio.data_set import SHOTS, read_data_set
from solver_backend.types import Capture

YARDSTICK = "triangulation"  # Baseline method without a body: triangulation and a 6 Hz filter.


@dataclass(frozen=True)
class Verdict:
    """Result of solving one capture of a shot by one method."""

    shot: str
    faults: str
    source: str
    method: str
    array: str = ""
    mpjpe_mm: float = np.nan
    pa_mpjpe_mm: float = np.nan
    accel_m_s2: float = np.nan
    seconds: float = np.nan
    error: str = ""  # Error message, or "" if the solve succeeded.
    by_frame_mm: np.ndarray | None = None  # (F,) mean joint error.
    joints: np.ndarray | None = None  # (F, 24, 3) solved joint positions in metres.


def solve_and_compare(
    out: Path,
    methods: Sequence[str] = ("global",),
    sources: Sequence[str] = (),
    faults: Sequence[str] = ("perturbed",),
    progress: Progress = silent,
    settings: SolveSettings = SolveSettings(),
) -> list[Verdict]:
    """Solve every shot of a data set by every method. Failed solves are returned with their errors.

    Args:
        methods: solve methods, or 'triangulation'.
        sources: 'views', 'markers' or both. If empty, the sources with faults are used, or views if there are none.
        faults: 'clean', 'perturbed' or both.

    Raises:
        FileMissing, FileDamaged: there is no data set, or it is damaged.
        CommandLineInvalid: a method is unknown.
    """
    unknown = sorted(set(methods) - {*METHOD_NAMES, YARDSTICK})
    if unknown:
        known = ", ".join((*METHOD_NAMES, YARDSTICK))
        raise CommandLineInvalid(f"There is no method {', '.join(unknown)}.", hint=f"Known methods: {known}.")
    spec, records = read_data_set(out)
    touched = {"views": spec.perturb.of_views or not spec.perturb.of_markers, "markers": spec.perturb.of_markers}
    chosen = sources or [source for source, perturbed in touched.items() if perturbed]
    work = []
    for record, kind, source, method in product(records, faults, chosen, methods):
        can = {"markers": method != YARDSTICK and record["markers"], "views": len(record["cameras"]) > 1}
        if can[source]:
            work.append((record["name"], kind, source, method, record["camera_array"]))
    verdicts = []
    progress("evaluating", 0, len(work))
    for done, place in enumerate(work, start=1):
        capture = read_capture(out / SHOTS / place[0] / f"{place[1]}.npz")
        verdicts.append(_verdict(capture, place, settings))
        progress("evaluating", done, len(work))
    return verdicts


def _verdict(capture: Capture, place: tuple[str, str, str, str, str], settings: SolveSettings) -> Verdict:
    source, method = place[2:4]
    truth, start = np.asarray(capture.truth["joints"]), time.monotonic()
    one = replace(capture, markers=None) if source == "views" else replace(capture, keypoints=None, cameras=None)
    try:
        if method == YARDSTICK:
            cameras, keypoints = one.require_multiview()
            found, truth = triangulate_and_filter(cameras, keypoints), np.asarray(capture.truth["keypoints3d"])
            joints = None
        else:
            found = joints = solve(one, replace(settings, method=method)).motion.joints
    except MocapError as error:
        return Verdict(*place, error=str(error), seconds=time.monotonic() - start)
    seconds = time.monotonic() - start
    off = 1e3 * np.linalg.norm(found - truth, axis=-1)
    located = np.isfinite(off).all(axis=0)
    by_frame = np.nanmean(off, axis=1) if np.isfinite(off).any() else np.full(len(off), np.nan)
    whole = found[:, located], truth[:, located]
    aligned = pa_mpjpe_mm(*whole) if located.sum() > 3 else np.nan
    accel = accel_error_m_s2(*whole, capture.fps) if len(off) > 2 else np.nan
    return Verdict(*place, mpjpe_mm(*whole), aligned, accel, seconds, "", by_frame, joints)
