"""Check the numbers of every capture by one table: impossible ones are errors, odd ones are warnings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.cameras.projection import distort, largest_radius
from solver_backend.exchange import plausible
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, word
from solver_backend.exchange.errors import CalibrationInvalid, CaptureInvalid, MocapError
from solver_backend.io.recognition.confidence import on_unit_scale
from solver_backend.io.recognition.world_fit import check_world
from solver_backend.types import Cameras, Capture

_ROUNDING, _WIDEST = 1e-6, 1e3
FOCAL_LENGTHS = (0.25, 20.0)
"""In the longer side of the picture. 0.25 is a picture of 127°, 20 one of 3°."""
POSSIBLE_FOCAL_LENGTHS = (0.01, 1000.0)
FARTHEST_M, IMPOSSIBLE_M, COINCIDENT_M = 100.0, plausible.FARTHEST_M, 0.01
FRAME_RATES, POSSIBLE_FRAME_RATES = (1.0, 1000.0), plausible.FRAME_RATES
_OUTSIDE, _FAR_OUTSIDE, _MANY = 1.0, 50.0, 0.2
"""Picture sizes beyond the edge, and the share of the detections that makes it worth a sentence."""

Find = Callable[[Capture], Iterator[Diagnostic]]


@dataclass(frozen=True)
class RangeCheck:
    """One check."""

    find: Find  # Yields findings. An error rejects the capture, a warning is one of its problems.
    error: type[MocapError] = CaptureInvalid  # Raised for errors.


def checked(capture: Capture) -> Capture:
    """Return the capture with confidences in 0..1 and a problem for each new finding.

    Raises:
        CalibrationInvalid, CaptureInvalid: a number is impossible.
    """
    capture = _with_unit_confidence(capture)
    odd: list[Diagnostic] = []
    for check in RANGE_CHECKS:
        for found in check.find(capture):
            if found.severity is Severity.ERROR:
                words = word(found)
                raise check.error(words.what, where=capture.name, hint=words.advice)
            odd.append(found)
    return _with_world(_with_problems(capture, odd))


def _with_problems(capture: Capture, odd: Iterable[Diagnostic]) -> Capture:
    new = (item for item in odd if item not in capture.problems)
    return replace(capture, problems=(*capture.problems, *new))


def _with_world(capture: Capture) -> Capture:
    """Return the capture with a check of its world, if no reader has made one."""
    if capture.world_checked or not _has_views(capture) or capture.several_views is None:
        return capture
    world = check_world(*capture.require_multiview())
    if np.isnan(world.residual_px):
        return _with_problems(capture, [diagnostic("nothing_located")])
    return _with_problems(replace(capture, notes=(*capture.notes, *world.notes())), world.problems())


def _with_unit_confidence(capture: Capture) -> Capture:
    found = capture.keypoints
    if found is None:
        return capture
    confidence, notes, problems = on_unit_scale(found.confidence)
    return replace(
        capture,
        keypoints=replace(found, confidence=confidence) if notes or problems else found,
        notes=capture.notes + notes,
        problems=capture.problems + problems,
    )


def _of_cameras(find: Callable[[Cameras], Iterable[Diagnostic]]) -> Find:
    """Return a check of a capture that looks at its cameras, if it has any."""

    def found(capture: Capture) -> Iterator[Diagnostic]:
        if capture.cameras is not None and len(capture.cameras):
            yield from find(capture.cameras)

    return found


def _last_row(cameras: Cameras) -> Iterator[Diagnostic]:
    for name, K in zip(cameras.names, cameras.K, strict=True):
        if np.abs(K[2] - (0, 0, 1)).max() > _ROUNDING or abs(K[1, 0]) > _ROUNDING * K[1, 1]:
            yield diagnostic("intrinsics_impossible", cameras=[name], second=_row(K[1]), third=_row(K[2]))


def _row(values: np.ndarray) -> str:
    return f"({', '.join(f'{v:g}' for v in values)})"


def _focal_shares(cameras: Cameras) -> np.ndarray:
    """Return (C, 2) focal lengths over the longer side of the picture."""
    return np.stack([cameras.K[:, 0, 0], cameras.K[:, 1, 1]], axis=1) / cameras.image_size.max(axis=1, keepdims=True)


def _impossible_focal_lengths(cameras: Cameras) -> Iterator[Diagnostic]:
    yield from _focal_lengths(Severity.ERROR, cameras, POSSIBLE_FOCAL_LENGTHS)


def _odd_focal_lengths(cameras: Cameras) -> Iterator[Diagnostic]:
    yield from _focal_lengths(Severity.WARNING, cameras, FOCAL_LENGTHS)


def _focal_lengths(severity: Severity, cameras: Cameras, valid: tuple[float, float]) -> Iterator[Diagnostic]:
    outside = ((_focal_shares(cameras) < valid[0]) | (_focal_shares(cameras) > valid[1])).any(axis=1)
    for c in np.flatnonzero(outside):
        K, (width, height) = cameras.K[c], cameras.image_size[c].tolist()
        figures: dict[str, Any] = {"fx": K[0, 0], "fy": K[1, 1], "width": width, "height": height}
        yield diagnostic("focal_length_odd", severity=severity, cameras=[cameras.names[c]], **figures)


def _odd_centres(cameras: Cameras) -> Iterator[Diagnostic]:
    for name, K, size in zip(cameras.names, cameras.K, cameras.image_size, strict=True):
        if not ((K[:2, 2] > -0.5) & (K[:2, 2] < size)).all():
            width, height = size.tolist()
            yield diagnostic("centre_outside", cameras=[name], x=K[0, 2], y=K[1, 2], width=width, height=height)


def _folds(cameras: Cameras) -> Iterator[Diagnostic]:
    """A distortion with a shrinking radius maps two directions to one pixel."""
    limits = np.asarray(largest_radius(cameras.distortion, cameras.models)).reshape(-1)
    for c, limit in enumerate(limits):
        K, size = cameras.K[c], cameras.image_size[c]
        middles = np.array([(0, K[1, 2]), (size[0] - 1, K[1, 2]), (K[0, 2], 0), (K[0, 2], size[1] - 1)])
        reach = (np.abs(middles - K[:2, 2]) / (K[0, 0], K[1, 1])).max()
        edge = np.array([[[min(limit, _WIDEST), 0.0]]])
        fold = float(np.asarray(distort(edge, cameras.distortion[[c]], cameras.models[c : c + 1]))[0, 0, 0])
        if np.isfinite(limit) and fold < reach:
            yield diagnostic("distortion_folds", cameras=[cameras.names[c]], size=fold * K[0, 0])


def _impossibly_far(cameras: Cameras) -> Iterator[Diagnostic]:
    for name, centre in zip(cameras.names, cameras.centres, strict=True):
        if not np.linalg.norm(centre) < IMPOSSIBLE_M:
            yield diagnostic("place_impossible", kind="camera", cameras=[name], size=np.linalg.norm(centre) / 1000)


def _far(cameras: Cameras) -> Iterator[Diagnostic]:
    away = np.linalg.norm(cameras.centres - np.median(cameras.centres, axis=0), axis=1)
    far = {cameras.names[c]: away[c] for c in np.flatnonzero(away > FARTHEST_M)}
    if far:
        places = [f"{name} ({size:.4g} m)" for name, size in far.items()]
        yield diagnostic("camera_places_odd", kind="far", cameras=list(far), most=FARTHEST_M, places=places)


def _coincident(cameras: Cameras) -> Iterator[Diagnostic]:
    apart = np.linalg.norm(cameras.centres[:, None] - cameras.centres[None], axis=-1)
    for a, b in np.argwhere(np.triu(apart < COINCIDENT_M, 1)):
        pair = [cameras.names[a], cameras.names[b]]
        yield diagnostic("camera_places_odd", kind="close", cameras=pair, size=1000 * apart[a, b])


def _impossible_rate(capture: Capture) -> Iterator[Diagnostic]:
    least, most = POSSIBLE_FRAME_RATES
    if capture.fps and not least <= capture.fps <= most:
        yield diagnostic("rate_odd", rate=capture.fps, least=least, most=most)


def _odd_rate(capture: Capture) -> Iterator[Diagnostic]:
    least, most = FRAME_RATES
    if capture.fps and not least <= capture.fps <= most:
        yield diagnostic("rate_odd", severity=Severity.WARNING, rate=capture.fps, least=least, most=most)


def _beyond(capture: Capture) -> np.ndarray:
    """Return the distance of each detection beyond the picture's edge, in picture sizes."""
    assert capture.cameras is not None and capture.keypoints is not None
    size = capture.cameras.image_size[:, None, None]
    xy = capture.keypoints.xy[capture.keypoints.confidence > 0]
    sizes = np.broadcast_to(size, capture.keypoints.xy.shape)[capture.keypoints.confidence > 0]
    return (np.maximum(-xy, xy - sizes) / sizes).max(axis=-1)


def _has_views(capture: Capture) -> bool:
    found = capture.keypoints
    return capture.cameras is not None and found is not None and bool((found.confidence > 0).any())


def _impossible_places(capture: Capture) -> Iterator[Diagnostic]:
    if _has_views(capture) and (share := float((_beyond(capture) > _FAR_OUTSIDE).mean())) > 0.5:
        yield diagnostic("detections_outside", percent=100 * share, most=_FAR_OUTSIDE)


def _odd_places(capture: Capture) -> Iterator[Diagnostic]:
    if _has_views(capture) and (share := float((_beyond(capture) > _OUTSIDE).mean())) > _MANY:
        yield diagnostic("detections_outside", severity=Severity.WARNING, percent=100 * share)


def _no_markers(capture: Capture) -> Iterator[Diagnostic]:
    if capture.keypoints is None and capture.markers is not None and not capture.markers.positions.size:
        yield diagnostic("capture_empty")


def _impossibly_far_markers(capture: Capture) -> Iterator[Diagnostic]:
    cloud = capture.markers
    if cloud is None or not cloud.positions.size:
        return
    largest = np.nanmax(np.abs(cloud.positions), axis=(0, 2), initial=0.0)
    column = int(largest.argmax())
    if largest[column] > IMPOSSIBLE_M:
        name = str(column) if cloud.labels is None else cloud.labels[column]
        yield diagnostic("place_impossible", kind="marker", markers=[name], size=largest[column] / 1000)


RANGE_CHECKS: tuple[RangeCheck, ...] = (
    RangeCheck(_of_cameras(_last_row), CalibrationInvalid),
    RangeCheck(_of_cameras(_impossible_focal_lengths), CalibrationInvalid),
    RangeCheck(_of_cameras(_odd_focal_lengths)),
    RangeCheck(_of_cameras(_odd_centres)),
    RangeCheck(_of_cameras(_folds)),
    RangeCheck(_of_cameras(_impossibly_far), CalibrationInvalid),
    RangeCheck(_of_cameras(_far)),
    RangeCheck(_of_cameras(_coincident)),
    RangeCheck(_impossible_rate),
    RangeCheck(_odd_rate),
    RangeCheck(_impossible_places),
    RangeCheck(_odd_places),
    RangeCheck(_no_markers),
    RangeCheck(_impossibly_far_markers),
)
"""Asked in this order."""
