"""Recognise the joint set of a detector by the number of keypoints and by anatomy."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.agreement.evidence import SAMPLED_FRAMES
from solver_backend.agreement.reading import ENOUGH
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import KeypointCountMismatch
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS
from solver_backend.types import JointSet

_BONES: tuple[tuple[str, str], ...] = (
    ("{s}_shoulder", "{s}_elbow"), ("{s}_elbow", "{s}_wrist"), ("{s}_hip", "{s}_knee"), ("{s}_knee", "{s}_ankle"),
    ("{s}_ankle", "{s}_heel"), ("{s}_ankle", "{s}_big_toe"), ("{s}_big_toe", "{s}_small_toe"), ("nose", "{s}_eye"),
    ("{s}_eye", "{s}_ear"), ("neck", "{s}_shoulder"), ("mid_hip", "{s}_hip"), ("upper_neck", "{s}_shoulder"),
    ("head_top", "nose"), ("thorax", "{s}_shoulder"), ("thorax", "spine"), ("spine", "mid_hip"),
    ("left_hip", "right_hip"), ("left_shoulder", "right_shoulder"),
)  # fmt: skip
"""Pairs of keypoints that are close in every pose if the joint set is right."""
CLEAR_RATIO = 1.15  # Smallest ratio of the bone lengths of the second-best set to the best set, if the best is certain.
UNLIKE = 0.3
"""Largest bone length relative to the person's height. On the demo, every set has 0.12 to 0.19 in the right order of
keypoints, and 0.42 to 0.57 (median) in another order. Crouching people have nearly 0.3."""
HANDS_ALONE = "Hands cannot be solved without a body. Also detect the body."  # Hint for files with hands only.


def require_known_count(num_keypoints: int, given: JointSet | None, *, where: str = "") -> None:
    """Check that the given joint set has this number of keypoints. Without a set, check that any set has it.

    Raises:
        KeypointCountMismatch: the number differs. The message lists the sets with this number.
    """
    if num_keypoints in given.num_written if given else JointSet.fitting(num_keypoints):
        return
    what, fits = f"No known joint set has {num_keypoints} keypoints.", JointSet.fitting(num_keypoints)
    known = ", ".join(f"{s.value} ({'/'.join(map(str, s.num_written))})" for s in JointSet)
    hint = f"Joint sets with {num_keypoints} keypoints: {', '.join(s.value for s in fits)}."
    if not fits:
        advice = "Name the keypoints in a keypoints.json file next to the recording."
        hint = f"{advice} Known sets and their numbers of keypoints: {known}."
    if given is not None:
        what = f"The files have {num_keypoints} keypoints per person, but {given.value} has {given.num_keypoints}."
    elif num_keypoints in (NUM_HAND_POINTS, 2 * NUM_HAND_POINTS):
        what = f"The files have {num_keypoints} keypoints per person: hand points, without a body."
        hint = HANDS_ALONE
    raise KeypointCountMismatch(what, where=where, hint=hint)


def choose_joint_set(
    xy: np.ndarray, confidence: np.ndarray, given: JointSet | None, configured: JointSet | None, *, where: str = ""
) -> tuple[JointSet, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Choose the joint set of keypoints (..., K, 2). Return notes and warnings too.

    The user's choice ``given`` is final. The set ``configured`` in the settings of the recording is used unless it has
    another number of keypoints, or anatomy clearly contradicts it. Otherwise the set is recognised.

    Raises:
        KeypointCountMismatch: the given set, or every set, has another number of keypoints.
    """
    count = xy.shape[-2]
    if given is not None:
        require_known_count(count, given, where=where)
        return given, (diagnostic("joint_set_chosen", source="given", joint_set=given.value),), ()
    xy, confidence = xy.reshape(-1, count, 2), confidence.reshape(-1, count)
    seen = np.flatnonzero((confidence > 0).any(-1))
    sample = seen[:: max(1, len(seen) // SAMPLED_FRAMES)]
    best, found, certain = recognise_joint_set(xy[sample], confidence[sample], where=where)
    if configured is best or (configured is not None and count in configured.num_written and not certain):
        return configured, (diagnostic("joint_set_chosen", source="config", joint_set=configured.value),), ()
    if certain and configured is None:
        return best, (found,), ()
    why: dict[str, Any] = {"reason": "anatomy"}
    if configured is not None:
        why = {"reason": "config", "configured": configured.value}
    return best, (found,), (diagnostic("joint_set_uncertain", joint_set=best.value, **why),)


def recognise_joint_set(
    xy: np.ndarray, confidence: np.ndarray, *, where: str = ""
) -> tuple[JointSet, Diagnostic, bool]:
    """Return the joint set with the shortest bones in the detections of N people, a note, and whether it is certain.

    Several sets may have the same number of keypoints (BODY_25 and BODY_25B have 25). In a wrong set, the bones connect
    distant keypoints.

    Raises:
        KeypointCountMismatch: no known set has K keypoints.
    """
    require_known_count(xy.shape[1], None, where=where)
    scores = {joint_set: bone_score(joint_set, xy, confidence) for joint_set in JointSet.fitting(xy.shape[1])}
    best, *others = sorted(scores, key=lambda joint_set: scores[joint_set])
    seen = np.isfinite(scores[best])
    is_like = not seen or scores[best] <= UNLIKE or len(xy) < ENOUGH
    if not others:
        source = "count" if is_like else "unlike"
        return best, diagnostic("joint_set_chosen", source=source, joint_set=best.value, count=xy.shape[1]), is_like
    if not seen:
        return best, diagnostic("joint_set_chosen", source="unseen", joint_set=best.value), False
    ratio = scores[others[0]] / max(scores[best], 1e-9)
    found = diagnostic("joint_set_chosen", source="anatomy", joint_set=best.value, rival=others[0].value, ratio=ratio)
    return best, found, is_like and ratio > CLEAR_RATIO


def bone_score(joint_set: JointSet, xy: np.ndarray, confidence: np.ndarray) -> float:
    """Return the RMS bone length relative to the height in the image (median over people), infinity if unknown."""
    names = joint_set.keypoints
    pairs = {(a.format(s=side), b.format(s=side)) for a, b in _BONES for side in ("left", "right")}
    known_pairs = [(names.index(a), names.index(b)) for a, b in sorted(pairs) if a in names and b in names]
    start, end = np.array(known_pairs).T
    points = np.where((confidence > 0)[..., None], xy, np.nan)
    seen = np.isfinite(points).all(-1)
    points = points[seen.sum(1) >= len(names) // 2]
    height = (np.nanmax(points, axis=1) - np.nanmin(points, axis=1)).max(-1)
    lengths = np.linalg.norm(points[:, start] - points[:, end], axis=-1)
    usable = (height > 0) & np.isfinite(lengths).any(1)
    rms = np.sqrt(np.nanmean(lengths[usable] ** 2, axis=1))
    return float(np.median(rms / height[usable])) if usable.any() else float("inf")
