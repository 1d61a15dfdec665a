"""Find, undo or exclude faults of views in frame ranges, such as mirrored images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from solver_backend.agreement.body_evidence import refit_pose
from solver_backend.agreement.evidence import BOUND, UNRELATED_OUTLIERS, TakeEvidence
from solver_backend.agreement.explain import explain
from solver_backend.agreement.hypotheses import RANGE_ROWS
from solver_backend.agreement.reading import MIN_POINTS, Detections, Reading, apply_reading
from solver_backend.agreement.synchronisation import USUAL_SIGMA_SHARE
from solver_backend.cameras.refinement import rotated_back
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras, Keypoints2D

LASTING_S = 1.0  # Shortest fault of names, sides and cameras in seconds.
BRIEF_S = 0.25  # Shortest excluded range in seconds. The robust kernel handles shorter ones.


@dataclass(frozen=True)
class FrameSpan:
    """Range of frames from first to last, inclusive."""

    first: int
    last: int

    @property
    def frames(self) -> slice:
        """Frames as a slice."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True)
class ViewRange(FrameSpan):
    """Range of frames in a view."""

    view: int


def inconsistent_ranges(triangulation: Triangulation, confidence: np.ndarray, least_frames: float) -> list[ViewRange]:
    """Return the frame ranges in which a view contradicts the others, the longest first.

    Each view is a two-state Markov chain. The number of outliers in a frame is binomial with the rate of its state. A
    keypoint that three views show and no two agree on is an outlier in each. Ranges below ``least_frames`` are ignored.

    References: Viterbi 1967, and Rabiner 1989, "A tutorial on hidden Markov models".
    """
    inliers = np.asarray(triangulation.inliers)
    located = np.isfinite(np.asarray(triangulation.residual_px))
    checked = (confidence > 0) & (located | ((confidence > 0).sum(axis=0) >= 3))
    good, bad = (checked & inliers).sum(-1), (checked & ~inliers).sum(-1)
    weight = MIN_POINTS / np.maximum(good + bad, MIN_POINTS)  # independent keypoints of a frame
    shares = UNRELATED_OUTLIERS, 1.0 - UNRELATED_OUTLIERS  # chance lets some keypoints agree
    unary = np.stack([-weight * (good * np.log(1 - p) + bad * np.log(p)) for p in shares], axis=-1)
    transition = np.zeros((*unary.shape, 2))
    transition[..., 0, 1] = transition[..., 1, 0] = BOUND
    found = (s for s in view_runs(best_states(unary, transition)) if s.last - s.first + 1 >= least_frames)
    return sorted(found, key=lambda s: (s.first - s.last, s.view))


def view_runs(states: np.ndarray) -> list[ViewRange]:
    """Return each run of true states (C, F)."""
    return [ViewRange(*run, view) for view, mask in enumerate(states) for run in true_runs(mask)]


def without_faults(cameras: Cameras, keypoints: Keypoints2D, reading: Reading, frames: slice) -> Keypoints2D:
    """Return the detections in a range, corrected for the faults of an interpretation."""
    everybody = Detections.of_people(cameras.names, [keypoints.at(frames)])
    _, read = apply_reading(cameras, everybody, replace(reading, owners=tuple(range(len(cameras))), moved=()))
    xy, confidence = read.xy[:, :, 0].copy(), read.confidence[:, :, 0].copy()
    hands = None if read.hands is None else read.hands[:, :, 0].copy()
    for view in range(len(cameras)):
        if (turn := turned_by(cameras, reading, view)) is not None:
            camera = cameras.subset([reading.owners[view]])
            xy[view] = rotated_back(camera, xy[view], turn)
            if hands is not None:
                points = hands[view, ..., :2]
                hands[view, ..., :2] = rotated_back(camera, points.reshape(len(points), -1, 2), turn).reshape(
                    points.shape
                )
    order = np.argsort(reading.owners)  # the view of each camera
    whole_hands = None if hands is None else np.array(keypoints.hands)
    result = replace(keypoints, xy=keypoints.xy.copy(), confidence=keypoints.confidence.copy(), hands=whole_hands)
    for whole, changed in zip((result.xy, result.confidence, result.hands), (xy, confidence, hands), strict=True):
        if whole is not None and changed is not None:
            whole[:, frames] = changed[order]
    return result


def turned_by(cameras: Cameras, reading: Reading, view: int) -> np.ndarray | None:
    """Return the (3,) rotation vector of a rotated camera in radians and camera axes, or None."""
    pose = reading.pose_of(view)
    return None if pose is None else log_so3(np.reshape(pose[:9], (3, 3)) @ cameras.R[reading.owners[view]].T)


@dataclass(frozen=True)
class ViewFault(FrameSpan):
    """Range of frames with contradicting views, and the interpretation that explains them."""

    reading: Reading


Finding = TypeVar("Finding")


@dataclass(frozen=True)
class CheckedViews(Generic[Finding]):
    """Detections of one person after a check of the views."""

    keypoints: Keypoints2D  # The detections, repaired or without what was excluded.
    triangulation: Triangulation  # Of these detections.
    found: tuple[Finding, ...]  # Undone faults or excluded ranges.


def repair_views(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> CheckedViews[ViewFault]:
    """Undo faults of views in a range of frames that explain a contradiction, see ``explain``."""
    faults: list[ViewFault] = []
    while len(cameras) > 2 and len(faults) < 2 * len(cameras):
        fault = _next(cameras, keypoints, triangulation)
        if fault is None:
            break
        keypoints = without_faults(cameras, keypoints, fault.reading, fault.frames)
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
        faults.append(fault)
    return CheckedViews(keypoints, triangulation, tuple(faults))


def _next(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> ViewFault | None:
    """Return the next fault to undo, or None if no explanation is certain."""
    ranges = inconsistent_ranges(triangulation, keypoints.confidence, LASTING_S * keypoints.fps)
    tried = [(found.first, found.last) for found in ranges]
    if triangulation.sigma_px.mean() > USUAL_SIGMA_SHARE * cameras.image_size.max(axis=1).mean():
        # Views that agree on a wrong interpretation make a correct view look wrong.
        tried.insert(0, (0, keypoints.num_frames - 1))
    for first, last in dict.fromkeys(tried):
        everybody = _everybody(cameras, keypoints, first, last)
        found = explain(cameras, everybody, rows=RANGE_ROWS)
        if found.changed and found.agrees and not found.reading.left_out:
            reading, evidence = found.reading, TakeEvidence(cameras, everybody)
            for view in (view for view, pose in enumerate(reading.moved) if pose):  # again, in more frames
                exact = refit_pose(evidence, replace(reading, moved=()), view, turned=True)
                reading = reading if exact is None else reading.with_pose(view, exact)
            return _extended(cameras, keypoints, ViewFault(first, last, reading))
    return None


def _everybody(cameras: Cameras, keypoints: Keypoints2D, first: int, last: int) -> Detections:
    return Detections.of_people(cameras.names, [keypoints.named.frames(first, last + 1)])


def _extended(cameras: Cameras, keypoints: Keypoints2D, fault: ViewFault) -> ViewFault:
    """Extend a fault to earlier and later frames if its interpretation fits them better."""
    for first, last in ((0, fault.first - 1), (fault.last + 1, keypoints.num_frames - 1)):
        if last >= first:
            evidence = TakeEvidence(cameras, _everybody(cameras, keypoints, first, last))
            if evidence.poses:
                ratios, _ = evidence.likelihoods([Reading.as_written(len(cameras)), fault.reading])
                if ratios[1] > ratios[0]:
                    fault = replace(fault, first=min(fault.first, first), last=max(fault.last, last))
    return fault


def exclude_views(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> CheckedViews[ViewRange]:
    """Exclude the frame ranges of views that contradict at least two others."""
    least = BRIEF_S * keypoints.fps
    found = inconsistent_ranges(triangulation, keypoints.confidence, least) if len(cameras) > 2 else []
    chosen = tuple(s for s in found if _is_hopeless(cameras, keypoints, s))
    return without_ranges(cameras, keypoints, triangulation, chosen)


def without_ranges(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, ranges: Sequence[ViewRange],
    wrong: np.ndarray | None = None,
) -> CheckedViews[ViewRange]:  # fmt: skip
    """Exclude frame ranges of views, or only the ``wrong`` (C, F) frames in them."""
    if not ranges:
        return CheckedViews(keypoints, triangulation, ())
    out = np.zeros(keypoints.confidence.shape[:2], bool)
    for view_range in ranges:
        out[view_range.view, view_range.frames] = True
    out &= True if wrong is None else wrong
    keypoints = replace(keypoints, confidence=np.where(out[..., None], 0.0, keypoints.confidence))
    return CheckedViews(keypoints, triangulate(cameras, keypoints.xy, keypoints.confidence), tuple(ranges))


def _is_hopeless(cameras: Cameras, keypoints: Keypoints2D, view_range: ViewRange) -> bool:
    """Return whether a view is unrelated to every other view while all others agree."""
    written = Reading.as_written(len(cameras))
    evidence = TakeEvidence(cameras, _everybody(cameras, keypoints, view_range.first, view_range.last))
    if not evidence.poses:
        return False
    pairs, noise = evidence.pair_noise(written)
    wrong = ~noise.is_related
    own = np.array([view_range.view in pair for pair in pairs])
    return bool(own.any() and (~own).any() and wrong[own].all() and not wrong[~own].any())


def best_states(unary: np.ndarray, transition: np.ndarray) -> np.ndarray:
    """Return (..., F) states that minimise ``Σ_f u_f(s_f) + Σ_f T_f(s_{f-1}, s_f)`` (Viterbi 1967).

    Costs are (..., F, 2) of each state, and (..., F, 2, 2) of the transition from the previous frame's state. Ties give
    state 0.
    """
    cost, before = unary[..., 0, :], list[np.ndarray]()
    for f in range(1, unary.shape[-2]):
        ways = cost[..., :, None] + transition[..., f, :, :]
        before.append(ways[..., 1, :] < ways[..., 0, :])
        cost = ways.min(axis=-2) + unary[..., f, :]
    states = [cost[..., 1] < cost[..., 0]]
    for came in reversed(before):
        states.append(np.where(states[-1], came[..., 1], came[..., 0]))
    return np.stack(states[::-1], axis=-1)
