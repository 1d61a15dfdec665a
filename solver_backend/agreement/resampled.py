"""Bring detections of cameras with different frame rates to one rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.evidence import BOUND, TakeEvidence
from solver_backend.agreement.reading import Reading
from solver_backend.agreement.starts import matches
from solver_backend.types import UNSEEN_POINT, Cameras

NEAR = 0.15  # Largest mean step of one person's keypoints from frame to frame, in the person's extent.


def nearest_rows(detections: Detections, chosen: Sequence[int], rates: Sequence[float]) -> Detections:
    """Return the nearest frame of chosen cameras to every moment.

    Args:
        detections: C cameras, each from its own first frame.
        chosen: indices of cameras.
        rates: frames of each for one of the take.
    """
    rows = [_moments(detections, c, rate) for c, rate in zip(chosen, rates, strict=True)]
    longest = max(map(len, rows))
    shape = (len(chosen), longest, *detections.confidence.shape[2:])
    xy, confidence = np.full((*shape, 2), np.nan, detections.xy.dtype), np.zeros(shape, detections.confidence.dtype)
    hands = None if detections.hands is None else np.full((*shape[:3], *detections.hands.shape[3:]), np.nan, np.float32)
    if hands is not None:
        hands[:] = UNSEEN_POINT
    for i, (c, at) in enumerate(zip(chosen, rows, strict=True)):
        near = np.minimum(np.round(at).astype(int), detections.num_frames - 1)
        xy[i, : len(at)], confidence[i, : len(at)] = detections.xy[c, near], detections.confidence[c, near]
        if hands is not None and detections.hands is not None:
            hands[i, : len(at)] = detections.hands[c, near]
    names = tuple(detections.cameras[c] for c in chosen)
    return replace(detections, cameras=names, xy=xy, confidence=confidence, hands=hands, first_frames=(), lengths=())


def at_one_rate(detections: Detections, rates: Sequence[float]) -> Detections:
    """Return every camera at the moments of the take, interpolated where both frames show the same person.

    Args:
        detections: C cameras, each from its own first frame.
        rates: (C,) frames of a camera for one of the take.
    """
    count = len(detections.cameras)
    result = nearest_rows(detections, range(count), rates)
    lengths = detections.lengths or (detections.num_frames,) * count
    kept = []
    for c, rate in enumerate(rates):
        kept.append(int((lengths[c] - 1) / rate) + 1)
        if rate != 1.0:
            _interpolate(detections, result, c, _moments(detections, c, rate))
    firsts = detections.first_frames or (detections.first_frame,) * count
    firsts = tuple(round(first / rate) for first, rate in zip(firsts, rates, strict=True))
    apart = len(set(firsts)) > 1 or len(set(kept)) > 1
    return replace(result, first_frames=firsts if apart else (), lengths=tuple(kept) if apart else ())


def _moments(detections: Detections, c: int, rate: float) -> np.ndarray:
    """Return the places of the take's moments among a camera's rows, in rows."""
    length = detections.lengths[c] if detections.lengths else detections.num_frames
    return np.arange(int((length - 1) / rate) + 1) * rate


def _interpolate(detections: Detections, result: Detections, c: int, at: np.ndarray) -> None:
    """Write keypoints between two frames with the same person into ``result``."""
    before = np.floor(at).astype(int)
    after = np.minimum(before + 1, detections.num_frames - 1)
    share = (at - before)[:, None, None, None]
    one, other = detections.xy[c, before], detections.xy[c, after]
    both = np.isfinite(one).all(-1) & np.isfinite(other).all(-1)
    seen = np.where(both[..., None], one, np.nan)
    move = np.where(both, np.linalg.norm(other - one, axis=-1), 0.0).sum(-1) / np.maximum(both.sum(-1), 1)
    low = np.where(both[..., None], seen, np.inf).min(-2)
    high = np.where(both[..., None], seen, -np.inf).max(-2)
    with np.errstate(invalid="ignore"):
        extent = np.linalg.norm(high - low, axis=-1)
    same = both & (move < NEAR * np.where(np.isfinite(extent), extent, 0.0))[..., None]
    result.xy[c, : len(at)][same] = ((1 - share) * one + share * other)[same]
    sure = np.minimum(detections.confidence[c, before], detections.confidence[c, after])
    result.confidence[c, : len(at)][same] = sure[same]
    if result.hands is not None and detections.hands is not None:
        one, other = detections.hands[c, before], detections.hands[c, after]
        together = same.any(-1)[..., None, None] & (one[..., 2] > 0) & (other[..., 2] > 0)
        between = (1 - share[..., None]) * one + share[..., None] * other
        result.hands[c, : len(at)][together] = between[together]


SAME_FRAMES = 2.0  # Largest difference of frame numbers of cameras that record the same seconds.
CAMERA_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0)  # Frames per second that cameras have.
MATCH_TIMES = 1.2  # Times the matching share of views as they are from which other frame rates explain them.


def rates_by_length(cameras: Cameras, detections: Detections, numbered: Detections) -> np.ndarray:
    """Return (C,) frames of each camera for one of the longest, ones unless the likelihood is far larger.

    Args:
        cameras: C cameras as written.
        detections: each from its own first frame.
        numbered: the rows that belong together by their numbers.
    """
    as_they_are = np.ones(len(cameras))
    if not detections.lengths:
        return as_they_are
    longest = max(detections.lengths)
    ratios = np.array([_standard(length, longest) for length in detections.lengths])
    if (ratios == 1.0).all():
        return as_they_are
    resampled = nearest_rows(detections, range(len(cameras)), ratios.tolist())
    then, now = (_likelihood(cameras, rows) for rows in (resampled, numbered))
    return ratios if then >= BOUND and then >= now + BOUND else as_they_are


def rates_match(cameras: Cameras, detections: Detections, rates: np.ndarray) -> bool:
    """Return whether the views match better at any offsets if cameras have other frame rates.

    Args:
        cameras: C cameras as written.
        detections: each from its own first frame.
        rates: (C,) frames of each for one of the take.
    """
    shares = list[float]()
    for tried in (rates, np.ones(len(rates))):
        rows = nearest_rows(detections, range(len(cameras)), tried.tolist())
        gained, possible = matches(cameras, rows)
        shares.append(float(gained.sum() / max(possible.sum(), 1e-9)))
    return shares[0] > MATCH_TIMES * shares[1]


def _standard(length: int, longest: int) -> float:
    """Return the ratio of two usual rates that explains a number of frames, 1 if none does."""
    ratios = sorted({round(a / b, 6) for a, b in product(CAMERA_RATES, CAMERA_RATES) if 0.2 < a / b < 5})
    ratio = min(ratios, key=lambda ratio: abs(ratio * longest - length))
    return ratio if abs(ratio * longest - length) <= SAME_FRAMES else 1.0


def _likelihood(cameras: Cameras, rows: Detections) -> float:
    evidence, written = TakeEvidence(cameras, rows), Reading.as_written(len(cameras))
    if not evidence.poses:
        return 0.0
    ratio, _ = evidence.likelihoods([written])
    return float(ratio[0]) * evidence.constraints(written) / evidence.design_effect(written)
