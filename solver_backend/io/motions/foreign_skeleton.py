"""Read motions of skeletons from other programs. The figure determines an unknown unit and up axis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged, MotionInvalid, NonFiniteData
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, require_within
from solver_backend.exchange.rigs.jumps import bridge_jumps
from solver_backend.exchange.rigs.names import guess_roles
from solver_backend.exchange.rigs.skeleton import LIMBS, Skeleton, is_plausible
from solver_backend.exchange.rigs.structure import recognise
from solver_backend.exchange.skeleton_file import read_skeleton
from solver_backend.exchange.so3 import matrix_from_quat
from solver_backend.geometry.arrays import nearest_true, true_runs
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.files import read_xml
from solver_backend.io.markers.c3d import read_segments
from solver_backend.io.motions import acclaim
from solver_backend.io.motions.bvh import bvh_motion, bvh_skeleton, read_bvh
from solver_backend.io.packed_values import SUFFIXES as PACKED
from solver_backend.io.units_and_axes import METRES, metres_in, rotation_to_z_up
from solver_backend.types import SkeletonMotion

_LARGEST = 2_000_000_000  # Size limit of an MVNX file in bytes. One hour takes about 1.5 GB.


def _segment_table(text: str, *sides: str) -> dict[str, tuple[str, str]]:
    """Parse a table of segments. Return the parent and the role of each segment.

    Each entry consists of segment, parent and role, with parents first. An entry with an * is repeated for both sides.
    The file's words for left and right (``sides``) then replace the *.
    """
    rows = [entry.split() for entry in text.split(",")]
    found = {segment: (parent, role) for segment, parent, role in rows if "*" not in segment}
    for side in sides:
        name = f"{side.lower().removesuffix('_')}_"
        found |= {s.replace("*", side): (p.replace("*", side), r.replace("*", name)) for s, p, r in rows if "*" in s}
    return found


_XSENS_ROWS = """
    Pelvis - pelvis, L5 Pelvis spine_1, L3 L5 spine_2, T12 L3 spine_3, T8 T12 spine_4, Neck T8 neck_1,
    Head Neck head, *Shoulder T8 *clavicle, *UpperArm *Shoulder *upper_arm, *ForeArm *UpperArm *forearm,
    *Hand *ForeArm *hand, *UpperLeg Pelvis *thigh, *LowerLeg *UpperLeg *shin, *Foot *LowerLeg *foot, *Toe *Foot *toe
"""
_XSENS = _segment_table(_XSENS_ROWS, "Right", "Left")
"""Segments of the Xsens body."""


def read_mvnx(path: Path) -> tuple[SkeletonMotion, dict[str, str]]:
    """Read an Xsens MVNX file. Return its motion relative to the T-pose, and the joint of each role, such as ``head``.

    Raises:
        FileMissing, FileDamaged: the file is missing or not MVNX, or has no segments, frames or T-pose.
        NonFiniteData: a value is not a number.
        MotionInvalid: the file has no recorded frames.
    """
    where, root = str(path), read_xml(path, _LARGEST, "XML")
    for node in root.iter():
        node.tag = str(node.tag).rpartition("}")[2]
    subject = root.find("subject")
    segments = [] if subject is None else [str(node.get("label", "")) for node in subject.findall("segments/segment")]
    if subject is None or len(segments) < 2:
        raise FileDamaged("The file has no segments, so it is not an MVNX file.", where=where)
    if unknown := sorted(set(segments) - _XSENS.keys()):
        hint = "The segments of the MVN body are Pelvis, L5, … LeftToe. Export without props."
        raise FileDamaged(f"Unknown segments: {', '.join(unknown)}.", where=where, hint=hint)
    frames = subject.findall("frames/frame")
    kinds = [node.get("type", "normal") for node in frames]
    rest_at = next((kinds.index(kind) for kind in ("tpose", "tpose-isb", "identity") if kind in kinds), None)
    if rest_at is None:
        raise FileDamaged("The file has no T-pose.", where=where, hint="Export it with the calibration frames.")
    normal = [node for node, kind in zip(frames, kinds, strict=True) if kind == "normal"]
    if not normal:
        raise MotionInvalid("The file has no recorded frames.", where=where, hint="Export all frames.")
    order = [segments.index(name) for name in _XSENS if name in segments]
    names = tuple(segments[s] for s in order)
    used = [frames[rest_at], *normal]
    quats = _numbers(used, "orientation", (len(segments), 4), 2.0, where)[:, order]
    places = _numbers(used, "position", (len(segments), 3), FARTHEST_IN_UNITS, where)[:, order]
    size = np.linalg.norm(quats, axis=-1, keepdims=True)
    if size.min() < 0.5:
        raise NonFiniteData("Some orientations are zero.", where=where)
    G = matrix_from_quat(quats / size)
    parents = tuple(names.index(_XSENS[name][0]) if _XSENS[name][0] in names else -1 for name in names)
    turns = G[1:] @ np.swapaxes(G[0], -1, -2)
    try:
        rate = float(subject.get("frameRate", ""))
    except ValueError:
        rate = 0.0
    motion = SkeletonMotion(path.stem, names, parents, places[0], places[1:], turns, _possible(rate, where))
    return motion, {_XSENS[name][1]: name for name in names}


def _possible(rate: float | None, where: str) -> float:
    if rate is None or not 0 < rate < np.inf:
        raise FileDamaged("The file has no frame rate.", where=where)
    return rate


def _numbers(
    frames: list[ElementTree.Element], tag: str, shape: tuple[int, int], most: float, where: str
) -> np.ndarray:
    """Read the numbers (F, *shape) of one element in each frame. ``most`` limits their magnitude."""
    rows, count = [], shape[0] * shape[1]
    for frame in frames:
        try:
            rows.append(np.array((frame.findtext(tag) or "").split(), np.float64))
        except ValueError as error:
            raise NonFiniteData(f"'{tag}' contains something that is not a number.", where=where) from error
        if len(rows[-1]) != count:
            place = f"{where}, frame {frame.get('index') or frame.get('type')}"
            raise FileDamaged(f"'{tag}' has {len(rows[-1])} numbers instead of {count}.", where=place)
    values = np.array(rows).reshape(-1, *shape)
    require_within(f"'{tag}'", values, most, NonFiniteData, where)
    return values


_THEIA_ROWS = """
    pelvis - pelvis, abdomen pelvis spine_1, thorax abdomen spine_2, neck thorax neck_1, head neck head,
    *upper_arm thorax *upper_arm, *lower_arm *upper_arm *forearm, *hand *lower_arm *hand, *thigh pelvis *thigh,
    *shank *thigh *shin, *foot *shank *foot, *toes *foot *toe
"""
_THEIA = _segment_table(_THEIA_ROWS, "left_", "right_")
"""Segments in C3D files, as named by ``read_segments``."""
_LEAST_SEEN = 0.5  # Smallest fraction of the frames with a usable segment.


def read_c3d_segments(path: Path) -> tuple[SkeletonMotion, dict[str, str], list[Diagnostic]]:
    """Read the motion of the segments in a C3D file. Also return the segment of each role, and notes.

    The files have no rest pose. When a person stands with hanging arms, the segment axes are parallel (Z from the far
    to the near joint), so zero rotations give that pose. A joint's rest offset in its parent's axes is the median
    offset over all frames.

    Raises:
        FileMissing, FileDamaged: see ``read_segments``. Also raised if there are no segment rotations.
        MotionInvalid: the file has no pelvis or legs.
    """
    segments = read_segments(path)
    where = str(path)
    if segments is None:
        hint = "To solve its markers, use `solve`."
        raise FileDamaged("The C3D file contains no segment rotations.", where=where, hint=hint)
    at = {label: s for s, label in enumerate(segments.labels)}
    seen = np.isfinite(segments.positions).all(-1).mean(0)
    names = tuple(name for name in _THEIA if name in at and seen[at[name]] > _LEAST_SEEN)
    needed = ("pelvis", *(f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "shank", "foot")))
    if missing := [name for name in needed if name not in names]:
        raise MotionInvalid(f"The file has no segments {', '.join(missing)}.", where=where)
    index = [at[name] for name in names]
    places, G = _filled(segments.positions[:, index], segments.turns[:, index])
    unseen = true_runs(~np.isfinite(segments.positions[:, index]).all((1, 2)))
    found = [diagnostic("motion_segments_unseen", frames=unseen)] if unseen else []
    parents = tuple(names.index(_near(name, names)) if name != "pelvis" else -1 for name in names)
    rest = np.zeros((len(names), 3))
    for j, parent in enumerate(parents):
        if parent >= 0:
            local = np.swapaxes(G[:, parent], -1, -2) @ (places[:, j] - places[:, parent])[..., None]
            rest[j] = rest[parent] + np.median(local[..., 0], axis=0)
    motion = SkeletonMotion(path.stem, names, parents, rest, places, G, _possible(segments.rate, where))
    return motion, {_THEIA[name][1]: name for name in names}, found


def _near(name: str, names: tuple[str, ...]) -> str:
    above = _THEIA[name][0]
    while above not in names:
        above = _THEIA[above][0]
    return above


def _filled(places: np.ndarray, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fill gaps in positions and rotations with the last known value."""
    known = np.isfinite(places).all(-1)
    last, _ = nearest_true(known)
    last = np.where(last < 0, known.argmax(0), last)
    columns = np.arange(places.shape[1])
    return places[last, columns], G[last, columns]


_UNITS = {**METRES, "CMU (0.45 / 8 inch)": 0.0564444, "decimetre": 0.1}
"""Metres per length unit. CMU's conversions use a special unit."""
_LEG_M, _LEAST_LEG_M, _MOST_LEG_M = 0.80, 0.45, 1.15
"""Length from hip to knee to ankle in metres: average, smallest and largest (ANSUR II 0.70 to 1.0, age four 0.45)."""
_NEEDED = ("pelvis", *(f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "shin", "foot")))
"""Roles that a clip of a person must have."""
_READ = (".bvh", ".mvnx", ".c3d", ".npz", *acclaim.SUFFIXES)
_THROUGH_BLENDER = (".fbx", ".glb", ".gltf", ".vrm", ".vrma", ".blend")
_POINTS = (".csv", ".tsv", ".trc", ".npy")  # Files of points without rotations, such as FreeMoCap's tables.
_LEAST_SIZE = 1e-6  # Smallest size of a rest skeleton in any unit. A person is 0.0017 km tall.
_MOST_M = 1e4  # Largest distance from the origin in metres.
_APART_DEG, _TIMES = 25.0, 3.0
"""Smallest rotation of a joint, in degrees and relative to the largest one in the following frames, between a first
frame that is a separate pose and the second frame. In the benchmark, only CMU clips converted to BVH exceed it: 60° and
more."""
_CLEAR, _AT_ZERO, _NEAR_ZERO = 0.8, 0.15, 1.5
"""Smallest cosine between a direction and its axis, and largest height of the lowest joints in leg lengths: for a
figure that starts at 0 (ankles are at 0.1), and for a figure with its legs along the axis."""
_FOLLOWING = 12  # Number of frames compared with the first step.


def read_foreign_clip(
    path: Path, unit: str = "", up_axis: str = "", fps: float | None = None
) -> tuple[SkeletonMotion, dict[str, str], list[Diagnostic]]:
    """Read a person's motion from another program in metres with Z up.

    Also return the joint of each role (such as ``head``) and diagnostics. If no unit is given, the leg length
    determines it. If no up axis is given, the trunk determines it in BVH and AMC files, and it is Z in other formats.
    AMC files do not state a rate, so ``fps`` sets it.

    Raises:
        MocapError: see ``read_stated``.
        MotionInvalid: the skeleton is not a person's, or has no human size in any unit.
        JobInvalid: the unit or axis is unknown.
    """
    where = str(path)
    motion, roles, found = read_stated(path, fps=fps)
    above = {n: motion.names[p] for n, p in zip(motion.names, motion.parents, strict=True) if p >= 0}
    skeleton = Skeleton(dict(zip(motion.names, motion.rest, strict=True)), above)
    if set(_NEEDED) <= roles.keys():
        found += _missing(roles)
    else:
        roles, doubts = _roles(skeleton, where)
        found += doubts
    metres, units = _metres(skeleton, roles, unit, where)
    axis, usual = up_axis or "z", "z"
    source = ""
    if not up_axis and path.suffix.lower() in (".bvh", *acclaim.SUFFIXES):
        (axis, source), usual = _up_axis(motion, roles), "y"
    if source and (axis != usual or source == "rest"):
        units.append(diagnostic("up_axis_read", source=source, axis=axis.upper()))
    R, pelvis = rotation_to_z_up(axis), motion.names.index(roles["pelvis"])
    joints, turns, leaps = bridge_jumps(metres * (motion.joints @ R.T), R @ motion.turns, pelvis, motion.fps)
    if (far := np.abs(joints).max()) > _MOST_M:
        hint = "Offsets and positions have different units. Export the file again."
        raise MotionInvalid(f"The clip moves up to {far:.0f} m from the origin.", where=where, hint=hint)
    motion = replace(motion, rest=metres * motion.rest, joints=joints, turns=turns)
    return motion, roles, [*found, *units, *leaps, *first_frame_apart(motion)]


def read_stated(
    path: Path, through_blender: str = "motion convert", fps: float | None = None
) -> tuple[SkeletonMotion, dict[str, str], list[Diagnostic]]:
    """Read a motion from another program, in the file's unit and axes.

    Also return diagnostics, and the joint of each role (such as ``head``). There are no roles if the format does not
    define them. ``through_blender`` is the add-on's command that an error recommends for files that Blender can import.

    Raises:
        MocapError: the format is not supported, or the reader raises an error.
    """
    suffix, where = path.suffix.lower(), str(path)
    if suffix == ".bvh":
        clip = read_bvh(path, metres_per_unit=1.0, up_axis="z")
        return bvh_motion(clip, bvh_skeleton(clip, where), path.stem), {}, []
    if suffix in acclaim.SUFFIXES:
        assumed = [] if fps else [diagnostic("frame_rate_assumed", rate=acclaim.RATE)]
        return acclaim.read_acclaim(path, fps), {}, assumed
    if suffix == ".mvnx":
        return (*read_mvnx(path), [])
    if suffix == ".c3d":
        return read_c3d_segments(path)
    if suffix == ".npz":
        motion = read_skeleton(path)
        return motion, motion.roles, []
    if suffix in _THROUGH_BLENDER:
        hint = f"manifold blender {through_blender} {path.name} uses Blender's importer."
        raise MotionInvalid(f"{suffix[1:].upper()} files can only be read through Blender.", where=where, hint=hint)
    read = ", ".join((*_READ, *_THROUGH_BLENDER, ".npy", ".json", *PACKED))
    hint = f"Export the clip in one of these formats: {read}."
    if suffix in _POINTS:
        hint = f"To solve points without rotations, use manifold solve {path.name}"
    raise MotionInvalid(f"The file type is not supported ({suffix or 'no ending'}).", where=where, hint=hint)


def _roles(skeleton: Skeleton, where: str) -> tuple[dict[str, str], list[Diagnostic]]:
    if not skeleton.size > _LEAST_SIZE:
        hint = "Export the skeleton with bone lengths."
        raise MotionInvalid(f"The skeleton's rest pose is {skeleton.size:.3g} units large.", where=where, hint=hint)
    guess = recognise(skeleton)
    if not guess.roles and not guess.doubts:  # the names may describe arms without hands
        parents = {name: skeleton.names[p] for name, p in zip(skeleton.names, skeleton.parents, strict=True) if p >= 0}
        named = guess_roles(skeleton.names, parents)
        guess = replace(guess, roles=named if is_plausible(named, skeleton) else {})
    doubts = [doubt.partition(".")[0] for doubt in guess.doubts]  # the second sentence refers to a table for rigs
    if set(_NEEDED) <= guess.roles.keys():
        unclear = [diagnostic("motion_skeleton_unclear", doubt=doubt) for doubt in doubts]
        return guess.roles, [*_missing(guess.roles), *unclear]
    missing = [role for role in _NEEDED if role not in guess.roles]
    message = ". ".join(doubts) or "Its joints do not form a human skeleton"
    hint = f"{message}. At least a pelvis and two whole legs are needed, with names such as Hips and LeftLeg."
    raise MotionInvalid(f"No joints were found for {', '.join(missing)}.", where=where, hint=hint)


def _missing(roles: dict[str, str]) -> list[Diagnostic]:
    parts = [] if "head" in roles else ["head"]
    for limb, joints in LIMBS.items():
        lacking = [joint for joint in joints if joint not in roles]
        parts += [limb] if len(lacking) == len(joints) else lacking
    return [diagnostic("motion_limbs_missing", parts=[part.replace("_", " ") for part in parts])] if parts else []


def _metres(skeleton: Skeleton, roles: dict[str, str], unit: str, where: str) -> tuple[float, list[Diagnostic]]:
    """Return the length of the clip's unit in metres. Also return a note if it was estimated."""
    index = {name: i for i, name in enumerate(skeleton.names)}
    chains = [[index[roles[f"{side}_{part}"]] for part in ("thigh", "shin", "foot")] for side in ("left", "right")]
    leg = float(np.mean([skeleton.distance(a, b) + skeleton.distance(b, c) for a, b, c in chains]))
    if unit:
        return metres_in(unit), []
    name, metres = min(_UNITS.items(), key=lambda entry: abs(np.log(max(leg, 1e-12) * entry[1] / _LEG_M)))
    if not _LEAST_LEG_M <= leg * metres <= _MOST_LEG_M:
        hint = f"Known units are {', '.join(METRES)}. Specify one with --unit."
        raise MotionInvalid(f"Legs of {leg:.4g} units do not match a person in any known unit.", where=where, hint=hint)
    return metres, [diagnostic("unit_read", source="legs", unit=name, length=leg * metres)]


def _up_axis(motion: SkeletonMotion, roles: dict[str, str]) -> tuple[str, str]:
    """Estimate the up axis of a motion. Also return its source: ``trunk``, ``rest``, or '' for the default Y.

    A standing rest pose determines the axis, because the person may lie or fly in the motion. However, some converters
    write a skeleton with Y up and a motion with Z up. If the motion's trunk is along another axis than the rest pose,
    the trunk's axis is used, provided that the lowest joints are near height 0 along it.
    """
    top = next((role for role in ("head", "neck_1", "left_upper_arm") if role in roles), "pelvis")
    a, b = (motion.names.index(roles[role]) for role in ("pelvis", top))
    feet = [motion.names.index(roles[f"{side}_foot"]) for side in ("left", "right")]
    posed = _clear_axis(motion.joints[:, b] - motion.joints[:, a])
    rest = _clear_axis((motion.rest[b] - motion.rest[a])[None])
    if rest == 0 or _clear_axis((motion.rest[a] - motion.rest[feet].mean(0))[None]) != rest:
        rest = None  # A rest pose whose bones point along their own X, as in LAFAN1 and Bandai-Namco, is not standing.
    if rest is None or posed is None or rest == posed:
        axis = posed if rest is None else rest
        return ("y" if axis is None else "xyz"[axis]), ("trunk" if posed == axis else "rest" if axis != 1 else "")
    leg = float(np.linalg.norm(motion.rest[a] - motion.rest[feet].mean(0)))
    figure = motion.joints[:, [motion.names.index(name) for name in roles.values()]]
    lowest = np.abs(np.median(figure.min(axis=1), axis=0))
    legs = _clear_axis(motion.joints[:, a] - motion.joints[:, feet].mean(axis=1))
    stands = legs == posed and lowest[posed] < _NEAR_ZERO * leg  # Heights may be relative to the hips.
    stands = stands or lowest[posed] < min(_AT_ZERO * leg, lowest[rest] / 2)
    return "xyz"[posed if stands else rest], "trunk" if stands else "rest"


def _clear_axis(ways: np.ndarray) -> int | None:
    """Return the index of the axis along the mean of directions (F, 3), or None if no axis is close to it."""
    mean = (ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)).mean(0)
    axis = int(np.abs(mean).argmax())
    return axis if mean[axis] > _CLEAR else None


def first_frame_apart(motion: SkeletonMotion) -> list[Diagnostic]:
    """Warn if a joint jumps after the first frame, which suggests that the first frame is a separate pose."""
    parents = np.array(motion.parents)
    G = motion.turns[:_FOLLOWING]
    if len(G) < _FOLLOWING:
        return []
    local = np.where(parents[:, None, None] < 0, G, np.swapaxes(G[:, np.maximum(parents, 0)], -1, -2) @ G)
    steps = np.degrees(np.linalg.norm(log_so3(np.swapaxes(local[:-1], -1, -2) @ local[1:]), axis=-1)).max(axis=1)
    if steps[0] < max(_APART_DEG, _TIMES * steps[1:].max()):
        return []
    return [diagnostic("motion_first_frame_apart", frames=[(0, 0)], angle=steps[0])]
