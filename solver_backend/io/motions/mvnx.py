"""Motion in from MVNX, the XML of Xsens' suits: orientation and origin of every segment.

Source: Xsens, "MVNX: MVN Open XML format", version 4: world Z up, metres, quaternions wxyz from a segment's axes to the
world's; frames of the types ``identity``, ``tpose`` and ``tpose-isb`` come before the recording.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from solver_backend.exchange.errors import FileDamaged, MotionInvalid, NonFiniteData
from solver_backend.exchange.so3 import matrix_from_quat
from solver_backend.io.files import read_bytes
from solver_backend.types import SkeletonMotion

_LARGEST = 2_000_000_000
_PARENTS = {
    "L5": "Pelvis", "L3": "L5", "T12": "L3", "T8": "T12", "Neck": "T8", "Head": "Neck",
    **{f"{side}{part}": (side + above if part not in ("Shoulder", "UpperLeg") else above)
       for side in ("Right", "Left")
       for part, above in (("Shoulder", "T8"), ("UpperArm", "Shoulder"), ("ForeArm", "UpperArm"), ("Hand", "ForeArm"),
                           ("UpperLeg", "Pelvis"), ("LowerLeg", "UpperLeg"), ("Foot", "LowerLeg"), ("Toe", "Foot"))},
}  # fmt: skip
"""The segment that each hangs on."""
_ROLES = {
    "Pelvis": "pelvis", "L5": "spine_1", "L3": "spine_2", "T12": "spine_3", "T8": "spine_4", "Neck": "neck_1",
    "Head": "head",
    **{f"{side}{part}": f"{side.lower()}_{role}" for side in ("Right", "Left")
       for part, role in (("Shoulder", "clavicle"), ("UpperArm", "upper_arm"), ("ForeArm", "forearm"),
                          ("Hand", "hand"), ("UpperLeg", "thigh"), ("LowerLeg", "shin"), ("Foot", "foot"),
                          ("Toe", "toe"))},
}  # fmt: skip


def read_mvnx(path: Path) -> tuple[SkeletonMotion, dict[str, str]]:
    """Read the recorded frames of an MVNX file, and the segment of each role.

    The rest is the file's T-pose: rotations count from it.

    Raises:
        FileMissing, FileDamaged: it is not there, is no MVNX, or lacks segments, frames or a T-pose.
        NonFiniteData: a value is no number.
        MotionInvalid: nothing was recorded.
    """
    where = str(path)
    try:
        root = ElementTree.fromstring(read_bytes(path, _LARGEST))
    except (ElementTree.ParseError, LookupError, ValueError, RecursionError) as error:
        raise FileDamaged(f"This is not XML: {error}.", where=where) from error
    for node in root.iter():
        node.tag = str(node.tag).rpartition("}")[2]
    subject = root.find("subject")
    segments = [] if subject is None else [str(node.get("label", "")) for node in subject.findall("segments/segment")]
    if subject is None or len(segments) < 2:
        raise FileDamaged("The file names no segments: this is not MVNX.", where=where)
    if unknown := sorted(set(segments) - _ROLES.keys()):
        hint = "Segments are those of MVN's body: Pelvis, L5, … LeftToe; leave props out of the export."
        raise FileDamaged(f"Unknown segments: {', '.join(unknown)}.", where=where, hint=hint)
    frames = subject.findall("frames/frame")
    kinds = [node.get("type", "normal") for node in frames]
    rest_at = next((kinds.index(kind) for kind in ("tpose", "tpose-isb", "identity") if kind in kinds), None)
    if rest_at is None:
        raise FileDamaged("The file has no T-pose.", where=where, hint="Export it with the calibration frames.")
    normal = [node for node, kind in zip(frames, kinds, strict=True) if kind == "normal"]
    if not normal:
        raise MotionInvalid("The file has no recorded frames.", where=where, hint="Export frames, not the pose alone.")
    order = [segments.index(name) for name in _ROLES if name in segments]
    names = tuple(segments[s] for s in order)
    used = [frames[rest_at], *normal]
    quats = _numbers(used, "orientation", 4 * len(segments), where).reshape(len(used), -1, 4)[:, order]
    places = _numbers(used, "position", 3 * len(segments), where).reshape(len(used), -1, 3)[:, order]
    size = np.linalg.norm(quats, axis=-1, keepdims=True)
    if size.min() < 0.5:
        raise NonFiniteData("Orientations hold zeros.", where=where)
    G = matrix_from_quat(quats / size)
    parents = tuple(names.index(_PARENTS[name]) if _PARENTS.get(name) in names else -1 for name in names)
    turns = G[1:] @ np.swapaxes(G[0], -1, -2)
    return (
        SkeletonMotion(path.stem, names, parents, places[0], places[1:], turns, _rate(subject, where)),
        {_ROLES[name]: name for name in names},
    )


def _numbers(frames: list[ElementTree.Element], tag: str, count: int, where: str) -> np.ndarray:
    """Return the (F, count) numbers of one entry of every frame."""
    rows = np.empty((len(frames), count))
    for row, frame in zip(rows, frames, strict=True):
        try:
            values = np.array((frame.findtext(tag) or "").split(), np.float64)
        except ValueError as error:
            raise NonFiniteData(f"'{tag}' holds something that is not a number.", where=where) from error
        if len(values) != count:
            place = f"{where}, frame {frame.get('index') or frame.get('type')}"
            raise FileDamaged(f"'{tag}' has {len(values)} numbers instead of {count}.", where=place)
        row[:] = values
    if not np.isfinite(rows).all():
        raise NonFiniteData(f"'{tag}' holds NaN or infinite values.", where=where)
    return rows


def _rate(subject: ElementTree.Element, where: str) -> float:
    try:
        rate = float(subject.get("frameRate", ""))
    except ValueError:
        rate = 0.0
    if not 0 < rate < np.inf:
        raise FileDamaged("The subject states no frame rate.", where=where)
    return rate
