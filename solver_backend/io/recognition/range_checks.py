"""What a capture's numbers can be: one table of checks, applied to every capture whichever reader made it.

What is impossible is an error; what is merely odd becomes a problem that a person sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.distortion import distort, largest_radius
from solver_backend.exchange import plausible
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, read_diagnostics
from solver_backend.exchange.errors import CalibrationInvalid, CaptureInvalid, MocapError
from solver_backend.io.recognition.camera_names import listing
from solver_backend.io.recognition.confidence import on_unit_scale
from solver_backend.io.recognition.world_check import check_world
from solver_backend.types import Cameras, Capture

_ROUNDING, _WIDEST = 1e-6, 1e3
FOCAL_LENGTHS = (0.25, 20.0)
"""Of the longer side of the picture; 0.25 is a picture 127° wide, 20 one of 3°."""
POSSIBLE_FOCAL_LENGTHS = (0.01, 1000.0)
FARTHEST_M, IMPOSSIBLE_M, COINCIDENT_M = 100.0, plausible.FARTHEST_M, 0.01
FRAME_RATES, POSSIBLE_FRAME_RATES = (1.0, 1000.0), plausible.FRAME_RATES
_OUTSIDE, _FAR_OUTSIDE, _MANY = 1.0, 50.0, 0.2
"""Picture sizes beyond the edge, and the share of the detections that makes it worth a sentence."""

Find = Callable[[Capture], Iterator[str]]


@dataclass(frozen=True)
class RangeCheck:
    """One thing that is looked at."""

    severity: Severity
    """An error refuses the capture; a warning is a problem that a person sees."""
    find: Find
    """Yields one sentence for each finding."""
    error: type[MocapError] = CaptureInvalid
    """What is raised where it cannot be."""


def checked(capture: Capture) -> Capture:
    """Return the capture with confidences in 0..1 and a problem for everything odd that it does not name yet.

    Raises:
        CalibrationInvalid, CaptureInvalid: something cannot be.
    """
    capture = _with_unit_confidence(capture)
    odd: list[str] = []
    for check in RANGE_CHECKS:
        for sentence in check.find(capture):
            if check.severity is Severity.ERROR:
                hint = "Check the file's units and the order of its values."
                raise check.error(sentence, where=capture.name, hint=hint)
            odd.append(sentence)
    return _with_world(_with_problems(capture, odd))


def _with_problems(capture: Capture, odd: Iterable[str | Diagnostic]) -> Capture:
    new = (item for item in read_diagnostics(tuple(odd)) if item not in capture.problems)
    return replace(capture, problems=(*capture.problems, *new))


def _with_world(capture: Capture) -> Capture:
    """Return the capture with what the person says of its world, where no reader has looked at it."""
    is_known = any(item.code == "person_triangulated" for item in capture.notes)
    if is_known or not _has_views(capture) or capture.is_one_view:
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


def _of_cameras(find: Callable[[Cameras], Iterable[str]]) -> Find:
    """Return a check of a capture that looks at its cameras, if it has any."""

    def found(capture: Capture) -> Iterator[str]:
        if capture.cameras is not None and len(capture.cameras):
            yield from find(capture.cameras)

    return found


def _last_row(cameras: Cameras) -> Iterator[str]:
    for name, K in zip(cameras.names, cameras.K, strict=True):
        if np.abs(K[2] - (0, 0, 1)).max() > _ROUNDING or abs(K[1, 0]) > _ROUNDING * K[1, 1]:
            yield (
                f"The intrinsic matrix of {name} has the rows {_row(K[1])} and {_row(K[2])}; "
                "(0, fy, cy) and (0, 0, 1) are expected."
            )


def _row(values: np.ndarray) -> str:
    return f"({', '.join(f'{v:g}' for v in values)})"


def _focal_shares(cameras: Cameras) -> np.ndarray:
    """Return (C, 2) focal lengths over the longer side of the picture."""
    return np.stack([cameras.K[:, 0, 0], cameras.K[:, 1, 1]], axis=1) / cameras.image_size.max(axis=1, keepdims=True)


def _impossible_focal_lengths(cameras: Cameras) -> Iterator[str]:
    yield from _focal_lengths(cameras, POSSIBLE_FOCAL_LENGTHS)


def _odd_focal_lengths(cameras: Cameras) -> Iterator[str]:
    yield from _focal_lengths(cameras, FOCAL_LENGTHS)


def _focal_lengths(cameras: Cameras, valid: tuple[float, float]) -> Iterator[str]:
    outside = ((_focal_shares(cameras) < valid[0]) | (_focal_shares(cameras) > valid[1])).any(axis=1)
    for c in np.flatnonzero(outside):
        K, (width, height) = cameras.K[c], cameras.image_size[c]
        yield (
            f"The focal lengths of {cameras.names[c]} are {K[0, 0]:.4g} and {K[1, 1]:.4g} pixels for a picture of "
            f"{width} x {height}: is the intrinsic matrix in pixels, and for this size?"
        )


def _odd_centres(cameras: Cameras) -> Iterator[str]:
    for name, K, size in zip(cameras.names, cameras.K, cameras.image_size, strict=True):
        if not ((K[:2, 2] > -0.5) & (K[:2, 2] < size)).all():
            yield (
                f"The principal point of {name}, ({K[0, 2]:.5g}, {K[1, 2]:.5g}), lies outside its picture of "
                f"{size[0]} x {size[1]}."
            )


def _folds(cameras: Cameras) -> Iterator[str]:
    """A distortion whose radius shrinks again further out maps two directions to one pixel."""
    limits = np.asarray(largest_radius(cameras.distortion, cameras.distortion_model)).reshape(-1)
    for c, limit in enumerate(limits):
        K, size = cameras.K[c], cameras.image_size[c]
        middles = np.array([(0, K[1, 2]), (size[0] - 1, K[1, 2]), (K[0, 2], 0), (K[0, 2], size[1] - 1)])
        reach = (np.abs(middles - K[:2, 2]) / (K[0, 0], K[1, 1])).max()
        edge = np.array([[[min(limit, _WIDEST), 0.0]]])
        fold = float(np.asarray(distort(edge, cameras.distortion[[c]], cameras.distortion_model))[0, 0, 0])
        if np.isfinite(limit) and fold < reach:
            yield (
                f"The distortion of {cameras.names[c]} folds inside its picture, {fold * K[0, 0]:.0f} pixels from its "
                "centre: are the coefficients right, and in the right order?"
            )


def _impossibly_far(cameras: Cameras) -> Iterator[str]:
    for name, centre in zip(cameras.names, cameras.centres, strict=True):
        if not np.linalg.norm(centre) < IMPOSSIBLE_M:
            yield f"The camera {name} would stand {np.linalg.norm(centre) / 1000:.3g} km from the origin."


def _far(cameras: Cameras) -> Iterator[str]:
    away = np.linalg.norm(cameras.centres - np.median(cameras.centres, axis=0), axis=1)
    far = [f"{cameras.names[c]} ({away[c]:.4g} m)" for c in np.flatnonzero(away > FARTHEST_M)]
    if far:
        yield f"Cameras stand more than {FARTHEST_M:g} m from the others: {listing(far)}. Is the unit right?"


def _coincident(cameras: Cameras) -> Iterator[str]:
    apart = np.linalg.norm(cameras.centres[:, None] - cameras.centres[None], axis=-1)
    for a, b in np.argwhere(np.triu(apart < COINCIDENT_M, 1)):
        yield (
            f"The cameras {cameras.names[a]} and {cameras.names[b]} stand {1000 * apart[a, b]:.1f} mm apart: "
            "is one the copy of the other?"
        )


def _impossible_rate(capture: Capture) -> Iterator[str]:
    if capture.fps and not POSSIBLE_FRAME_RATES[0] <= capture.fps <= POSSIBLE_FRAME_RATES[1]:
        yield f"The frame rate must be {POSSIBLE_FRAME_RATES[0]:g} to {POSSIBLE_FRAME_RATES[1]:g}, not {capture.fps:g}."


def _odd_rate(capture: Capture) -> Iterator[str]:
    if capture.fps and not FRAME_RATES[0] <= capture.fps <= FRAME_RATES[1]:
        yield f"{capture.fps:g} frames a second is not what cameras record; give the rate if it is another."


def _beyond(capture: Capture) -> np.ndarray:
    """Return how many picture sizes each detection lies beyond the picture's edge."""
    assert capture.cameras is not None and capture.keypoints is not None
    size = capture.cameras.image_size[:, None, None]
    xy = capture.keypoints.xy[capture.keypoints.confidence > 0]
    sizes = np.broadcast_to(size, capture.keypoints.xy.shape)[capture.keypoints.confidence > 0]
    return (np.maximum(-xy, xy - sizes) / sizes).max(axis=-1)


def _has_views(capture: Capture) -> bool:
    found = capture.keypoints
    return capture.cameras is not None and found is not None and bool((found.confidence > 0).any())


def _impossible_places(capture: Capture) -> Iterator[str]:
    if _has_views(capture) and (share := float((_beyond(capture) > _FAR_OUTSIDE).mean())) > 0.5:
        yield f"{100 * share:.0f} % of the detections lie more than {_FAR_OUTSIDE:g} picture sizes outside."


def _odd_places(capture: Capture) -> Iterator[str]:
    if _has_views(capture) and (share := float((_beyond(capture) > _OUTSIDE).mean())) > _MANY:
        yield (
            f"{100 * share:.0f} % of the detections lie far outside their pictures: are they in pixels of the "
            "calibration's pictures?"
        )


def _no_markers(capture: Capture) -> Iterator[str]:
    if capture.keypoints is None and capture.markers is not None and not capture.markers.positions.size:
        yield "The capture holds no keypoints, and no frame of its markers."


def _impossibly_far_markers(capture: Capture) -> Iterator[str]:
    cloud = capture.markers
    if cloud is None or not cloud.positions.size:
        return
    largest = np.nanmax(np.abs(cloud.positions), axis=(0, 2), initial=0.0)
    column = int(largest.argmax())
    if largest[column] > IMPOSSIBLE_M:
        name = str(column) if cloud.labels is None else cloud.labels[column]
        yield f"The marker {name} would be {largest[column] / 1000:.3g} km from the origin."


RANGE_CHECKS: tuple[RangeCheck, ...] = (
    RangeCheck(Severity.ERROR, _of_cameras(_last_row), CalibrationInvalid),
    RangeCheck(Severity.ERROR, _of_cameras(_impossible_focal_lengths), CalibrationInvalid),
    RangeCheck(Severity.WARNING, _of_cameras(_odd_focal_lengths)),
    RangeCheck(Severity.WARNING, _of_cameras(_odd_centres)),
    RangeCheck(Severity.WARNING, _of_cameras(_folds)),
    RangeCheck(Severity.ERROR, _of_cameras(_impossibly_far), CalibrationInvalid),
    RangeCheck(Severity.WARNING, _of_cameras(_far)),
    RangeCheck(Severity.WARNING, _of_cameras(_coincident)),
    RangeCheck(Severity.ERROR, _impossible_rate),
    RangeCheck(Severity.WARNING, _odd_rate),
    RangeCheck(Severity.ERROR, _impossible_places),
    RangeCheck(Severity.WARNING, _odd_places),
    RangeCheck(Severity.ERROR, _no_markers),
    RangeCheck(Severity.ERROR, _impossibly_far_markers),
)
"""Asked in this order."""
