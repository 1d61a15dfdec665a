"""Check the numbers of a capture. Impossible values are errors, and implausible values are warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from solver_backend.agreement.evidence import UNRELATED_OUTLIERS
from solver_backend.cameras.projection import distort, largest_radius
from solver_backend.exchange import plausible
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, notes_in, warnings_in, word
from solver_backend.exchange.errors import CalibrationInvalid, CaptureInvalid
from solver_backend.io.recognition.confidence import on_unit_scale
from solver_backend.io.recognition.world_fit import check_world
from solver_backend.types import Cameras, Capture

_ROUNDING = np.finfo(np.float32).resolution
FOCAL_LENGTHS = (0.25, 20.0)  # Range of usual focal lengths in longer image sides: fields of view of 127° and 3°.
IMPOSSIBLE = 50.0  # Factor of usual focal lengths or image sizes that no lens and no detector reaches.
APART_M = (0.01, 100.0)  # Range of usual distances between cameras, metres.


def checked(capture: Capture) -> Capture:
    """Check all numbers of a capture, convert confidences to 0..1, and add diagnostics to its problems.

    Raises:
        CalibrationInvalid, CaptureInvalid: a number is impossible.
    """
    keypoints, odd = capture.keypoints, list[Diagnostic]()
    if keypoints is not None:
        confidence, notes, problems = on_unit_scale(keypoints.confidence)
        keypoints = replace(keypoints, confidence=confidence) if notes or problems else keypoints
        notes, problems = capture.notes + notes, capture.problems + problems
        capture = replace(capture, keypoints=keypoints, notes=notes, problems=problems)
    cameras = () if capture.cameras is None or not len(capture.cameras) else (capture.cameras,)
    of_cameras = ((found, CalibrationInvalid) for find in CAMERA_CHECKS for each in cameras for found in find(each))
    of_capture = ((found, CaptureInvalid) for find in CAPTURE_CHECKS for found in find(capture))
    for found, error in chain(of_cameras, of_capture):
        if found.severity is Severity.ERROR:
            words = word(found)
            raise error(words.what, where=capture.name, hint=words.advice)
        odd.append(found)
    views = capture.several_views
    if not capture.world_checked and views is not None and (views[1].confidence > 0).any():
        world = check_world(*views)
        of_world = (diagnostic("nothing_located"),) if np.isnan(world.residual_px) else world.found()
        odd += warnings_in(of_world)
        capture = replace(capture, notes=(*capture.notes, *notes_in(of_world)))
    new = [item for i, item in enumerate(odd) if item not in (*capture.problems, *odd[:i])]
    return replace(capture, problems=(*capture.problems, *new))


def _matrices(cameras: Cameras) -> Iterator[Diagnostic]:
    for name, K, size in zip(cameras.names, cameras.K, cameras.image_size, strict=True):
        if np.abs(K[2] - (0, 0, 1)).max() > _ROUNDING or abs(K[1, 0]) > _ROUNDING * K[1, 1]:
            second, third = (f"({', '.join(f'{v:g}' for v in row)})" for row in K[1:])
            yield diagnostic("intrinsics_impossible", cameras=[name], second=second, third=third)
        if not ((K[:2, 2] > -0.5) & (K[:2, 2] < size)).all():
            width, height = size.tolist()
            yield diagnostic("centre_outside", cameras=[name], x=K[0, 2], y=K[1, 2], width=width, height=height)


def _focal_lengths(cameras: Cameras) -> Iterator[Diagnostic]:
    shares = cameras.K[:, [0, 1], [0, 1]] / cameras.image_size.max(axis=1, keepdims=True)
    least, most = FOCAL_LENGTHS
    for severity, factor in ((Severity.ERROR, IMPOSSIBLE), (Severity.WARNING, 1.0)):
        for c in np.flatnonzero(((shares < least / factor) | (shares > factor * most)).any(axis=1)):
            K, (width, height) = cameras.K[c], cameras.image_size[c].tolist()
            figures: dict[str, Any] = {"fx": K[0, 0], "fy": K[1, 1], "width": width, "height": height}
            yield diagnostic("focal_length_odd", severity=severity, cameras=[cameras.names[c]], **figures)


def _folds(cameras: Cameras) -> Iterator[Diagnostic]:
    """Yield a problem for each lens with a distorted radius that decreases within the image."""
    limits = np.asarray(largest_radius(cameras.distortion, cameras.models)).reshape(-1)
    for c in np.flatnonzero(np.isfinite(limits)):
        K, size = cameras.K[c], cameras.image_size[c]
        middles = np.array([(0, K[1, 2]), (size[0] - 1, K[1, 2]), (K[0, 2], 0), (K[0, 2], size[1] - 1)])
        reach = (np.abs(middles - K[:2, 2]) / (K[0, 0], K[1, 1])).max()
        edge = np.array([[[limits[c], 0.0]]])
        fold = float(np.asarray(distort(edge, cameras.distortion[[c]], cameras.models[c : c + 1]))[0, 0, 0])
        if fold < reach:
            yield diagnostic("distortion_folds", cameras=[cameras.names[c]], size=fold * K[0, 0])


def _places(cameras: Cameras) -> Iterator[Diagnostic]:
    names, centres = cameras.names, cameras.centres
    for name, centre in zip(names, centres, strict=True):
        if not np.linalg.norm(centre) < plausible.FARTHEST_M:
            yield diagnostic("place_impossible", kind="camera", cameras=[name], size=np.linalg.norm(centre) / 1000)
    away = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    far = {names[c]: away[c] for c in np.flatnonzero(away > APART_M[1])}
    if far:
        places = [f"{name} ({size:.4g} m)" for name, size in far.items()]
        yield diagnostic("camera_places_odd", kind="far", cameras=list(far), most=APART_M[1], places=places)
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    for a, b in np.argwhere(np.triu(apart < APART_M[0], 1)):
        yield diagnostic("camera_places_odd", kind="close", cameras=[names[a], names[b]], size=1000 * apart[a, b])


def _rate(capture: Capture) -> Iterator[Diagnostic]:
    limits = {Severity.ERROR: plausible.FRAME_RATES, Severity.WARNING: plausible.USUAL_FRAME_RATES}
    for severity, (least, most) in limits.items():
        if capture.fps and not least <= capture.fps <= most:
            yield diagnostic("rate_odd", severity=severity, rate=capture.fps, least=least, most=most)


def _beyond_pictures(capture: Capture) -> Iterator[Diagnostic]:
    if capture.cameras is None or capture.keypoints is None or not (capture.keypoints.confidence > 0).any():
        return
    seen, xy = capture.keypoints.confidence > 0, capture.keypoints.xy
    sizes = np.broadcast_to(capture.cameras.image_size[:, None, None], xy.shape)[seen]
    beyond = (np.maximum(-xy[seen], xy[seen] - sizes) / sizes).max(axis=-1)
    for severity, factor, most in ((Severity.ERROR, IMPOSSIBLE, 0.5), (Severity.WARNING, 1.0, UNRELATED_OUTLIERS)):
        if (share := float((beyond > factor).mean())) > most:
            yield diagnostic("detections_outside", severity=severity, percent=100 * share)


def _markers(capture: Capture) -> Iterator[Diagnostic]:
    cloud = capture.markers
    if cloud is not None and cloud.positions.size:
        largest = np.nanmax(np.abs(cloud.positions), axis=(0, 2), initial=0.0)
        column = int(largest.argmax())
        if largest[column] > plausible.FARTHEST_M:
            name = str(column) if cloud.labels is None else cloud.labels[column]
            yield diagnostic("place_impossible", kind="marker", markers=[name], size=largest[column] / 1000)
    elif cloud is not None and capture.keypoints is None:
        yield diagnostic("capture_empty")


CAMERA_CHECKS = (_matrices, _focal_lengths, _folds, _places)
CAPTURE_CHECKS = (_rate, _beyond_pictures, _markers)
"""Checks in this order. An error rejects the capture, and a warning becomes one of its problems."""
