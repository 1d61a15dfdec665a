"""Read and write our motion and subject files. Array shapes are validated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange import motion_file
from solver_backend.exchange.body_layout import AMASS_POSE_WIDTH, SMPL
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.json_file import as_plain
from solver_backend.exchange.motion_file import FORMAT, STORED, VERSION, MotionFile, layout_of, motion_of
from solver_backend.exchange.npz import write_npz
from solver_backend.exchange.schema import Fields, read_fields
from solver_backend.types import NUM_BETAS, MarkerSubject, Motion

_TYPES: dict[str, tuple[type, ...]] = dict.fromkeys(("edits", "resolved", "exchanged", "sigma_px"), (list,))
_TYPES |= {"settings": (dict,), "person": (str,), "solver": (str,), "solve_s": (int, float)}
_ITEMS: dict[str, tuple[type, ...]] = {"edits": (dict,), "resolved": (dict,), "exchanged": (list,)}
_ITEMS["sigma_px"] = (int, float)
"""Types of provenance entries that the product uses, and of their list items. Other entries are only displayed."""


def read_provenance(fields: Fields) -> dict[str, Any]:
    """Read the provenance in a file. Raise FileDamaged if an entry has an unexpected type."""
    where = str(fields.path)
    try:
        value = json.loads(fields.text("provenance", "{}"))
    except (ValueError, RecursionError) as error:
        raise FileDamaged(f"The provenance is not JSON ({error}).", where=where) from error
    if not isinstance(value, dict):
        raise FileDamaged("The provenance is not a JSON object.", where=where)
    for key, types in _TYPES.items():
        entry = value.get(key)
        items = entry if isinstance(entry, list) and key in _ITEMS else []
        if not (entry is None or isinstance(entry, types)) or not all(isinstance(item, _ITEMS[key]) for item in items):
            hint = "Solve the take again, or copy the file again."
            raise FileDamaged(f"The provenance's '{key}' has an unexpected type.", where=where, hint=hint)
    return value


_SHARED = """
    betas transl fps body body_layout joints keypoints3d joint_sigma joint_covariance turn_covariance keyframes
    contacts flags resting root reprojection_px markers marker_residual_mm marker_flags marker_sigma cleaned_markers
    offsets props
"""
_SAME = tuple(_SHARED.split())  # Fields with the same name in a motion and its file.


def write_motion(path: Path | str, motion: Motion, overwrite: bool = False, name: str | None = None) -> Path:
    """Write a motion to a file. The motion's name defaults to the file name. See ``atomic_output`` for errors."""
    name = Path(path).stem if name is None else name
    return motion_file.write_motion(path, as_file(motion, name), overwrite=overwrite)


def as_file(motion: Motion, name: str) -> MotionFile:
    """Convert a motion to the fields of its file."""
    rotvec = np.concatenate([motion.global_orient, motion.body_pose], axis=1)
    return MotionFile(
        name=name,
        rotvec=rotvec.reshape(motion.num_frames, -1, 3),
        joint_set="" if motion.joint_set is None else motion.joint_set.value,
        marker_labels=motion.marker_labels or (),
        layout=motion.layout or (),
        provenance=json.dumps(as_plain(motion.provenance), sort_keys=True),
        **{name: getattr(motion, name) for name in _SAME},
    )


def read_motion(path: Path | str) -> Motion:
    """Read a motion file. Raise FileMissing, FileDamaged, or MotionInvalid for invalid values."""
    fields = read_fields(path, STORED)
    if "format" not in fields and "poses" in fields:
        what = "The file is AMASS, not a motion file of this program: it has no joint positions."
        raise FileDamaged(what, where=str(path), hint="Convert it first.")
    fields.require_format(FORMAT, VERSION)
    _require_arrays(fields)
    record = motion_of(fields)
    return Motion(
        global_orient=record.rotvec[:, 0].copy(),
        body_pose=record.rotvec[:, 1:].reshape(record.num_frames, -1),
        joint_set=fields.joint_set() if "joint_set" in fields else None,
        marker_labels=record.marker_labels or None,
        layout=record.layout or None,
        provenance=read_provenance(fields),
        **{name: getattr(record, name) for name in _SAME},
    )


def _require_arrays(fields: Fields) -> None:
    """Raise an error if an array that the solver always writes is missing or has the wrong shape."""
    layout = layout_of(fields)
    width = AMASS_POSE_WIDTH if layout == SMPL else 3 * layout.num_joints
    frames = len(fields.numbers("poses", (None, width)))
    shapes = {"betas": (NUM_BETAS,), "trans": (frames, 3), "mocap_framerate": (), "hand_pose": (frames, 6)}
    shapes |= motion_file.optional_shapes(frames, layout.num_joints)
    for key, shape in shapes.items():
        if key in fields or key in ("betas", "trans", "mocap_framerate", "joints"):
            fields.numbers(key, shape)
    fields.text("body")


SUBJECT_FORMAT, SUBJECT_VERSION = "manifold_mocap_subject", 1
_TEXTS = {"labels": "marker_labels", "places": "marker_places"}
_NUMBERS = {"betas": "betas", "offsets": "offsets", "sigma_m": "marker_sigma", "skin_m": "skin_distance"}
"""Names of text and numeric fields in a subject file."""


def write_subject(path: Path | str, subject: MarkerSubject, *, overwrite: bool = False) -> Path:
    """Write a subject's shape and marker layout to a file. See ``atomic_output`` for errors."""
    texts = {"format": SUBJECT_FORMAT, "version": SUBJECT_VERSION, "body": subject.body}
    texts["provenance"] = json.dumps(subject.provenance, sort_keys=True)
    arrays = {name: np.array(value) for name, value in texts.items()}
    arrays |= {stored: np.array(getattr(subject, name), np.str_) for name, stored in _TEXTS.items()}
    arrays |= {stored: np.asarray(getattr(subject, name), np.float64) for name, stored in _NUMBERS.items()}
    return write_npz(path, arrays, overwrite=overwrite)


def read_subject(path: Path | str) -> MarkerSubject:
    """Read a subject file. Raise FileMissing, FileDamaged or SubjectInvalid."""
    fields = read_fields(path, ("format", "version", "body", "provenance", *_TEXTS.values(), *_NUMBERS.values()))
    fields.require_format(SUBJECT_FORMAT, SUBJECT_VERSION)
    texts: dict[str, Any] = {name: fields.texts(stored) for name, stored in _TEXTS.items()}
    count = len(texts["labels"])
    shapes = {"betas": (NUM_BETAS,), "offsets": (count, 3)}
    known: dict[str, Any] = {n: fields.numbers(stored, shapes.get(n, (count,))) for n, stored in _NUMBERS.items()}
    return MarkerSubject(body=fields.text("body"), provenance=read_provenance(fields), **texts, **known)
