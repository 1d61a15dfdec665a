"""Read and write AMASS-compatible motion files with joint positions and provenance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .body_layout import (
    AMASS_POSE_WIDTH,
    AMASS_WIDTHS,
    BODY_COLUMNS,
    FINGER_COLUMNS,
    SMPL,
    SMPL_HANDS,
    BodyLayout,
    body_and_fingers,
)
from .errors import BodyInvalid, MocapError, MotionInvalid
from .joint_sets import NUM_BETAS
from .npz import array_names, read_arrays, write_npz
from .plausible import require_motion
from .props import PROPS, Prop, prop_arrays, read_props, require_length
from .schema import Fields, Shape, fits

FORMAT, VERSION = "manifold_mocap_motion", 1
FLAG_UNSEEN = 1
"""The frame has no usable observation. Its pose is interpolated from its neighbours."""
FLAG_UNSURE = 2  # The residual or a joint's uncertainty is far above the take's usual value. Check this frame.
FLAG_RESTING = 4
"""Some body part is not observed in the frame and is shown at rest (see ``MotionFile.resting``)."""
MARKER_SEEN, MARKER_FILLED, MARKER_SWAPPED, MARKER_GHOST = 1, 2, 4, 8
"""States of a marker in a frame: recorded; missing and filled in by the solve; recorded under another marker's label
and corrected; or recorded at an impossible position, ignored and filled in."""
_LAYOUT = ("body_layout", "joint_names", "joint_groups", "resting_groups")
"""Arrays stored for layouts other than SMPL's: layout name, joint names, joint groups and groups at rest."""
_PARENTS = "joint_parents"  # Parent of each joint, -1 for the root.
_OPTIONAL = (
    "joints frames joints 3, keypoints3d frames keypoints 3, joint_sigma frames joints, "
    "joint_covariance frames joints 6, turn_covariance frames segments 6, reprojection_px views frames keypoints, "
    "keyframes frames, contacts frames 2, touches frames 11, flags frames, resting frames joints, root frames 3, "
    "markers frames markers 3, marker_residual_mm frames markers, marker_flags frames markers, marker_sigma markers, "
    "cleaned_markers frames markers 3, offsets markers 3"
)
_SHAPES = {name: [int(n) if n.isdigit() else n for n in axes] for name, *axes in map(str.split, _OPTIONAL.split(", "))}
"""Shape of each optional array of a motion."""
FRAMES_AXIS = {"rotvec": 0, "transl": 0, **{n: axes.index("frames") for n, axes in _SHAPES.items() if "frames" in axes}}
"""Index of the frame axis in each of a motion's arrays that has one."""
OBSERVED = (
    *("keypoints3d", "joint_set", "reprojection_px", "markers", "marker_labels", "marker_residual_mm", "marker_flags"),
    *("marker_sigma", "cleaned_markers", "offsets", "layout", "turn_covariance"),
)
"""Fields of a motion that describe what cameras and markers observed rather than the body."""
_ALWAYS = "format version poses trans betas mocap_framerate mocap_frame_rate body hand_pose joint_set marker_labels"
STORED = (*_ALWAYS.split(), "layout", "provenance", *_SHAPES, *_LAYOUT, _PARENTS, *PROPS)
"""All arrays in a motion file that the solver reads."""
_NOT_SHOWN = "joint_covariance turn_covariance reprojection_px marker_flags marker_sigma cleaned_markers offsets layout"
_SHOWN = tuple(name for name in STORED if name not in set(_NOT_SHOWN.split()))
_DTYPES = {
    **dict.fromkeys(("keyframes", "contacts", "touches", "resting"), np.bool_),
    **dict.fromkeys(("flags", "marker_flags"), np.uint8),
}


def has_amass_fingers(fields: Fields) -> bool:
    """Return whether a file is an AMASS file with moving fingers."""
    if "format" in fields:
        return False
    poses = fields.floats("poses", MotionInvalid)
    return poses.ndim == 2 and poses.shape[1] in AMASS_WIDTHS and bool(poses[:, -FINGER_COLUMNS:].any())


def optional_shapes(frames: int, joints: int = SMPL.num_joints) -> dict[str, Shape]:
    """Return the shapes of a motion's optional arrays for these numbers of frames and joints."""
    known = {"frames": frames, "joints": joints}
    return {name: tuple(known.get(str(length), length) for length in shape) for name, shape in _SHAPES.items()}


@dataclass(frozen=True)
class MotionFile:
    """An animated body with F frames, in metres and radians, in a world with Z up."""

    name: str
    rotvec: np.ndarray  # (F, J, 3) rotation vectors: body to world for the root, child to parent for other joints.
    transl: np.ndarray  # (F, 3) translations in metres. The pelvis is at ``J_0(betas) + transl``.
    betas: np.ndarray  # (10,) shape coefficients.
    fps: float  # Frames per second.
    body: str = ""  # Id of the body used in the solve, or "" if the file does not state it.
    body_layout: BodyLayout = SMPL  # Names and tree of the J joints.
    flat_hands: bool = False  # True if finger rotations are relative to a flat hand (AMASS), False if relative to rest.
    joints: np.ndarray | None = None  # (F, J, 3) joint positions in world metres.
    keypoints3d: np.ndarray | None = None  # (F, K, 3) triangulated keypoints in world metres, NaN where unseen.
    joint_set: str = ""  # Name of the joint set of ``keypoints3d``.
    keyframes: np.ndarray | None = None  # (F,) bool, True at the solver's keyframes.
    contacts: np.ndarray | None = None  # (F, 2) bool, True while the left or right foot is on the floor.
    touches: np.ndarray | None = None  # (F, 11) bool, parts on the floor (``CONTACT_PARTS``). None: only feet known.
    joint_sigma: np.ndarray | None = None  # (F, J) standard deviation of each joint position in metres.
    joint_covariance: np.ndarray | None = None
    """(F, J, 6) covariance of each joint position in square metres: xx, xy, xz, yy, yz, zz."""
    turn_covariance: np.ndarray | None = None  # (F, S, 6) covariance of each segment's rotation in rad², same order.
    flags: np.ndarray | None = None  # (F,) bit mask of ``FLAG_UNSEEN``, ``FLAG_UNSURE`` and ``FLAG_RESTING``.
    resting: np.ndarray | None = None
    """(F, J) bool, True if no measurement determines the joint, which is shown at rest. None if all are determined."""
    root: np.ndarray | None = None
    """(F, 3) path of a root bone on the ground: x and y in metres, and heading relative to -Y in radians. The body's
    pose remains in world coordinates."""
    reprojection_px: np.ndarray | None = None
    """(views, F, K) keypoint reprojection errors in pixels, NaN where undetected."""
    markers: np.ndarray | None = None  # (F, M, 3) marker positions on the solved body, world metres.
    marker_labels: tuple[str, ...] = ()  # (M,) labels of ``markers``.
    marker_residual_mm: np.ndarray | None = None
    """(F, M) distances between recorded and solved markers in millimetres, NaN where missing."""
    marker_flags: np.ndarray | None = None
    """(F, M) bit mask of ``MARKER_SEEN``, ``MARKER_FILLED``, ``MARKER_SWAPPED`` and ``MARKER_GHOST``."""
    marker_sigma: np.ndarray | None = None
    """(M,) standard deviation per axis of each marker around its position on the body, in metres."""
    cleaned_markers: np.ndarray | None = None
    """(F, M, 3) recorded markers in world metres, with swaps corrected and gaps filled."""
    offsets: np.ndarray | None = None
    """(M, 3) offset of each marker from its nominal position in the rest pose, in metres."""
    layout: tuple[str, ...] = ()  # (M,) body landmark of each marker.
    props: tuple[Prop, ...] = ()  # Rigid objects that are not part of the person, with F frames each.
    provenance: str = ""  # JSON text: version, settings and sources of the solve.

    def __post_init__(self) -> None:
        frames, joints = (*np.shape(self.rotvec), 0)[0], self.body_layout.num_joints
        shapes = {"rotvec": (frames, joints, 3), "transl": (frames, 3), "betas": (NUM_BETAS,)}
        for name, shape in (shapes | optional_shapes(frames, joints)).items():
            value = getattr(self, name)
            if value is not None and not fits(np.shape(value), shape):
                wanted = f"({', '.join(map(str, shape))})"
                raise MotionInvalid(f"{name} has shape {np.shape(value)}, but {wanted} is expected.", where="motion")
        require_motion(self, self.rotvec, MotionInvalid, "motion")
        require_length(self.props, frames)

    @property
    def num_frames(self) -> int:
        """Number of frames F of the motion."""
        return len(self.rotvec)


def is_motion(path: Path) -> bool:
    """Return whether a file is a readable motion file in our format or in the AMASS format."""
    if path.suffix.lower() != ".npz":
        return False
    try:
        names = array_names(path)
        if "format" not in names:
            return "poses" in names
        return Fields(path, read_arrays(path, required=("format",))).text("format") == FORMAT
    except MocapError:
        return False


def read_motion(path: Path, *layouts: BodyLayout, whole: bool = False) -> MotionFile:
    """Read the parts of a motion file that Blender displays.

    Args:
        layouts: accepted body layouts. The default is SMPL with and without moving fingers.
        whole: True reads all parts.

    Raises:
        MotionInvalid: the layout differs, shapes are inconsistent, there are no frames, or values are not finite.
    """
    kept = array_names(Path(path))
    if "poses" not in kept and "format" in kept:
        Fields(Path(path), read_arrays(path, required=("format",))).accept_format(FORMAT, VERSION)
    fields = Fields(Path(path), read_arrays(path, required=("poses", "trans"), optional=STORED if whole else _SHOWN))
    fields.accept_format(FORMAT, VERSION)
    motion = motion_of(fields)
    found, layouts = motion.body_layout, layouts or (SMPL, SMPL_HANDS)
    if all((found.joints, found.parents) != (layout.joints, layout.parents) for layout in layouts):
        found.require_same_joints(layouts[0], str(fields.path))
    return motion


def _typed(fields: Fields, key: str, shape: Shape) -> np.ndarray:
    """Read an optional array with the data type of its key. A bool must be 0 or 1, and a flag 0 to 255."""
    value, kind = fields.shaped(key, shape, MotionInvalid), _DTYPES.get(key)
    if kind is None:
        return value
    most = 1 if kind is np.bool_ else 255
    _require(bool(((value >= 0) & (value <= most)).all()), f"{key} contains numbers outside 0 to {most}.", fields)
    return value.astype(kind)


def motion_of(fields: Fields) -> MotionFile:
    """Build a motion from the arrays in a file. Missing optional arrays become None.

    Raises:
        MotionInvalid: shapes are inconsistent, there is no frame rate, or numbers are invalid (see ``plausible``).
    """
    layout, flat = layout_of(fields), has_amass_fingers(fields)
    layout = SMPL_HANDS if flat else layout
    _require(np.shape(fields.arrays["poses"])[:1] != (0,), "The motion has no frames.", fields)
    rotvec = _rotations(fields, layout)
    present: dict[str, Any] = {
        key: _typed(fields, key, shape)
        for key, shape in optional_shapes(len(rotvec), layout.num_joints).items()
        if key in fields
    }
    present |= {key: fields.text(key, "") for key in ("body", "joint_set", "provenance")}
    present |= {key: fields.texts(key) for key in ("marker_labels", "layout")}
    transl, fps = fields.shaped("trans", (len(rotvec), 3), MotionInvalid), _frame_rate(fields)
    try:
        motion = MotionFile(fields.path.stem, rotvec, transl, _betas(fields), fps, body_layout=layout, **present)
        return replace(motion, flat_hands=flat, props=read_props(fields, len(rotvec)))
    except MotionInvalid as error:
        raise MotionInvalid(error.message, where=str(fields.path), hint=error.hint) from error


def write_motion(path: Path | str, motion: MotionFile, *, overwrite: bool = False) -> Path:
    """Write a motion. Parts that are None are omitted.

    For SMPL, ``poses`` (F, 156) contains the root and the joints that SMPL and AMASS share. ``hand_pose`` (F, 6)
    contains SMPL's hand joints, which AMASS does not have. ``hand_pose`` is omitted if all its values are zero. For
    other layouts, ``poses`` (F, 3 J) contains all joints, and the file also contains the layout.
    """
    rotvec, layout, hands = motion.rotvec.reshape(motion.num_frames, -1), motion.body_layout, np.zeros(0)
    poses = rotvec.astype(np.float32)
    if layout == SMPL:
        poses = np.zeros((motion.num_frames, AMASS_POSE_WIDTH), np.float32)
        poses[:, :BODY_COLUMNS] = rotvec[:, :BODY_COLUMNS]
        hands = rotvec[:, BODY_COLUMNS:].astype(np.float32)
    arrays: dict[str, np.ndarray] = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "poses": poses,
        "trans": np.asarray(motion.transl, np.float32),
        "betas": np.asarray(motion.betas, np.float32),
        "mocap_framerate": np.array(float(motion.fps)),
        "gender": np.array("neutral"),
        "body": np.array(motion.body),
        **({} if motion.joints is None else {"joints": np.asarray(motion.joints, np.float32)}),
        "provenance": np.array(motion.provenance),
    }
    if layout != SMPL:
        texts = (layout.name, layout.joints, layout.groups, layout.resting)
        arrays |= {key: np.array(value, dtype=np.str_) for key, value in zip(_LAYOUT, texts, strict=True)}
        arrays[_PARENTS] = np.array(layout.parents)
    if hands.any():
        arrays["hand_pose"] = hands
    if motion.joint_set:
        arrays["joint_set"] = np.array(motion.joint_set)
    if motion.marker_labels:
        arrays["marker_labels"] = np.array(motion.marker_labels, dtype=np.str_)
    arrays |= prop_arrays(motion.props)
    if motion.layout:
        arrays["layout"] = np.array(motion.layout, dtype=np.str_)
    for key in optional_shapes(motion.num_frames, layout.num_joints):
        if (value := getattr(motion, key)) is not None:
            arrays[key] = np.asarray(value, _DTYPES.get(key, np.float32))
    return write_npz(path, arrays, overwrite=overwrite)


def layout_of(fields: Fields) -> BodyLayout:
    """Return the body layout that a motion file states, or SMPL's by default.

    Raises:
        MotionInvalid: the joints do not form a layout.
    """
    if "joint_names" not in fields:
        return SMPL
    joints, groups, resting = (fields.texts(key) for key in _LAYOUT[1:])
    parents = fields.floats(_PARENTS, MotionInvalid).reshape(-1) if _PARENTS in fields else ()
    try:
        tree = tuple(int(parent) for parent in parents)
        return BodyLayout(fields.text("body_layout", ""), joints, tree, groups or joints, resting)
    except (BodyInvalid, ValueError, OverflowError) as error:
        raise MotionInvalid(f"The joints are not a valid layout: {error}", where=str(fields.path)) from error


def _rotations(fields: Fields, layout: BodyLayout) -> np.ndarray:
    if has_amass_fingers(fields):
        return body_and_fingers(fields.floats("poses", MotionInvalid))
    poses, least = fields.floats("poses", MotionInvalid), BODY_COLUMNS if layout == SMPL else 3 * layout.num_joints
    if poses.ndim != 2 or poses.shape[1] < least or (layout != SMPL and poses.shape[1] > least):
        expected = f"{least} or more" if layout == SMPL else str(least)
        message = f"poses has shape {poses.shape}, but (frames, {expected}) is expected of the layout {layout.name}."
        raise MotionInvalid(message, where=str(fields.path))
    if layout != SMPL:
        return poses.reshape(-1, layout.num_joints, 3)
    rotvec = np.zeros((len(poses), 3 * SMPL.num_joints))
    rotvec[:, :BODY_COLUMNS] = poses[:, :BODY_COLUMNS]
    hands = fields.floats("hand_pose", MotionInvalid) if "hand_pose" in fields else None
    hands = poses[:, BODY_COLUMNS:] if poses.shape[1] == 3 * SMPL.num_joints else hands
    if hands is not None and np.shape(hands) == (len(poses), 6):
        rotvec[:, BODY_COLUMNS:] = hands
    return rotvec.reshape(-1, SMPL.num_joints, 3)


def _betas(fields: Fields) -> np.ndarray:
    given = np.ravel(fields.floats("betas", MotionInvalid) if "betas" in fields else ())[:NUM_BETAS]
    return np.pad(given, (0, NUM_BETAS - len(given)))


def _frame_rate(fields: Fields) -> float:
    key = "mocap_framerate" if "mocap_framerate" in fields else "mocap_frame_rate"
    _require(key in fields, "The motion has no frame rate (mocap_framerate).", fields)
    return fields.first_number(key, MotionInvalid)


def _require(good: bool, message: str, fields: Fields) -> None:
    if not good:
        raise MotionInvalid(message, where=str(fields.path))
