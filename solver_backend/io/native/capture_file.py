"""Our capture file in the solver's types: one ``.npz`` with cameras, detections, markers, notes and truth."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.capture_file import FORMAT, VERSION, footage_path, portable_path
from solver_backend.exchange.diagnostics import Diagnostic, notes_in, read_diagnostics, warnings_in
from solver_backend.exchange.errors import CaptureInvalid, FileDamaged, MocapError, NonFiniteData
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.exchange.npz import write_npz
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, FARTHEST_M, require_within
from solver_backend.exchange.schema import Fields, read_fields
from solver_backend.geometry.small_matrices import packed, unpacked
from solver_backend.types import (
    BONES,
    Cameras,
    Capture,
    Keypoints2D,
    MarkerCloud,
    OwnPoint,
    PersonInViews,
    stacked_hands,
)

_TRUTH = "truth_"
_EVERYBODYS = ("xy", "confidence", "own")
"""Fields of keypoints that are stored for every person."""
ROUNDING = 1e-5  # Negative part of a covariance in single precision at most, relative to its largest variance.
_OF_ONE_CAMERA = ("stature_m", "floor_from_person", "focal_sigma")
_OF_DETECTOR = ("detector", "noise_map")
_FIELDS = """
    format version name diagnostics sources footage footage_first
    camera_names K distortion distortion_model R t image_size
    fps xy confidence joint_set hands own own_names own_bones
    people person people_xy people_confidence people_hands people_own
    marker_positions marker_fps marker_labels marker_residual marker_covariance other_positions other_labels
"""
_STORED = (*_FIELDS.split(), *_OF_ONE_CAMERA, *_OF_DETECTOR)


def write_capture(path: Path | str, capture: Capture, *, overwrite: bool = False) -> Path:
    """Write a capture. Footage below the file's folder is stored relative to it, so that the folder can be moved.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    arrays: dict[str, np.ndarray] = {"format": np.array(FORMAT), "version": np.array(VERSION)}
    arrays |= {"name": np.array(capture.name), "sources": _strings(capture.sources)}
    if found := (*capture.notes, *capture.problems):
        arrays["diagnostics"] = _strings(tuple(json.dumps(item.as_dict()) for item in found))
    if capture.cameras is not None:
        cameras = capture.cameras
        arrays |= {"camera_names": _strings(cameras.names), "K": cameras.K, "distortion": cameras.distortion}
        arrays["distortion_model"] = _models(cameras)
        arrays |= {key: getattr(cameras, key) for key in ("R", "t", "image_size")}
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
    of_one = {name: getattr(capture, name) for name in _OF_ONE_CAMERA}
    arrays |= {name: np.array(float(value)) for name, value in of_one.items() if value}
    arrays |= {name: np.array(value) for name in _OF_DETECTOR if (value := getattr(capture, name))}
    if capture.markers is not None:
        arrays |= _marker_arrays(capture.markers)
    if capture.others is not None:
        arrays["other_positions"] = np.asarray(capture.others.positions, np.float32)
        arrays["other_labels"] = _strings(capture.others.labels or ())
    arrays |= {_TRUTH + key: np.asarray(value) for key, value in capture.truth.items()}
    return write_npz(path, arrays, overwrite=overwrite)


def _keypoint_arrays(keypoints: Keypoints2D) -> dict[str, np.ndarray]:
    """Return the fields of one person's keypoints, with own points (C, F, N, 3) as x, y and confidence."""
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


def read_capture(path: Path | str) -> Capture:
    """Read a capture file.

    Raises:
        FileMissing, FileDamaged: it is not there, truncated, of another format or lacks fields.
        MocapError: its values are impossible, or it has no frames or views.
    """
    fields = read_fields(path, _STORED, prefix=_TRUTH)
    fields.require_format(FORMAT, VERSION)
    try:
        return _capture(fields, Path(path))
    except MocapError as error:
        if str(path) in error.where:
            raise
        where = f"{path}, {error.where}" if error.where else str(path)
        raise type(error)(error.message, where=where, hint=error.hint) from error


def _diagnostics(fields: Fields) -> tuple[Diagnostic, ...]:
    values: list[object] = []
    for text in fields.texts("diagnostics"):
        with suppress(ValueError, RecursionError):
            values.append(json.loads(text))
    return read_diagnostics(values)


def _truth(fields: Fields, path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of the truth, NaN where unknown."""
    found = {key[len(_TRUTH) :]: value for key, value in fields.arrays.items() if key.startswith(_TRUTH)}
    for name, value in found.items():
        if value.dtype.kind == "f" and (np.abs(value) > FARTHEST_M).any():
            raise CaptureInvalid(f"The truth's {name} hold a number that cannot be.", where=str(path))
    return found


def _capture(fields: Fields, path: Path) -> Capture:
    found = _diagnostics(fields)
    cameras = _cameras(fields) if "K" in fields else None
    keypoints = _keypoints(fields) if "xy" in fields else None
    if keypoints is not None and not (keypoints.num_views and keypoints.num_frames):
        what = "frames" if keypoints.num_views else "views"
        raise CaptureInvalid(f"The capture has no {what}.", where=str(path))
    people = _people(fields, keypoints) if keypoints is not None and "people" in fields else ()
    if keypoints is not None and "own" in fields:
        points = _own_points(fields)
        shape = (*keypoints.xy.shape[:2], len(points), 3)
        keypoints = _with_own(keypoints, points, fields.numbers("own", shape))
        of_people = fields.numbers("people_own", (len(people), *shape)) if people else ()
        people = tuple(
            replace(person, keypoints=_with_own(person.keypoints, points, values))
            for person, values in zip(people, of_people, strict=True)
        )
    return Capture(
        name=fields.text("name", path.stem),
        cameras=cameras,
        keypoints=keypoints,
        markers=_markers(fields) if "marker_positions" in fields else None,
        others=_others(fields) if "other_positions" in fields else None,
        footage=tuple(footage_path(item, path) for item in fields.texts("footage")),
        footage_first=_footage_first(fields),
        sources=fields.texts("sources"),
        notes=notes_in(found),
        problems=warnings_in(found),
        people=people,
        person=fields.text("person", "") if people else "",
        stature_m=_number(fields, "stature_m"),
        floor_from_person=bool(_number(fields, "floor_from_person")),
        focal_sigma=_number(fields, "focal_sigma"),
        detector=fields.text("detector", ""),
        noise_map=fields.text("noise_map", ""),
        truth=_truth(fields, path),
    )


def _own_points(fields: Fields) -> tuple[OwnPoint, ...]:
    names, bones = fields.texts("own_names"), fields.texts("own_bones")
    if len(names) != len(bones) or not set(bones) <= set(BONES):
        raise FileDamaged(f"Own points {', '.join(names)} are on {', '.join(bones)}.", where=str(fields.path))
    return tuple(map(OwnPoint, names, bones))


def _with_own(keypoints: Keypoints2D, points: tuple[OwnPoint, ...], values: np.ndarray) -> Keypoints2D:
    """Return keypoints followed by N own points, from (C, F, N, 3) x, y in pixels and confidence."""
    xy = np.concatenate([keypoints.xy, values[..., :2]], axis=2)
    confidence = np.concatenate([keypoints.confidence, values[..., 2]], axis=2)
    return replace(keypoints, xy=xy, confidence=confidence, own=points)


def _number(fields: Fields, name: str) -> float:
    return float(fields.numbers(name, ())) if name in fields else 0.0


def _footage_first(fields: Fields) -> tuple[int, ...]:
    if "footage_first" not in fields:
        return ()
    first = fields.numbers("footage_first", (len(fields.texts("footage")),))
    require_within("footage_first", first, FARTHEST_IN_UNITS, CaptureInvalid, str(fields.path))
    return tuple(int(n) for n in first)


def _strings(items: tuple[str, ...]) -> np.ndarray:
    return np.array(items, dtype=np.str_) if items else np.zeros(0, dtype="U1")


def _marker_arrays(markers: MarkerCloud) -> dict[str, np.ndarray]:
    arrays = {"marker_positions": np.asarray(markers.positions, np.float32), "marker_fps": np.array(float(markers.fps))}
    if markers.labels is not None:
        arrays["marker_labels"] = _strings(tuple(markers.labels))
    if markers.residual is not None:
        arrays["marker_residual"] = np.asarray(markers.residual, np.float32)
    if markers.covariance is not None:
        arrays["marker_covariance"] = packed(markers.covariance).astype(np.float32)
    return arrays


def _cameras(fields: Fields) -> Cameras:
    names = fields.texts("camera_names")
    count = len(names)
    shapes = {"K": (3, 3), "distortion": (None,), "R": (3, 3), "t": (3,), "image_size": (2,)}
    arrays = {name: fields.numbers(name, (count, *shape)) for name, shape in shapes.items()}
    return Cameras(names=names, models=fields.texts("distortion_model") or (DEFAULT_MODEL,), **arrays)


def _models(cameras: Cameras) -> np.ndarray:
    names = dict.fromkeys(cameras.models)
    return np.array(next(iter(names))) if len(names) == 1 else np.array(cameras.models, np.str_)


def _keypoints(fields: Fields) -> Keypoints2D:
    xy = fields.numbers("xy", (None, None, None, 2))
    return Keypoints2D(
        xy=xy,
        confidence=fields.numbers("confidence", xy.shape[:3]),
        joint_set=fields.joint_set(),
        fps=fields.number("fps"),
        hands=fields.numbers("hands", (*xy.shape[:2], 2, NUM_HAND_POINTS, 3)) if "hands" in fields else None,
    )


def _people(fields: Fields, chosen: Keypoints2D) -> tuple[PersonInViews, ...]:
    names = fields.texts("people")
    xy = fields.numbers("people_xy", (len(names), *chosen.xy.shape))
    confidence = fields.numbers("people_confidence", xy.shape[:-1])
    shape = (len(names), *chosen.xy.shape[:2], 2, NUM_HAND_POINTS, 3)
    hands = fields.numbers("people_hands", shape) if "people_hands" in fields else [None] * len(names)
    return tuple(
        PersonInViews(name, replace(chosen, xy=xy[n], confidence=confidence[n], hands=hands[n]))
        for n, name in enumerate(names)
    )


def _markers(fields: Fields) -> MarkerCloud:
    positions = fields.numbers("marker_positions", (None, None, 3))
    return MarkerCloud(
        positions=positions,
        fps=fields.number("marker_fps"),
        labels=fields.texts("marker_labels") if "marker_labels" in fields else None,
        residual=fields.numbers("marker_residual", positions.shape[:2]) if "marker_residual" in fields else None,
        covariance=_covariance(fields, positions) if "marker_covariance" in fields else None,
    )


def _others(fields: Fields) -> MarkerCloud:
    positions = fields.numbers("other_positions", (None, None, 3))
    return MarkerCloud(positions, fields.number("marker_fps"), fields.texts("other_labels"))


def _covariance(fields: Fields, positions: np.ndarray) -> np.ndarray:
    """Return the (F, M, 3, 3) covariances of markers."""
    covariance = unpacked(fields.numbers("marker_covariance", (*positions.shape[:2], 6)))
    given = np.isfinite(positions).all(-1) & ~np.isnan(covariance).all((-2, -1))
    finite = np.isfinite(covariance).all((-2, -1))
    least, most = np.linalg.eigvalsh(np.where(finite[..., None, None], covariance, 0.0))[..., [0, 2]].transpose(2, 0, 1)
    wrong = np.argwhere(given & ~(finite & (least >= -ROUNDING * most)))
    if len(wrong):
        frame, marker = wrong[0]
        hint = "Six numbers in m² are expected, xx, xy, xz, yy, yz, zz; NaN where it is not known."
        what = "A marker's covariance is not valid: it is not finite, or negative in some direction."
        raise NonFiniteData(what, where=f"{fields.path}, frame {frame}, marker {marker}", hint=hint)
    return covariance
