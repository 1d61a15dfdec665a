"""Estimate each camera's start frame from the epipolar lines of people.

A table per pair of views has their agreement at every offset. The best offsets maximise the sum over the pairs. They
are accepted only if they beat the offsets of the frame numbers and all alternatives by a margin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from itertools import product

import numpy as np

from solver_backend.agreement.evidence import EACH, LEAST_NOISE, MATCHING_SHARE, SAMPLED_FRAMES, STRIDE
from solver_backend.agreement.hypotheses import SPREAD
from solver_backend.agreement.lags import LEAST_STRENGTH, best_offsets, people_lags, rival_offsets
from solver_backend.agreement.person_tracks import STEP_SHARE
from solver_backend.agreement.reading import PictureReading, Reading, apply_reading, extent, sightings
from solver_backend.agreement.synchronisation import REACH_S
from solver_backend.cameras.camera_corrections import FACTORS, POSES, TURNS
from solver_backend.types import UNSEEN_POINT, Cameras, Detections


class StartEvidence(Enum):
    """Result of comparing the views at different starts of the cameras."""

    IN_STEP = "in step"  # They agree by their frame numbers, and no other offset is better by a margin.
    APART = "apart"  # They agree far better at other offsets, and only there.
    STILL = "still"  # Unknown, because too little moves or is visible in two cameras.
    AMBIGUOUS = "ambiguous"  # They agree equally at several offsets, and less by their frame numbers.


@dataclass(frozen=True)
class CameraStarts:
    """Start of the take in each of C cameras: the row that corresponds to row 0 of the take."""

    offsets: np.ndarray  # (C,) whole frames. Frame f of the take is row f + offset of the camera.
    evidence: StartEvidence  # Evidence. Unless it is ``APART``, the offsets are the numbered ones.
    doubtful: tuple[int, ...] = ()  # Cameras without evidence, or for ``AMBIGUOUS`` those with several offsets.
    rivals: tuple[int, int] = (0, 0)  # The two best offsets of the first of these relative to the first camera.


def find_starts(cameras: Cameras, detections: Detections, fps: float, numbered: np.ndarray) -> CameraStarts:
    """Estimate the row where the take starts in each camera, with alternatives if ambiguous.

    Row 0 is the first recorded frame of each camera. ``numbered`` (C,) are the rows according to the frame numbers.
    The solve later estimates delays of less than a frame.
    """
    count, seen = len(cameras), sightings(cameras, detections)
    if count < 2:
        return CameraStarts(numbered, StartEvidence.IN_STEP)
    gains = people_lags(cameras, seen.xy)
    best = best_offsets(gains.gains, count)
    sure = gains.strengths(best) >= LEAST_STRENGTH
    if sure.sum() < 2:
        return CameraStarts(numbered, StartEvidence.STILL, tuple(range(count)))
    doubtful = tuple(np.flatnonzero(detections.people().any(axis=1) & ~sure).tolist())
    now, then = (gains.of_cameras(offsets, sure)[0] for offsets in (numbered, best))
    if (now >= MATCHING_SHARE * then)[sure].all():
        return CameraStarts(numbered, StartEvidence.STILL if doubtful else StartEvidence.IN_STEP, doubtful)
    if rivals := rival_offsets(gains.gains, best, np.flatnonzero(sure), round(REACH_S * fps)):
        return CameraStarts(numbered, StartEvidence.AMBIGUOUS, tuple(rivals), next(iter(rivals.values())))
    fine = people_lags(cameras, seen.xy, SAMPLED_FRAMES, LEAST_NOISE).gains
    for (i, j), table in fine.items():
        changes = np.arange(len(table)) - len(table) // 2 - int(best[j] - best[i])
        table[(np.abs(changes) > STRIDE) | ~(sure[i] & sure[j])] = 0.0
    exact, first = best_offsets(fine, count), int(sure.argmax())
    return CameraStarts(np.where(sure, best[first] + exact - exact[first], numbered), StartEvidence.APART, doubtful)


def _strengths(cameras: Cameras, detections: Detections) -> np.ndarray:
    """Return how strongly a few frames of each camera match at the best offsets (see ``PeopleLags.strengths``)."""
    step = max(1, -(-detections.num_frames // SAMPLED_FRAMES))
    thin = replace(detections, xy=detections.xy[:, ::step], confidence=detections.confidence[:, ::step], hands=None)
    gains = people_lags(cameras, sightings(cameras, thin).xy)
    return gains.strengths(best_offsets(gains.gains, len(cameras)))


def read_out_of_step(cameras: Cameras, detections: Detections) -> Reading | None:
    """Find the correction of all files that makes shifted views match clearly best. Return None if none is clear."""
    count, written = len(cameras), Reading.as_written(len(cameras))
    if not 2 <= count <= EACH or not (detections.people() > 0).any(axis=1).all():
        return None
    readings = [replace(written, pictures=(PictureReading(*kind),) * count) for kind in product(FACTORS, TURNS)]
    readings += [replace(written, pose=pose, graphics=axes) for pose, axes in product(POSES, (False, True))]
    found = {r: float(np.median(_strengths(*apply_reading(cameras, detections, r)))) for r in dict.fromkeys(readings)}
    best = max(found, key=lambda reading: found[reading])
    kinds = {r: (r.pose, r.graphics, r.pictures[0].turn, r == written) for r in found}
    size = {r: float(np.log(r.pictures[0].size)) for r in found}
    rivals = [found[r] for r in found if kinds[r] != kinds[best] or abs(size[r] - size[best]) > SPREAD]
    clear = found[best] >= LEAST_STRENGTH and max(rivals) < MATCHING_SHARE * found[best]
    return best if clear and best != written else None


def common_rows(offsets: np.ndarray, lengths: np.ndarray, *, every: bool = False) -> tuple[int, int]:
    """Return the first frame of the take that the cameras have in common, and one past the last one.

    Frame f of the take is row f + offset (C,) of a camera. Cameras that recorded no rows are ignored. If the cameras
    have few frames in common, two cameras per frame are enough, except with ``every``.
    """
    recorded = lengths > 0
    first, stop = -offsets[recorded], (lengths - offsets)[recorded]
    low, high = int(first.max()), int(stop.min())
    if every or 2 * (high - low) >= lengths[recorded].min():
        return low, high
    # Few rows are common to all. By two cameras: from the second start to the second-last end.
    moments = np.arange(int(first.min()), int(stop.max()))
    several = ((moments[:, None] >= first) & (moments[:, None] < stop)).sum(1) >= min(2, len(first))
    return (int(moments[several][0]), int(moments[several][-1]) + 1) if several.any() else (0, 0)


def align_rows(detections: Detections, offsets: np.ndarray, first: int, stop: int) -> Detections:
    """Return frames ``first`` to ``stop - 1`` of the take (see ``common_rows``), empty where not recorded."""
    return _at_rows(detections, np.arange(first, stop) + offsets[:, None])


def as_numbered(detections: Detections) -> Detections:
    """Align the rows of all cameras by their frame numbers."""
    offsets = detections.starts[0] - detections.starts
    first, stop = common_rows(offsets, detections.counts)
    return align_rows(detections, offsets, first, stop) if stop > first else detections


def _at_rows(detections: Detections, rows: np.ndarray) -> Detections:
    beyond, views = (rows < 0) | (rows >= detections.num_frames), np.arange(len(rows))[:, None]
    rows = np.clip(rows, 0, max(detections.num_frames - 1, 0))
    xy, confidence = detections.xy[views, rows], detections.confidence[views, rows]
    xy[beyond], confidence[beyond] = np.nan, 0.0
    hands = None if detections.hands is None else detections.hands[views, rows]
    if hands is not None:
        hands[beyond] = UNSEEN_POINT
    return replace(detections, xy=xy, confidence=confidence, hands=hands)


def at_one_rate(detections: Detections, rates: np.ndarray) -> Detections:
    """Resample each camera to the take's frame rate. Interpolate between frames that show the same person.

    ``rates`` (C,) are camera frames per frame of the take.
    """
    last = (detections.counts - 1) / rates
    frames = np.arange(int(last.max()) + 1)
    at = np.where(frames <= last[:, None], frames * rates[:, None], -1.0)
    before, after = (_at_rows(detections, rounded(at).astype(int)) for rounded in (np.floor, np.ceil))
    share, both = at % 1, (before.confidence > 0) & (after.confidence > 0)
    move = np.where(both, np.linalg.norm(after.xy - before.xy, axis=-1), 0.0).sum(-1) / np.maximum(both.sum(-1), 1)
    same = both & (move < STEP_SHARE * np.nan_to_num(extent(np.where(both[..., None], before.xy, np.nan))))[..., None]

    def between(one: np.ndarray, other: np.ndarray, mixable: np.ndarray) -> np.ndarray:
        part = share.reshape(*share.shape, *[1] * (one.ndim - 2))
        mixed = (1 - part) * one + part * other
        return np.where(mixable, mixed, np.where(part > 0.5, other, one)).astype(one.dtype)

    hands = None
    if before.hands is not None and after.hands is not None:
        handed = same.any(-1)[..., None, None] & (before.hands[..., 2] > 0) & (after.hands[..., 2] > 0)
        hands = between(before.hands, after.hands, handed[..., None])
    firsts, lengths = np.round(detections.starts / rates).astype(int).tolist(), (at >= 0).sum(axis=1).tolist()
    apart = len({*firsts}) > 1 or len({*lengths}) > 1
    return replace(
        before,
        xy=between(before.xy, after.xy, same[..., None]),
        confidence=between(before.confidence, after.confidence, same),
        hands=hands,
        first_frames=tuple(firsts) if apart else (),
        lengths=tuple(lengths) if apart else (),
    )


CAMERA_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0)  # Usual frame rates.


def rates_by_length(cameras: Cameras, detections: Detections) -> np.ndarray:
    """Estimate the (C,) frame rates relative to the longest camera from the numbers of frames, usually 1."""
    usual, counts = np.divide.outer(CAMERA_RATES, CAMERA_RATES).ravel(), detections.counts
    off = np.abs(counts[:, None] - counts.max() * usual)
    ratios = np.where(off.min(axis=1) < STRIDE, usual[off.argmin(axis=1)], 1.0)
    return ratios if rates_match(cameras, detections, ratios) else np.ones(len(cameras))


def rates_match(cameras: Cameras, detections: Detections, rates: np.ndarray) -> bool:
    """Return whether the views match better at these (C,) frame rates, relative to the take's, than at rates of 1.

    Cameras of one rate match each other at any rate, so the group with the lowest median decides.
    """
    if (rates == 1).all():
        return False
    tried = (_strengths(cameras, rows) for rows in (at_one_rate(detections, rates), detections))
    then, now = (min(float(np.median(found[rates == rate])) for rate in set(rates.tolist())) for found in tried)
    return then >= LEAST_STRENGTH and now < MATCHING_SHARE * then
