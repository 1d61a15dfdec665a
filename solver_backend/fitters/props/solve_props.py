"""The props of a solved take: found among the markers that the person does not wear, and solved one by one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.props import Prop
from solver_backend.fitters.marker_calibration.unknown_markers import FRAMES, BonePoses, LooseGroup, loose_groups
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.props.solve_prop import solve_prop
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.arrays import to_numpy
from solver_backend.geometry.quantiles import quantile
from solver_backend.geometry.runs import true_runs
from solver_backend.types import MarkerCloud

STAGE = "Solving the props"
MOST = 12
"""Props of a take, those of the most markers: crowds of stray points make groups by chance."""
FAR_M = 0.004
"""Median distance of markers from a prop's own from which on they are no rigid body."""
UNSURE_M, UNSURE_RAD = 0.02, np.radians(10.0)
"""Standard deviations from which on a prop's pose is hardly known."""


def solve_props(
    measurements: Measurements, solved: SolvedFrames, progress: Progress
) -> tuple[tuple[Prop, ...], list[Diagnostic]]:
    """Return the props among the markers of a take that nobody wears, and what was found of them.

    Args:
        measurements: of the take.
        solved: the person's poses, whose bones carry some of the markers.
        progress: called as props are solved.
    """
    found = list[tuple[MarkerCloud, LooseGroup]]()
    if measurements.others is not None:
        found += [(measurements.others, group) for group in loose_groups(measurements.others)]
    if measurements.loose is not None and measurements.loose.labels:
        loose = measurements.loose
        frames = np.unique(np.linspace(0, len(loose.positions) - 1, FRAMES).astype(int))
        some = MarkerCloud(loose.positions[frames], loose.fps, loose.labels)
        found += [(loose, group) for group in loose_groups(some, _bones(solved, frames))]
    found = sorted(found, key=lambda item: -len(item[1].columns))[:MOST]
    props, diagnostics = list[Prop](), list[Diagnostic]()
    for n, (cloud, group) in enumerate(found):
        progress(STAGE, n, len(found))
        points, labels = cloud.positions[:, group.columns], [(cloud.labels or ())[i] for i in group.columns]
        prop = solve_prop(group.name, labels, points, cloud.fps)
        if prop is None:
            continue
        kept = [labels.index(label) for label in prop.labels]
        off = float(quantile(np.linalg.norm(prop.markers - points[:, kept], axis=-1), 0.5, axis=(0, 1)))
        if off < FAR_M:
            prop = _in_its_own_axes(prop) if prop.is_of_poses else prop
            props.append(prop)
            diagnostics += _found(prop, off)
    if found:
        progress(STAGE, len(found), len(found))
    return tuple(props), diagnostics


def _bones(solved: SolvedFrames, frames: np.ndarray) -> BonePoses:
    some, subject = solved.frames.select(frames), solved.subject
    skeleton = forward_kinematics(subject.body, subject.betas, some.root, some.local, some.transl)
    return BonePoses(to_numpy(skeleton.joints), to_numpy(skeleton.G))


def _in_its_own_axes(prop: Prop) -> Prop:
    """Return a prop whose points are those of its axes in these axes."""
    origin = prop.points[0]
    return prop.in_axes(origin, nearest_rotation((prop.points[1:] - origin).T))


def _found(prop: Prop, off: float) -> Iterator[Diagnostic]:
    code = "prop_read" if prop.is_of_poses else "prop_found"
    yield diagnostic(code, markers=prop.labels, prop=prop.name, count=len(prop.labels), size=1000 * off)
    unsure = (prop.sigma[:, 0] > UNSURE_M) | (prop.sigma[:, 1] > UNSURE_RAD)
    if unsure.all():
        yield diagnostic("prop_turn_open", markers=prop.labels, prop=prop.name)
    elif unsure.any():
        yield diagnostic(
            "prop_hidden", markers=prop.labels, prop=prop.name, frames=true_runs(unsure), remedy=Remedy.BRIDGED
        )
