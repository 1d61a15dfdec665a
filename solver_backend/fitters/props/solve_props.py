"""The props of a solved take: found among the markers off the person, and solved one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.label_places import places_given
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.props import Prop
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.build_motion import PosedTake
from solver_backend.fitters.layers import Layer, SolvedLayer
from solver_backend.fitters.marker_calibration.unknown_markers import FRAMES, LEAST_MARKERS, BonePoses, loose_groups
from solver_backend.fitters.problem import Problem, SolvedFrames
from solver_backend.fitters.props.prop_equations import (
    LEAST_SIGMA_M,
    MOST_SIGMA_M,
    PropEquations,
    PropState,
    start_prop,
    unrest_of,
)
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.arrays import quantile, true_runs
from solver_backend.geometry.rotations import log_so3
from solver_backend.geometry.small_matrices import mean_sigma, packed
from solver_backend.residuals.terms import graduated_scales
from solver_backend.solver.levenberg_marquardt import LMSettings, minimise
from solver_backend.types import MarkerCloud, Motion


@dataclass(frozen=True)
class Props(Layer):
    """Markers of a recording at no known place of the person."""

    loose: tuple[MarkerCloud, ...] = ()  # Those among the person's: bones carry some of them.
    others: tuple[MarkerCloud, ...] = ()  # Those with other prefixes.

    @classmethod
    def of(cls, cloud: MarkerCloud, worn: Sequence[str], layout: str, others: MarkerCloud | None) -> Props:
        """Return the markers of a recording that a person does not wear and no program computed.

        Args:
            worn: labels of the person's.
            layout: path of a file that states how labels are read, see ``read_label_places``. Empty for none.
            others: markers of other prefixes.
        """
        names = name_markers([label for label in cloud.names if not is_unnamed(label)], places_given(layout))
        used = {*worn, *names.virtual, *names.doubled}
        kept = [i for i, label in enumerate(cloud.names) if label not in used]
        return cls((cloud.columns(kept),) if kept else (), () if others is None else (others,))

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Solve the groups that keep their shape, each on its own."""
        props, found = solve_props(self, solved, progress)
        return replace(solved, diagnostics=(*solved.diagnostics, *found)), SolvedProps(props)


@dataclass(frozen=True)
class SolvedProps(SolvedLayer):
    """Props of a take, in solving order."""

    props: tuple[Prop, ...]

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Return the motion with the props."""
        return replace(motion, props=self.props) if self.props else motion


FIRST_SCALE, SCALE, SCALES = 1000.0, 4.0, 5
"""First and last robust scale in standard deviations, and their number: frames of one or two markers begin decimetres
off."""
WRONG_M = 0.018
"""Least deviation of a wrong distance from its median: three times the stray of a rigid body's distances. The solve's
robust penalty handles smaller errors."""
STEPS = LMSettings(6, 1e-5)
"""Most Gauss-Newton steps, and the relative change of the cost at which they end, chosen by hand."""
LEAST_FRAMES = 4  # Least frames that locate a prop, chosen by hand.


def solve_prop(name: str, labels: Sequence[str], points: np.ndarray, fps: float) -> Prop | None:
    """Return the prop of M labelled markers, None where too few frames show three of them.

    The (F, M, 3) points are in world metres, NaN where missing.
    """
    if (np.isfinite(points).all(-1).sum(axis=1) >= LEAST_MARKERS).sum() < LEAST_FRAMES:
        return None
    points = _without_wrong_points(points)
    start = start_prop(points)
    known = np.flatnonzero(np.isfinite(start.rest).all(-1))
    if len(known) < len(labels):
        return solve_prop(name, [labels[int(m)] for m in known], points[:, known], fps)
    equations = PropEquations(points, start.rest, start.sigma_m, unrest_of(start, fps), 1.0 / fps)
    state = PropState.of_poses(start.R, start.t, 1.0 / fps)
    stages = [(scale, STEPS) for scale in graduated_scales(SCALE, FIRST_SCALE, SCALES)]
    state = minimise(equations, state, stages).state
    equations = _learned(equations, state)
    state = minimise(equations, state, stages[-1:]).state
    return _prop(name, labels, equations, state)


def _learned(equations: PropEquations, state: PropState) -> PropEquations:
    error, _ = equations.residuals(state)
    _, weight = equations.weights(error, SCALE)
    own = (np.nan_to_num(equations.points - state.t[:, None])) @ state.R
    total = weight.sum(axis=0)[:, None]
    mean = (weight[..., None] * own).sum(axis=0) / np.maximum(total, 1e-9)
    return replace(equations, rest=np.where(total > 0, mean, equations.rest))


def _of_true_spread(equations: PropEquations, state: PropState) -> PropEquations:
    """Return the equations with the markers' own variance: ``Σ w |r|² / (3 Σ w - tr H_markers C)``.

    The trace is the number of measured values that the poses take up, C their covariance.

    Reference: Hodges and Sargent 2001, "Counting degrees of freedom in hierarchical and other richly-parameterised
    models".
    """
    error, _ = equations.residuals(state)
    _, weight = equations.weights(error, SCALE)
    taken = float((equations.of_markers(state, SCALE)[1] * _covariance(equations, state)).sum())
    free = 3.0 * float(weight.sum()) - taken
    if free <= 0.0:
        return equations
    sigma = float(np.sqrt((weight * (error**2).sum(-1)).sum() / free))
    return replace(equations, sigma_m=min(max(sigma, LEAST_SIGMA_M), MOST_SIGMA_M))


def _covariance(equations: PropEquations, state: PropState) -> np.ndarray:
    return equations.linearise(state, SCALE)[1].marginals()[0]


def _prop(name: str, labels: Sequence[str], equations: PropEquations, state: PropState) -> Prop:
    equations = _of_true_spread(equations, state)
    blocks = _covariance(equations, state)
    turn, place = blocks[:, :3, :3], blocks[:, 3:6, 3:6]
    widest = np.sqrt(np.maximum(np.linalg.eigvalsh(turn)[:, -1], 0.0))
    sigma = np.stack([mean_sigma(packed(place[:, None]))[:, 0], np.minimum(widest, np.pi / np.sqrt(3.0))], axis=1)
    seen = np.isfinite(equations.points).all(-1).sum(axis=1)
    return Prop(name, tuple(labels), equations.rest, log_so3(state.R), state.t, sigma, seen.astype(np.uint8))


def _without_wrong_points(points: np.ndarray) -> np.ndarray:
    """Return the points without those that contradict the largest group of a frame's markers that agree.

    Where several groups are the largest, labels may be exchanged, and all that contradict any are excluded.
    """
    away = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    off = np.abs(away - quantile(away, 0.5, axis=0))
    seen, others = np.isfinite(points).all(-1), ~np.eye(points.shape[1], dtype=bool)
    compared = seen[:, :, None] & seen[:, None] & others & np.isfinite(off)
    votes = (compared & (np.nan_to_num(off) < WRONG_M)).sum(axis=-1)
    contradicted = votes < compared.sum(axis=-1)
    most = np.where(seen, votes, 0).max(axis=1, keepdims=True)
    largest = seen & (votes == most)
    one_group = largest.sum(axis=1, keepdims=True) == most + 1
    wrong = contradicted & ~(largest & one_group)
    return np.where(wrong[..., None], np.nan, points)


STAGE = "Solving the props"
MOST = 12
"""Most props of a take, those with the most markers: crowds of stray points make groups by chance."""
FAR_M = 0.004  # Least median distance of markers that are no rigid body.
UNSURE_M, UNSURE_RAD = 0.02, np.radians(10.0)  # Standard deviations beyond which a prop's pose is unknown.


def solve_props(markers: Props, solved: SolvedFrames, progress: Progress) -> tuple[tuple[Prop, ...], list[Diagnostic]]:
    """Return the props among the markers that the person does not wear, and their diagnostics."""
    found = [(cloud, group) for cloud in markers.others for group in loose_groups(cloud)]
    for cloud in markers.loose:
        frames = np.unique(np.linspace(0, len(cloud.positions) - 1, FRAMES).astype(int))
        some = MarkerCloud(cloud.positions[frames], cloud.fps, cloud.labels)
        bones = BonePoses.of(solved.subject, solved.frames.select(frames))
        found += [(cloud, group) for group in loose_groups(some, bones)]
    found = sorted(found, key=lambda item: -len(item[1].columns))[:MOST]
    props, diagnostics = list[Prop](), list[Diagnostic]()
    for n, (cloud, group) in enumerate(found):
        progress(STAGE, n, len(found))
        points, labels = cloud.positions[:, group.columns], [cloud.names[i] for i in group.columns]
        prop = solve_prop(group.name, labels, points, cloud.fps)
        if prop is None:
            continue
        kept = [labels.index(label) for label in prop.labels]
        off = float(quantile(np.linalg.norm(prop.markers - points[:, kept], axis=-1), 0.5, axis=(0, 1)))
        if off < FAR_M:
            if prop.is_of_poses:
                origin = prop.points[0]
                prop = prop.in_axes(origin, nearest_rotation((prop.points[1:] - origin).T))
            props.append(prop)
            diagnostics += _found(prop, off)
    if found:
        progress(STAGE, len(found), len(found))
    return tuple(props), diagnostics


def _found(prop: Prop, off: float) -> Iterator[Diagnostic]:
    source, named = "poses" if prop.is_of_poses else "markers", {"markers": prop.labels, "prop": prop.name}
    yield diagnostic("prop_found", source=source, count=len(prop.labels), size=1000 * off, **named)
    unsure = (prop.sigma[:, 0] > UNSURE_M) | (prop.sigma[:, 1] > UNSURE_RAD)
    if unsure.all():
        yield diagnostic("prop_pose_open", reason="line", **named)
    elif unsure.any():
        runs = true_runs(unsure)
        yield diagnostic("prop_pose_open", reason="hidden", frames=runs, remedy=Remedy.BRIDGED, **named)
