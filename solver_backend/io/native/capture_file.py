"""Read and write our capture file, a single ``.npz`` with the whole capture."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.capture_file import FORMAT, VERSION, footage_path, portable_path
from solver_backend.exchange.diagnostics import notes_in, read_diagnostics, warnings_in
from solver_backend.exchange.errors import CaptureInvalid, FileDamaged, MocapError, NonFiniteData
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.exchange.npz import write_npz
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, FARTHEST_M, require_within
from solver_backend.exchange.schema import Fields, read_fields
from solver_backend.geometry.small_matrices import packed, unpacked
from solver_backend.types import (
    BONES,
    CameraPath,
    Cameras,
    Capture,
    Keypoints2D,
    MarkerCloud,
    OwnPoint,
    PersonInViews,
    stacked_hands,
)

_TRUTH = "truth_"
_CAMERA_SHAPES = {"K": (3, 3), "distortion": (None,), "R": (3, 3), "t": (3,), "image_size": (2,)}  # Shapes per camera.
_EVERYBODYS = ("xy", "confidence", "own")  # Keypoint fields that are stored for every person.
ROUNDING = 1e-5  # Largest negative eigenvalue of a single-precision covariance, relative to its largest variance.
_OF_PERSON_AND_LENS = ("stature_m", "floor_from_person", "focal_sigma")
_OF_DETECTOR = ("detector", "noise_map")
_FIELDS = """
    format version name diagnostics sources footage footage_first camera_names distortion_model
    path_R path_t
    fps xy confidence joint_set hands own own_names own_bones
    people person people_xy people_confidence people_hands people_own
    marker_positions marker_fps marker_labels marker_residual marker_covariance other_positions other_labels
"""
_STORED = (*_FIELDS.split(), *_CAMERA_SHAPES, *_OF_PERSON_AND_LENS, *_OF_DETECTOR)


def write_capture(path: Path | str, capture: Capture, *, overwrite: bool = False) -> Path:
    """Write a capture file. Footage in the same folder is stored by its relative path."""
    arrays: dict[str, np.ndarray] = {"format": np.array(FORMAT), "version": np.array(VERSION)}
    arrays |= {"name": np.array(capture.name), "sources": _strings(capture.sources)}
    if found := (*capture.notes, *capture.problems):
        arrays["diagnostics"] = _strings(tuple(json.dumps(item.as_dict()) for item in found))
    if (cameras := capture.cameras) is not None:
        models = tuple(dict.fromkeys(cameras.models))
        arrays |= {"camera_names": _strings(cameras.names), "K": cameras.K, "distortion": cameras.distortion}
        arrays["distortion_model"] = np.array(models[0]) if len(models) == 1 else np.array(cameras.models, np.str_)
        arrays |= {key: getattr(cameras, key) for key in ("R", "t", "image_size")}
        if cameras.path is not None:
            arrays |= {"path_R": cameras.path.R, "path_t": cameras.path.t}
    if capture.footage:
        arrays["footage"] = _strings(tuple(portable_path(item, Path(path).parent) for item in capture.footage))
    if capture.footage_first:
        arrays["footage_first"] = np.array(capture.footage_first)
    if capture.keypoints is not None:
        arrays |= _keypoint_arrays(capture.keypoints)
    if capture.people:
        seen = [_keypoint_arrays(person.keypoints) for person in capture.people]
        arrays |= {f"people_{key}": np.stack([one[key] for one in seen]) for key in _EVERYBODYS if key in seen[0]}
        hands = stacked_hands([person.keypoints.hands for person in capture.people], axis=0)
        if hands is not None:
            arrays["people_hands"] = hands.astype(np.float32)
        arrays["people"], arrays["person"] = _strings(tuple(p.name for p in capture.people)), np.array(capture.person)
    of_one = {name: getattr(capture, name) for name in _OF_PERSON_AND_LENS}
    arrays |= {name: np.array(float(value)) for name, value in of_one.items() if value}
    arrays |= {name: np.array(value) for name in _OF_DETECTOR if (value := getattr(capture, name))}
    if capture.markers is not None:
        arrays |= {**_cloud_arrays(capture.markers, "marker"), "marker_fps": np.array(float(capture.markers.fps))}
    if capture.others is not None:
        arrays |= _cloud_arrays(capture.others, "other")
    arrays |= {_TRUTH + key: np.asarray(value) for key, value in capture.truth.items()}
    return write_npz(path, arrays, overwrite=overwrite)


def _strings(items: tuple[str, ...]) -> np.ndarray:
    return np.array(items, dtype=np.str_) if items else np.zeros(0, dtype="U1")


def _keypoint_arrays(keypoints: Keypoints2D) -> dict[str, np.ndarray]:
    """Return the fields that store one person's keypoints, including N user-defined points (C, F, N, 3)."""
    named = keypoints.named
    arrays = {"fps": np.array(float(named.fps)), "xy": named.xy.astype(np.float32)}
    arrays |= {"confidence": named.confidence.astype(np.float32), "joint_set": np.array(named.joint_set.value)}
    if named.hands is not None:
        arrays["hands"] = named.hands.astype(np.float32)
    if keypoints.own:
        values = np.concatenate([keypoints.xy, keypoints.confidence[..., None]], axis=-1)
        arrays["own"] = values[:, :, named.joint_set.num_keypoints :].astype(np.float32)
        arrays["own_names"] = np.array([point.name for point in keypoints.own])
        arrays["own_bones"] = np.array([point.bone for point in keypoints.own])
    return arrays


def _cloud_arrays(cloud: MarkerCloud, prefix: str) -> dict[str, np.ndarray]:
    numbers = {"positions": cloud.positions}
    if prefix == "marker":
        covariance = None if cloud.covariance is None else packed(cloud.covariance)
        numbers |= {"residual": cloud.residual, "covariance": covariance}
    arrays = {f"{prefix}_{key}": np.asarray(v, np.float32) for key, v in numbers.items() if v is not None}
    return arrays if cloud.labels is None else {**arrays, f"{prefix}_labels": _strings(tuple(cloud.labels))}


def read_capture(path: Path | str) -> Capture:
    """Read a capture file. Raise FileMissing, FileDamaged or MocapError."""
    fields = read_fields(path, _STORED, prefix=_TRUTH)
    fields.require_format(FORMAT, VERSION)
    try:
        return _capture(fields, Path(path))
    except MocapError as error:
        if str(path) in error.where:
            raise
        where = f"{path}, {error.where}" if error.where else str(path)
        raise type(error)(error.message, where=where, hint=error.hint) from error


def _capture(fields: Fields, path: Path) -> Capture:
    texts: list[object] = []
    for text in fields.texts("diagnostics"):
        with suppress(ValueError, RecursionError):
            texts.append(json.loads(text))
    found = read_diagnostics(texts)
    keypoints, people = _keypoints(fields) if "xy" in fields else (None, ())
    of_one = {name: fields.number(name) if name in fields else 0.0 for name in _OF_PERSON_AND_LENS}
    known: dict[str, Any] = {**of_one, "floor_from_person": bool(of_one["floor_from_person"])}
    return Capture(
        name=fields.text("name", path.stem),
        cameras=_cameras(fields) if "K" in fields else None,
        keypoints=keypoints,
        markers=_cloud(fields, "marker") if "marker_positions" in fields else None,
        others=_cloud(fields, "other") if "other_positions" in fields else None,
        footage=tuple(footage_path(item, path) for item in fields.texts("footage")),
        footage_first=_footage_first(fields) if "footage_first" in fields else (),
        sources=fields.texts("sources"),
        notes=notes_in(found),
        problems=warnings_in(found),
        people=people,
        person=fields.text("person", "") if people else "",
        detector=fields.text("detector", ""),
        noise_map=fields.text("noise_map", ""),
        truth=_truth(fields),
        **known,
    )


def _cameras(fields: Fields) -> Cameras:
    names = fields.texts("camera_names")
    arrays = {name: fields.numbers(name, (len(names), *shape)) for name, shape in _CAMERA_SHAPES.items()}
    path = None
    if "path_R" in fields:
        turns = fields.numbers("path_R", (None, 3, 3))
        path = CameraPath(turns, fields.numbers("path_t", (len(turns), 3)))
    return Cameras(names=names, models=fields.texts("distortion_model") or (DEFAULT_MODEL,), path=path, **arrays)


def _keypoints(fields: Fields) -> tuple[Keypoints2D, tuple[PersonInViews, ...]]:
    """Read the keypoints of the selected person, and of all people."""
    own: tuple[OwnPoint, ...] = ()
    if "own" in fields:
        names, bones = fields.texts("own_names"), fields.texts("own_bones")
        if len(names) != len(bones) or not set(bones) <= set(BONES):
            raise FileDamaged(
                f"The bones of own points are not valid (points {', '.join(names)}, bones {', '.join(bones)}).",
                where=str(fields.path),
            )
        own = tuple(map(OwnPoint, names, bones))
    xy, confidence, hands = _seen(fields, "", (None, None, None, 2), len(own))
    chosen = Keypoints2D(xy, confidence, fields.joint_set(), fields.number("fps"), hands, own)
    if not (chosen.num_views and chosen.num_frames):
        what = "frames" if chosen.num_views else "views"
        raise CaptureInvalid(f"The capture has no {what}.", where=str(fields.path))
    if "people" not in fields:
        return chosen, ()
    names, (*shape, count, _) = fields.texts("people"), xy.shape
    seen = _seen(fields, "people_", (len(names), *shape, count - len(own), 2), len(own))
    xy, confidence, hands = seen[0], seen[1], seen[2] if seen[2] is not None else [None] * len(names)
    return chosen, tuple(
        PersonInViews(name, replace(chosen, xy=xy[n], confidence=confidence[n], hands=hands[n]))
        for n, name in enumerate(names)
    )


def _seen(
    fields: Fields, prefix: str, shape: tuple[int | None, ...], own: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Read one set of pixels, confidences and hands. The last ``own`` points are user-defined."""
    xy = fields.numbers(f"{prefix}xy", shape)
    confidence = fields.numbers(f"{prefix}confidence", xy.shape[:-1])
    views, hands = xy.shape[:-2], f"{prefix}hands"
    if own:
        values = fields.numbers(f"{prefix}own", (*views, own, 3))
        xy = np.concatenate([xy, values[..., :2]], axis=-2)
        confidence = np.concatenate([confidence, values[..., 2]], axis=-1)
    return xy, confidence, fields.numbers(hands, (*views, 2, NUM_HAND_POINTS, 3)) if hands in fields else None


def _footage_first(fields: Fields) -> tuple[int, ...]:
    first = fields.numbers("footage_first", (len(fields.texts("footage")),))
    require_within("footage_first", first, FARTHEST_IN_UNITS, CaptureInvalid, str(fields.path))
    return tuple(int(n) for n in first)


def _truth(fields: Fields) -> dict[str, np.ndarray]:
    """Return the ground truth arrays of a capture. Unknown values are NaN."""
    found = {key[len(_TRUTH) :]: value for key, value in fields.arrays.items() if key.startswith(_TRUTH)}
    for name, value in found.items():
        if value.dtype.kind == "f" and (np.abs(value) > FARTHEST_M).any():
            raise CaptureInvalid(f"The ground truth '{name}' contains an impossible number.", where=str(fields.path))
    return found


def _cloud(fields: Fields, prefix: str) -> MarkerCloud:
    positions = fields.numbers(f"{prefix}_positions", (None, None, 3))
    labels, residual = f"{prefix}_labels", f"{prefix}_residual"
    return MarkerCloud(
        positions=positions,
        fps=fields.number("marker_fps"),
        labels=fields.texts(labels) if labels in fields or prefix == "other" else None,
        residual=fields.numbers(residual, positions.shape[:2]) if residual in fields else None,
        covariance=_covariance(fields, positions) if f"{prefix}_covariance" in fields else None,
    )


def _covariance(fields: Fields, positions: np.ndarray) -> np.ndarray:
    """Read the marker covariances (F, M, 3, 3), and check that they are finite and have no negative eigenvalues."""
    covariance = unpacked(fields.numbers("marker_covariance", (*positions.shape[:2], 6)))
    given = np.isfinite(positions).all(-1) & ~np.isnan(covariance).all((-2, -1))
    finite = np.isfinite(covariance).all((-2, -1))
    least, most = np.linalg.eigvalsh(np.where(finite[..., None, None], covariance, 0.0))[..., [0, 2]].transpose(2, 0, 1)
    wrong = np.argwhere(given & ~(finite & (least >= -ROUNDING * most)))
    if len(wrong):
        frame, marker = wrong[0]
        hint = "Write six numbers in m² (xx, xy, xz, yy, yz, zz), or NaN if the covariance is unknown."
        what = "The covariance of a marker is infinite, or negative in some direction."
        raise NonFiniteData(what, where=f"{fields.path}, frame {frame}, marker {marker}", hint=hint)
    return covariance
