"""Repair the detections of a single camera, and estimate the depth uncertainty of its solve."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import ClassVar

import numpy as np

from solver_backend.agreement.repeated_frames import LEAST_REPEATED, repeated_frames, without_repeats
from solver_backend.biomechanics.segments import SEGMENTS, turn_spread
from solver_backend.exchange.body_layout import SMPL, BodyLayout
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, Severity, diagnostic
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.build_motion import PosedTake
from solver_backend.fitters.measurements.views import ViewPoints
from solver_backend.fitters.model.subject import BLOCK_POSES, FrameObjective, Subject, pose
from solver_backend.fitters.one_view.steady import stand_on_floor, steady_depth
from solver_backend.fitters.problem import Measurements, PointSource, Problem, RestWords, SolvedFrames, SolvedLayer
from solver_backend.fitters.recipes.bundle import Bundle
from solver_backend.geometry.arrays import constant, nearest_true, to_numpy, true_runs
from solver_backend.geometry.small_matrices import packed, unpacked
from solver_backend.priors.lifted_take import LiftedTake
from solver_backend.priors.view_lifter import PARTS, bone_slants, flip_chances
from solver_backend.residuals.positions import RelativePositionTerm
from solver_backend.residuals.terms import DataTerm, PointTerm
from solver_backend.types import Keypoints2D, Motion

CUT_SHARE, CUT_TIMES = 0.3, 6.0
"""Jump at a cut, relative to the person's extent and usual step. Sprinters move 0.15 extents per frame at 30 fps."""
CUT_POINTS, USUAL_S = 4, 0.5  # Keypoints that both frames must show, and seconds around them for the usual step.
GLIDE_M_S, GLIDE_S, GLIDE_SHARE = 0.35, 0.7, 0.5
"""A person glides if the body moves faster than this speed (m/s) for this time (s), while the feet move relative to the
body at less than this share of its speed. A walker's feet move as fast as the body, and jumps are shorter."""
SMOOTH_S = 0.25  # Averaging time in seconds that removes the jitter of a lifted pose.
_LEAST_EXTENT_PX = 1.0  # Smallest extent of a person in pixels.


def bridge_repeats(camera: str, keypoints: Keypoints2D) -> tuple[Keypoints2D, list[Diagnostic]]:
    """Interpolate repeated video frames in one view's detections, and report them."""
    again = repeated_frames(keypoints)
    share = 100.0 * float(again.mean())
    if share < LEAST_REPEATED:
        return keypoints, []
    found = diagnostic(
        "frames_repeated", cameras=[camera], frames=[(0, keypoints.num_frames - 1)], remedy=Remedy.BRIDGED, size=share
    )
    return without_repeats(keypoints, again), [found]


def diagnose_cuts(camera: str, keypoints: Keypoints2D) -> list[Diagnostic]:
    """Return a warning about cuts in one view's video."""
    last = cuts(keypoints.xy[0], keypoints.confidence[0] > 0, keypoints.fps)
    return [diagnostic("picture_cuts", cameras=[camera], frames=[(f, f + 1) for f in last])] if len(last) else []


def cuts(xy: np.ndarray, seen: np.ndarray, fps: float) -> np.ndarray:
    """Return the last frame before each cut of the video.

    Args:
        xy: (F, K, 2) keypoints in pixels.
        seen: (F, K) bool.
    """
    both = seen[1:] & seen[:-1]
    step = np.linalg.norm(np.where(both[..., None], np.diff(xy, axis=0), np.nan), axis=-1)
    low, high = (np.where(seen[..., None], xy, end) for end in (np.inf, -np.inf))
    span = np.where(seen.any(axis=1)[:, None], high.max(axis=1) - low.min(axis=1), np.nan)
    extent = np.linalg.norm(span, axis=-1)
    enough = both.sum(axis=1) >= CUT_POINTS
    jump = np.zeros(len(step))
    largest = np.maximum(np.maximum(extent[:-1], extent[1:])[enough], _LEAST_EXTENT_PX)
    jump[enough] = np.nanmedian(step[enough], axis=1) / largest
    around = max(2, round(USUAL_S * fps))
    near = np.lib.stride_tricks.sliding_window_view(np.pad(jump, around, mode="reflect"), 2 * around + 1)
    usual = np.median(near, axis=1) if len(jump) > around else np.full(len(jump), np.median(jump))
    return np.flatnonzero((jump > CUT_SHARE) & (jump > CUT_TIMES * usual))


def glides(root: np.ndarray, feet: np.ndarray, seen: np.ndarray, fps: float) -> list[tuple[int, int]]:
    """Return the frame ranges in which a person moves over the floor without stepping.

    Args:
        root: (F, 3) position of the root in world metres, Z up.
        feet: (F, 2, 3) positions of the ankles.
        seen: (F,) bool.
    """
    if len(root) < GLIDE_S * fps + 2:
        return []
    body = np.linalg.norm(_speed(root, fps)[:, :2], axis=-1)
    about = np.linalg.norm(_speed(feet - root[:, None], fps), axis=-1).max(axis=1)
    gliding = (body > GLIDE_M_S) & (about < GLIDE_SHARE * body) & seen
    return [run for run in true_runs(gliding) if run[1] - run[0] + 1 >= GLIDE_S * fps]


def _speed(points: np.ndarray, fps: float) -> np.ndarray:
    """Return the velocities of points (F, ...) in units per second, averaged over ``SMOOTH_S``."""
    half = max(1, round(0.5 * SMOOTH_S * fps))
    index = np.arange(len(points))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(points) - 1)
    span = (after - before).reshape(-1, *(1,) * (points.ndim - 1))
    return (points[after] - points[before]) * fps / span


LIMBS = {
    "arms": ("shoulder", "elbow", "wrist"),
    "legs": ("hip", "knee", "ankle", "big_toe", "small_toe", "heel"),
}  # Keypoints that a detector swaps together.
LEAST_PAIRS = 2  # Keypoint pairs that must jump at once. A single pair may be an outlier, and can only end a swap.
CROSSED_SHARE = 0.5  # A swap must leave less than this share of the jump.
JUMP_SHARE = 0.1
"""Smallest gain from a swap per keypoint, relative to the person's extent: for the mean over a limb, and for a single
pair."""
LONGEST_S = 1.5  # Longest swap in seconds. In longer ranges, the correct side is unknown.
SEEN_BEFORE_S = 0.2  # A keypoint's last position is used for this number of seconds.


def restore_sides(
    camera: str, keypoints: Keypoints2D, but: Collection[str] = ()
) -> tuple[Keypoints2D, list[Diagnostic]]:
    """Undo left-right swaps of limbs in one view's detections, and report them. Swaps of the limbs ``but`` remain."""
    names, xy, confidence = keypoints.joint_set.keypoints, keypoints.xy[0].copy(), keypoints.confidence[0].copy()
    seen, found = confidence > 0, list[Diagnostic]()
    for part, names_of in LIMBS.items():
        pairs = [(names.index(f"left_{p}"), names.index(f"right_{p}")) for p in names_of if f"left_{p}" in names]
        if len(pairs) < LEAST_PAIRS:
            continue
        left, right = np.array(pairs).T
        jumped = side_jumps(keypoints.xy[0], seen, pairs, keypoints.fps)
        exchanged, others = exchanged_stretches(jumped, LONGEST_S * keypoints.fps)
        exchanged &= part not in but
        rows = np.flatnonzero(exchanged)[:, None]
        for values in (xy, confidence):
            values[rows, left], values[rows, right] = values[rows, right], values[rows, left]
        if len(rows):
            runs = true_runs(exchanged)
            found.append(
                diagnostic("limbs_exchanged", cameras=[camera], frames=runs, remedy=Remedy.REPAIRED, part=part)
            )
        if others:
            frames = [(jump - 1, jump) for jump in others]
            found.append(diagnostic("limbs_jump_sides", cameras=[camera], frames=frames, part=part))
    return replace(keypoints, xy=xy[None], confidence=confidence[None]), found


def side_jumps(xy: np.ndarray, seen: np.ndarray, pairs: Sequence[tuple[int, int]], fps: float) -> np.ndarray:
    """Count the left-right keypoint pairs of a limb that swap sides in each frame (F,).

    A step ``x_t - x_{t-1}`` is predicted by the mean of the steps before and after it. A pair swaps if the prediction
    fits better after its left and right keypoints are exchanged. Limbs that pass each other continue their motion, so
    they do not count.
    """
    columns = np.array(pairs)
    both = seen[:, columns].all(axis=-1)
    reach = max(1, round(SEEN_BEFORE_S * fps))
    last = _last_seen(both, reach)
    tracks = xy[:, columns]
    size = _extent(xy, seen)
    own, other = np.zeros(len(xy)), np.zeros(len(xy))
    seen_pairs, jumped = np.zeros(len(xy), dtype=int), np.zeros(len(xy), dtype=int)
    for pair in range(len(columns)):
        rows = np.flatnonzero(both[:, pair] & (last[:, pair] >= 0))
        before = last[rows, pair]
        here, there = tracks[rows, pair], tracks[before, pair]
        track, known = tracks[:, pair], both[:, pair]
        into, out = _step_before(track, known, before), _step_after(track, known, rows)
        gap = (rows - before)[:, None, None]
        mine, theirs = (
            np.linalg.norm(now - there - gap * 0.5 * (into + onward), axis=-1).sum(axis=1)
            for now, onward in ((here, out), (here[:, ::-1], out[:, ::-1]))
        )
        own[rows] += mine
        other[rows] += theirs
        seen_pairs[rows] += 1
        jumped[rows] += (theirs < CROSSED_SHARE * mine) & (mine - theirs > JUMP_SHARE * size[rows])
    gained = own - other > 2.0 * JUMP_SHARE * size * np.maximum(seen_pairs, 1)
    return np.where(gained & (other < CROSSED_SHARE * own), jumped, 0)


def exchanged_stretches(jumped: np.ndarray, longest: float) -> tuple[np.ndarray, list[int]]:
    """Return an (F,) mask of frames with swapped sides, and the frames of the jumps that could not be paired.

    ``jumped`` (F,) is the number of keypoint pairs that swap sides in each frame. Two jumps of at least ``LEAST_PAIRS``
    pairs within ``longest`` frames start and end a swap. A remaining jump is combined with a jump of fewer pairs, if
    there is exactly one within ``longest`` frames. Otherwise, the correct side is unknown.
    """
    edges, exchanged = np.flatnonzero(jumped >= LEAST_PAIRS).tolist(), np.zeros(len(jumped), dtype=bool)
    faint = np.flatnonzero((jumped > 0) & (jumped < LEAST_PAIRS))
    while len(edges) > 1:
        lengths = np.diff(edges)
        part = int(np.argmin(lengths))
        if lengths[part] > longest:
            break
        exchanged[edges[part] : edges[part + 1]] ^= True
        del edges[part : part + 2]
    for edge in tuple(edges):
        ends = faint[np.abs(faint - edge) <= longest]
        if len(ends) == 1:
            exchanged[min(edge, ends[0]) : max(edge, ends[0])] ^= True
            edges.remove(edge)
    return exchanged, edges


def _last_seen(both: np.ndarray, reach: int) -> np.ndarray:
    """Return the last earlier frame (F, P) that shows each pair, or -1 if it is more than ``reach`` frames ago."""
    before = np.vstack([np.full((1, both.shape[1]), -1), nearest_true(both)[0][:-1]])
    return np.where(np.arange(len(both))[:, None] - before <= reach, before, -1)


def _step_before(track: np.ndarray, both: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return a pair's motion (n, 2, 2) in pixels from the previous frame to each of n frames, or 0 if unknown."""
    known = (frames > 0) & both[np.maximum(frames - 1, 0)]
    return np.where(known[:, None, None], track[frames] - track[np.maximum(frames - 1, 0)], 0.0)


def _step_after(track: np.ndarray, both: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return a pair's motion (n, 2, 2) in pixels from each of n frames to the next frame, or 0 if unknown."""
    after = np.minimum(frames + 1, len(track) - 1)
    known = (after > frames) & both[after]
    return np.where(known[:, None, None], track[after] - track[frames], 0.0)


def _extent(xy: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the person's extent in px (F,): the RMS distance of keypoints from their mean."""
    weight = seen / np.maximum(seen.sum(axis=1, keepdims=True), 1)
    known = np.where(seen[..., None], xy, 0.0)
    middle = np.einsum("fk,fkc->fc", weight, known)
    square = np.einsum("fk,fkc->f", weight, np.where(seen[..., None], known - middle[:, None], 0.0) ** 2)
    size, enough = np.sqrt(square), seen.sum(axis=1) >= 6
    return np.where(enough, size, np.median(size[enough]) if enough.any() else np.inf)


ALIKE, ACROSS_M, POSE_TURNS = 1.3, 0.02, 0.2
"""Factor applied to the lifter's deviations along the line of sight, error per axis across it (m), and factor that
turns deviations into rotations for the size. Chosen by ``python -m tests.benchmarks.one_view_deviations``."""
POSE_SIZE = 0.005  # Relative error, due to the lifted pose, of the distance to a person of given size. Chosen by hand.
TURNS = {
    "pelvis": 0.28, "thorax": 0.58, "head": 0.0, "thigh": 1.28, "shank": 0.62, "foot": 0.2, "toes": 0.0,
    "upper_arm": 1.36, "forearm": 0.7, "hand": 0.14,
}  # fmt: skip
"""Factor from the lifter's deviations to each segment's rotation error, chosen by the same command."""
OPEN_M = 0.15  # A limb's depth is uncertain if its end has a larger deviation along the line of sight: half a step.
FLIP_CHANCE = 0.01
"""A limb's depth is also uncertain if the probability that one of its bones is flipped is larger. This applies to a
seventh of the limb frames in 18 takes of subjects 01, 08, 09 and 60, and to 73 % of their flips."""
SHORTEST_S = 0.2  # Frame ranges shorter than this number of seconds are not reported.
STANDS_SHARE = 0.02  # If a smaller share of feet is planted, the floor is undetermined. A walker has half.
LIMB_ENDS = {f"{side}_{end}": f"{side} {part}" for end, part in (("wrist", "arm"), ("ankle", "leg")) for side in SIDES}
LIMB_ENDS["head"] = "head"
"""Limb that each joint is the end of."""


@dataclass(frozen=True)
class OneView:
    """Uncertainty of a solve from a single camera."""

    camera: str
    centre: np.ndarray  # (F, 3) camera positions in metres.
    size_sigma: float  # Relative standard deviation of the person's size and distance, which are common to all frames.
    pose_sigma: float  # The part of it that is due to the lifted pose.
    focal_sigma: float  # Relative standard deviation of the focal length, which affects only distances.
    size_source: str  # Where the size comes from, as text for users.
    up_from_person: bool  # Whether up and floor were estimated from the person.
    sight: np.ndarray  # (F, 3) unit directions from the camera to the person.
    sight_sigma_m: np.ndarray
    """(F, J) standard deviations of joints along the line of sight from the lifter, relative to the body's centre."""
    slant_chances: np.ndarray
    """(F, 8, 3) probabilities that each limb bone points towards the camera, across, or away from it."""


@dataclass(frozen=True)
class OneCamera(PointSource):
    """Source of a solve's points: keypoints from one camera, and the pose lifted from them."""

    views: ViewPoints  # Detections by all cameras. Only one of them has any.
    open: OneView
    floor: tuple[PointTerm, ...]  # Terms for the floor, if it is known.
    lifted: RelativePositionTerm
    take: LiftedTake
    sized_by: Callable[[LiftedTake], Measurements]  # Returns these measurements, with the size taken from other poses.
    heights: np.ndarray | None = None
    """(L,) heights of a planted foot's points above the known floor in metres, NaN for other points."""
    REST: ClassVar[RestWords] = RestWords(Severity.WARNING, "is not seen", "are not seen")

    @property
    def recipe(self) -> str:
        """Name of the solve's recipe (see ``PointSource``)."""
        return "one camera"

    @property
    def sight(self) -> np.ndarray:
        """(F, 3) unit directions from the camera to the person."""
        return self.open.sight

    def terms(self) -> FrameObjective:
        """Return the terms for the floor and for the lifted pose."""
        return FrameObjective(self.floor, relative=(self.lifted,))

    def blocks(self, problem: Problem, solved: SolvedFrames, settings: SolveSettings) -> Problem:
        """Estimate the person's size again from the solved poses, if planted feet on a calibrated floor determine it.

        The solved poses are better than the lifted poses, in which for example the legs are bent too little.
        """
        if settings.betas is not None or self.heights is None or self.open.up_from_person or _never_stands(solved):
            return problem
        root, local = (to_numpy(part) for part in (solved.frames.root, solved.frames.local))
        R, _ = self.views.cameras.subset([self.views.cameras.names.index(self.open.camera)]).poses(0, len(root))
        view = replace(self.take.view, root=R @ root)
        return replace(problem, measurements=self.sized_by(replace(self.take, view=view, local=local)))

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Smooth the depth, put planted feet on the floor, and relax body parts without evidence."""
        solved = steady_depth(solved, self.open, problem.fps)
        if self.heights is not None:
            solved = stand_on_floor(solved, self.sight, problem.fps)
        solved = with_open_depth(solved, self.open, np.asarray(solved.subject.body.recorded_joints))
        found = diagnose_one_view(solved, self.open, problem)
        return self.views.after(problem, replace(solved, diagnostics=(*solved.diagnostics, *found)), settings, progress)

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Store the keypoints of the solved body in the motion."""
        return self.views.record(motion, posed)

    def report(self, points: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """Return reprojection errors and statistics (see ``PointSource``)."""
        return self.views.report(points)

    def constant_m(self, layout: BodyLayout) -> np.ndarray:
        """Return the standard deviations (J,) in metres of constant joint errors (see ``PointSource``)."""
        return self.views.constant_m(layout)

    def learn_noise(self, bundle: Bundle) -> DataTerm:
        """Return the data term unchanged, because one camera does not show depth errors."""
        return bundle.data


def with_open_depth(solved: SolvedFrames, one: OneView, joints: np.ndarray) -> SolvedFrames:
    """Add the depth uncertainty of a single camera to the covariances: ``Σ + a² 1 + ((k l)² + f² z²) d dᵀ + s² p pᵀ``.

    a is ``ACROSS_M``, k is ``ALIKE``, l the lifter's deviation, d the line of sight, z the depth and p the vector from
    the camera to the joint. s and f are the relative deviations of the person's size and of the focal length. Size and
    focal length change the depth: a taller person further away has the same image. Their errors are the same in all
    frames, so they do not average out.

    Args:
        joints: (J,) recorded joints of the body.
    """
    if solved.covariance is None:
        return solved
    covariance = unpacked(to_numpy(solved.covariance))
    for start in range(0, len(covariance), BLOCK_POSES):
        part = slice(start, start + BLOCK_POSES)
        away = _joints(solved.subject, solved, part)[:, joints] - one.centre[part, None]
        covariance[part] += one.size_sigma**2 * away[..., :, None] * away[..., None, :]
        sight = one.sight[part]
        far = one.focal_sigma * np.einsum("fja,fa->fj", away, sight)
        deep = (ALIKE * one.sight_sigma_m[part]) ** 2 + far**2
        covariance[part] += ACROSS_M**2 * np.eye(3)
        covariance[part] += deep[..., None, None] * (sight[:, None, :, None] * sight[:, None, None, :])
    like, turns = solved.frames.transl, solved.turns
    if turns is not None and turns.shape[1]:
        factors = np.array([TURNS[segment.removeprefix("left_").removeprefix("right_")] for segment in SEGMENTS])
        spread = (factors * turn_spread(solved.subject.body, one.sight_sigma_m)) ** 2
        wider = unpacked(to_numpy(turns)) + spread[..., None, None] * np.eye(3)
        turns = constant(packed(wider), like)
    return replace(solved, covariance=constant(packed(covariance), like), turns=turns)


def diagnose_one_view(solved: SolvedFrames, one: OneView, problem: Problem) -> list[Diagnostic]:
    """Return warnings about a single camera and about limbs with uncertain depth."""
    joints = problem.body.layout.recorded.joints
    columns = [joints.index(name) for name in LIMB_ENDS if name in joints]
    usual = 100.0 * float(np.median(one.sight_sigma_m[:, columns]))
    found = [diagnostic("one_camera", size=usual, share=100.0 * one.size_sigma, source=one.size_source)]
    if one.focal_sigma:
        found.append(diagnostic("focal_length_unsure", cameras=[one.camera], share=100.0 * one.focal_sigma))
    if one.up_from_person:
        found.append(diagnostic("up_from_person", cameras=[one.camera]))
    posed, fps = _all_joints(solved), problem.fps
    slants = bone_slants(posed[:, list(problem.body.layout.standing_for(SMPL))], one.sight)
    flips = dict(zip(PARTS, flip_chances(one.slant_chances, slants).T, strict=True))
    for name, part in LIMB_ENDS.items():
        if name not in joints:
            continue
        doubtful = one.sight_sigma_m[:, joints.index(name)] > OPEN_M
        if part in flips:
            doubtful |= flips[part] > FLIP_CHANCE
        runs = [run for run in true_runs(doubtful) if run[1] - run[0] + 1 >= SHORTEST_S * fps]
        if runs:
            found.append(diagnostic("limb_depth_open", frames=runs, joints=[name], part=part))
    return found + _diagnose_steps(solved, problem)


def _all_joints(solved: SolvedFrames) -> np.ndarray:
    blocks = [slice(start, start + BLOCK_POSES) for start in range(0, len(solved.frames.transl), BLOCK_POSES)]
    return np.concatenate([_joints(solved.subject, solved, part) for part in blocks])


def _diagnose_steps(solved: SolvedFrames, problem: Problem) -> list[Diagnostic]:
    measured, found = problem.measurements, list[Diagnostic]()
    names, seen = measured.landmarks.names, measured.seen
    parts = [[f"{side}_{part}" for side in SIDES] for part in ("hip", "ankle")]
    if all(name in names for name in chain(*parts)):
        # Use the lifted points. In the solution, contacts hold the feet of a standing person during a zoom.
        hips, feet = (measured.points[:, [names.index(name) for name in part]] for part in parts)
        root, shown = hips.mean(axis=1), seen & np.isfinite(feet).all(axis=(1, 2)) & np.isfinite(hips).all(axis=(1, 2))
        runs = glides(root, feet, shown, problem.fps)
        if runs:
            size = max(float(np.linalg.norm(root[last, :2] - root[first, :2])) for first, last in runs)
            found.append(diagnostic("person_glides", frames=runs, size=size))
    if _never_stands(solved, seen):
        found.append(diagnostic("feet_never_stand"))
    return found


def _never_stands(solved: SolvedFrames, seen: np.ndarray | slice = slice(None)) -> bool:
    return solved.contacts is not None and not solved.contacts[seen].mean() > STANDS_SHARE


def _joints(subject: Subject, solved: SolvedFrames, part: slice) -> np.ndarray:
    return np.asarray(to_numpy(pose(subject, solved.frames.select(part)).skeleton.joints))
