"""Read body files, choose the body that a motion needs, and pose it."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from .._exchange.body_choice import SHIPPED, SUFFIXES, bodies_folder, is_path
from .._exchange.body_layout import FAMILY, SMPL_HANDS
from .._exchange.clips import pose_tree
from .._exchange.errors import BodyInvalid
from .._exchange.finger_joints import (
    FIRST_FINGER,
    HANDS_FILE,
    HANDS_KEYS,
    Skinning,
    from_flat,
    needs_hands_file,
    with_finger_joints,
)
from .._exchange.motion_file import MotionFile
from .._exchange.npz import read_arrays
from .._exchange.schema import Fields
from .._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from ..backend_environment import PACKAGE, backend_folder
from ..conventions.kept_findings import value_in
from ..conventions.skeleton import LAYOUTS, NUM_BETAS, SMPL, BodyLayout
from ..errors import BodyMismatch, BodyMissing
from .shown import SHOWN_FILE, Looks, Shapes, add_shown


def _on_smpl_joints(arrays: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """Convert an SMPL-H or SMPL-X body's arrays to SMPL's joints. Without finger rotations, the skin is the same."""
    tree, count = np.asarray(arrays["kintree_table"]), _joint_count(arrays)
    if count not in FAMILY or FAMILY[count] is SMPL:
        return arrays
    parents, vertices = tree[0].astype(np.int64), len(arrays["v_template"])
    _require_shapes(arrays, path, _skin_shapes(vertices, count))
    if (parents[1:] >= np.arange(1, count)).any() or (parents[1:] < 0).any():
        raise BodyInvalid("A joint comes before its parent.", where=str(path))
    layout, kept = FAMILY[count], 1 + SMPL.num_solved
    carrier = [*range(kept)]
    for joint in range(kept, count):
        above = int(parents[joint])
        hand = layout.groups[joint] if layout.groups[joint] in SMPL.joints else ""
        carrier.append(SMPL.joints.index(hand) if hand and above < kept else carrier[above])
    weights = np.zeros((vertices, SMPL.num_joints))
    np.add.at(weights.T, carrier, np.asarray(arrays["weights"], np.float64).T)
    reduced = {
        **arrays,
        "weights": weights,
        "J_regressor": np.asarray(arrays["J_regressor"])[list(layout.standing_for(SMPL))],
        "kintree_table": np.array([[*parents[:kept], *SMPL.parents[kept:]], range(SMPL.num_joints)]),
    }
    if "posedirs" in arrays:
        body, hands = np.asarray(arrays["posedirs"])[:, :, : 9 * SMPL.num_solved], SMPL.num_joints - kept
        reduced["posedirs"] = np.concatenate([body, np.zeros((vertices, 3, 9 * hands))], axis=2)
    return reduced


def has_fingers(arrays: dict[str, np.ndarray], hands_file: Path) -> bool:
    """Return whether a body has finger joints, either in its own file or in the bundled body's hands file."""
    given = FAMILY.get(_joint_count(arrays))
    if given is None or not needs_hands_file(given):
        return given is not None
    hands = read_arrays(hands_file, required=("body_id",))
    return "body_id" in arrays and str(arrays["body_id"]) == str(hands["body_id"])


def _add_finger_joints(arrays: dict[str, np.ndarray], path: Path, hands_file: Path) -> dict[str, np.ndarray]:
    """Convert the arrays of an SMPL, SMPL-H or SMPL-X body to the joints of ``SMPL_HANDS``."""
    tree, vertices, count = np.asarray(arrays["kintree_table"]), len(arrays["v_template"]), _joint_count(arrays)
    if count not in FAMILY:
        raise BodyInvalid(f"A body of {count} joints has no known finger joints.", where=str(path))
    _require_shapes(arrays, path, _skin_shapes(vertices, count))
    given = FAMILY[count]
    if tuple(tree[0].astype(np.int64)[1:]) != given.parents[1:]:
        raise BodyInvalid(f"The joint hierarchy differs from {given.name}.", where=str(path))
    hands = read_arrays(hands_file, required=HANDS_KEYS) if needs_hands_file(given) else None
    weights, regressor = (np.asarray(arrays[key], np.float64) for key in ("weights", "J_regressor"))
    own = Skinning(weights, regressor, arrays.get("posedirs"))
    body_id = str(arrays["body_id"]) if "body_id" in arrays else path.stem
    found = with_finger_joints(given, own, body_id, hands)
    reduced = {**arrays, "weights": found.weights, "J_regressor": found.J_regressor}
    reduced["kintree_table"] = np.array([SMPL_HANDS.parents, range(SMPL_HANDS.num_joints)])
    reduced |= {} if hands is None else {"flat_hands": np.asarray(hands["flat"], np.float64)}
    return reduced if found.posedirs is None else {**reduced, "posedirs": found.posedirs}


def _joint_count(arrays: dict[str, np.ndarray]) -> int:
    tree = np.asarray(arrays["kintree_table"])
    return tree.shape[1] if tree.ndim == 2 and len(tree) == 2 else 0


def _skin_shapes(vertices: int, joints: int) -> dict[str, tuple[int, ...]]:
    skin = {"J_regressor": (joints, vertices), "weights": (vertices, joints)}
    return {**skin, "posedirs": (vertices, 3, 9 * (joints - 1))}


def _require_shapes(arrays: dict[str, np.ndarray], path: Path, shapes: dict[str, tuple[int, ...]]) -> None:
    for key, shape in shapes.items():
        if key in arrays and np.shape(arrays[key]) != shape:
            raise BodyInvalid(f"{key} has shape {np.shape(arrays[key])}, but {shape} is expected.", where=str(path))


_REQUIRED = ("v_template", "shapedirs", "J_regressor", "weights", "kintree_table", "f")
_BLANK = ("blank_vertices", "blank_offsets")
_OPTIONAL = ("posedirs", "body_id", "vt", "ft", "face_material", "license", *_BLANK)
_TEXTS = frozenset({"body_id", "license"})
_ASSET = Path("assets", "body_neutral.npz")
_OWN_LICENCE = "CC0-1.0"
once_a_body = lru_cache(maxsize=2)
"""Decorator that caches a function's results for the last two bodies. Callers must not change the results."""


@dataclass(frozen=True, eq=False)
class BodyFile:
    """A skinned body in its rest frame, in metres: Y up, facing +Z, left = +X."""

    id: str  # The name used in motion files.
    v_template: np.ndarray  # (V, 3) mean vertices in metres.
    shapedirs: np.ndarray  # (V, 3, 10) metres per unit of shape.
    posedirs: np.ndarray | None  # (V, 3, 9 (J - 1)) metres per unit of pose feature flatten(R_j - I), j = 1..J-1.
    J_regressor: np.ndarray  # (J, V), rows sum to 1.
    weights: np.ndarray  # (V, J), rows sum to 1.
    faces: np.ndarray  # (T, 3) vertex indices.
    texture: tuple[np.ndarray, np.ndarray] | None = None
    """(N, 2) texture coordinates and (T, 3) indices of each face's coordinates, or None if there is no texture map."""
    face_material: np.ndarray | None = None  # (T,) material index of each face.
    blank_face: tuple[np.ndarray, np.ndarray] | None = None
    """(N,) vertices, and the (N, 3) offsets in metres that remove the face from them, or None without a blank face."""
    looks: Looks = field(default_factory=dict)
    """Looks stored in the body file: (T,) material of each face, and (V, 3) skin offsets in metres."""
    face_shapes: Shapes = field(default_factory=dict)  # Facial shapes, empty if the body has none.
    layout: BodyLayout = SMPL  # Names of the J joints and their tree, with or without fingers.
    flat_hands: np.ndarray | None = None
    """(30, 3, 3) rotations of the finger bones from rest to a flat hand, or None if the hand is flat at rest."""
    licence: str = ""  # SPDX identifier, or "" if the file does not state one.

    def shaped(self, betas: np.ndarray) -> np.ndarray:
        """Return rest vertices (V, 3) in metres (Loper et al. 2015, eq. 8)."""
        return self.v_template + self.shapedirs @ betas

    def rest_joints(self, betas: np.ndarray) -> np.ndarray:
        """Return rest joints (J, 3) in metres, ``J_regressor @ shaped`` (Loper et al. 2015, eq. 10)."""
        return self.J_regressor @ self.shaped(betas)


def default_body_path() -> Path:
    """Return the path of the bundled body. Raises ``SolverMissing`` if the solver is missing."""
    return backend_folder() / PACKAGE / _ASSET


def read_body(path: Path, layout: BodyLayout = SMPL) -> BodyFile:
    """Read a body of the SMPL, SMPL-H or SMPL-X family and convert it to a layout's joints.

    The two bodies read last stay in memory, with read-only arrays, as long as their files do not change. Raises
    ``BodyInvalid`` if an array has the wrong shape or values that are not finite, or if the joint tree differs.
    """
    path = Path(path)
    if path.suffix.lower() == ".pkl":
        message, hint = "Blender reads bodies from .npz files, not from pickles.", "Choose the model's .npz file."
        raise BodyInvalid(message, where=str(path), hint=hint)
    fingers = layout.num_joints > SMPL.num_joints
    return _read(path, layout, (_state(path), _state(default_hands_path()) if fingers else None))


@lru_cache(maxsize=2)
def _read(path: Path, layout: BodyLayout, state: object) -> BodyFile:
    stored = read_arrays(path, required=_REQUIRED, optional=_OPTIONAL)
    _require_numbers(stored, path)
    if layout.num_joints > SMPL.num_joints and has_fingers(stored, default_hands_path()):
        arrays = _add_finger_joints(stored, path, default_hands_path())
    else:
        arrays, layout = _on_smpl_joints(stored, path), SMPL
    arrays["shapedirs"] = np.asarray(arrays["shapedirs"])[..., :NUM_BETAS]
    _check(arrays, path, layout)
    shapes, looks = {}, {}
    if _ships_with_us(path):
        arrays, shapes, looks = add_shown(arrays, path.with_name(SHOWN_FILE))
    weights, fields = np.asarray(arrays["weights"], np.float64), Fields(path, arrays)
    posedirs, material = (arrays.get(key) for key in ("posedirs", "face_material"))
    body = BodyFile(
        id=fields.text("body_id", path.stem),
        v_template=np.asarray(arrays["v_template"], np.float64),
        shapedirs=np.asarray(arrays["shapedirs"], np.float64),
        posedirs=posedirs,
        J_regressor=np.asarray(arrays["J_regressor"], np.float64),
        weights=weights / weights.sum(axis=1, keepdims=True),
        faces=np.asarray(arrays["f"]).astype(np.int64),
        texture=_texture(arrays),
        face_material=None if material is None else np.asarray(material).astype(np.int64),
        blank_face=_blank_face(arrays),
        looks=looks,
        face_shapes=shapes,
        layout=layout,
        flat_hands=arrays.get("flat_hands"),
        licence=fields.text("license", _OWN_LICENCE if _ships_with_us(path) else ""),
    )
    for array in [*vars(body).values(), *(body.blank_face or ()), *(body.texture or ())]:
        if isinstance(array, np.ndarray):
            array.flags.writeable = False
    return body


def _state(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def default_hands_path() -> Path:
    """Return the path of the file that stores the bundled body's finger joints."""
    return default_body_path().with_name(HANDS_FILE)


def _blank_face(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
    if not set(_BLANK) <= set(arrays):
        return None
    vertices, offsets = (arrays[name] for name in _BLANK)
    return vertices.astype(np.int64), np.asarray(offsets, np.float32)


def _texture(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
    if not {"vt", "ft"} <= set(arrays) or np.shape(arrays["ft"]) != np.shape(arrays["f"]):
        return None
    points, corners = np.asarray(arrays["vt"], np.float64), np.asarray(arrays["ft"]).astype(np.int64)
    if points.shape[1:] != (2,) or corners.min() < 0 or corners.max() >= len(points) or not np.isfinite(points).all():
        return None
    owner = np.zeros(len(points), np.int64)
    owner[corners] = arrays["f"]
    return (points, corners) if (owner[corners] == arrays["f"]).all() else None


def _ships_with_us(path: Path) -> bool:
    return path.resolve().parts[-len(_ASSET.parts) :] == _ASSET.parts


def _require_numbers(arrays: dict[str, np.ndarray], path: Path) -> None:
    for key in set(arrays) - _TEXTS:
        if arrays[key].dtype.kind not in "fiub" or not arrays[key].ndim:
            found = f"{key} is {arrays[key].dtype} of shape {arrays[key].shape}"
            hint = "Use the model's .npz file as downloaded."
            raise BodyInvalid(f"{found}, but an array of numbers is expected.", where=str(path), hint=hint)


def _check(arrays: dict[str, np.ndarray], path: Path, layout: BodyLayout) -> None:
    vertices, faces, joints = len(arrays["v_template"]), len(arrays["f"]), layout.num_joints
    shapes = _skin_shapes(vertices, joints) | {
        "v_template": (vertices, 3),
        "shapedirs": (vertices, 3, NUM_BETAS),
        "kintree_table": (2, joints),
        "f": (faces, 3),
        "face_material": (faces,),
        "blank_offsets": (len(arrays.get("blank_vertices", ())), 3),
    }
    _require_shapes(arrays, path, shapes)
    if wrong := [key for key in shapes if key in arrays and not np.isfinite(arrays[key]).all()]:
        raise BodyInvalid(f"{wrong[0]} contains NaN or infinite values.", where=str(path))
    if not faces or arrays["f"].min() < 0 or arrays["f"].max() >= vertices:
        raise BodyInvalid(f"The faces must refer to vertices 0 to {vertices - 1}.", where=str(path))
    blank = arrays.get("blank_vertices", np.zeros(1, int))
    if blank.ndim != 1 or not blank.size or blank.min() < 0 or blank.max() >= vertices:
        raise BodyInvalid(f"blank_vertices must refer to vertices 0 to {vertices - 1}.", where=str(path))
    if (arrays["weights"].sum(axis=1) <= 0).any():
        raise BodyInvalid("A vertex has no skinning weight.", where=str(path))
    if not np.array_equal(arrays["kintree_table"][0, 1:], layout.parents[1:]):
        raise BodyInvalid("The joint hierarchy differs from SMPL.", where=str(path))


def body_path_of(provenance: str) -> Path:
    """Return the body file named in a motion's provenance, or the bundled body."""
    choice = value_in(provenance, "settings", "body")
    if not isinstance(choice, str) or choice in ("", SHIPPED):
        return default_body_path()
    by_name = [bodies_folder() / f"{choice}{end}" for end in SUFFIXES]
    places = [Path(os.path.expanduser(choice))] if is_path(choice) else by_name
    for place in places:
        if os.path.isfile(place):
            return place
    message = f"The motion was solved with the body '{places[0].stem}', but its file does not exist."
    hint = f"Put the file into {bodies_folder()}, or specify its path when you bake."
    raise BodyMissing(message, where=str(places[0]), hint=hint)


def require_body(motion: MotionFile, body: BodyFile) -> None:
    """Raise ``BodyMismatch`` if a motion was solved for another body. A motion that names no body passes."""
    if motion.body and body.id and motion.body != body.id:
        message = f"The motion was solved with the body '{motion.body}', not '{body.id}'."
        raise BodyMismatch(message, where=motion.name, hint="Choose the body file of the solve.")


def pose_joints(rest: np.ndarray, rotvec: np.ndarray, transl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose the joint tree of one of the add-on's layouts (see ``pose_tree``)."""
    parents = next(layout.parents for layout in LAYOUTS if layout.num_joints == len(rest))
    return pose_tree(rest, parents, rotvec, transl)


def with_own_hands(motion: MotionFile, body: BodyFile) -> MotionFile:
    """Convert finger rotations relative to flat hands to rotations relative to the body's rest hands."""
    if not motion.flat_hands:
        return motion
    rotvec = motion.rotvec
    if body.flat_hands is not None:
        fingers = from_flat(matrix_from_rotvec(rotvec[:, FIRST_FINGER:]), body.flat_hands)
        rotvec = np.concatenate([rotvec[:, :FIRST_FINGER], rotvec_from_matrix(fingers)], axis=1)
    return replace(motion, rotvec=rotvec, flat_hands=False)


def rotvec_on(motion: MotionFile, layout: BodyLayout) -> np.ndarray:
    """Return a motion's axis-angle vectors (F, J, 3) for a layout's joints. Missing joints are at rest."""
    if motion.body_layout.joints == layout.joints:
        return motion.rotvec
    rotvec = np.zeros((motion.num_frames, layout.num_joints, 3))
    for j, joint in enumerate(layout.joints):
        if joint in motion.body_layout.joints:
            rotvec[:, j] = motion.rotvec[:, motion.body_layout.joints.index(joint)]
    return rotvec


def turns_on(layout: BodyLayout, rotvec: np.ndarray) -> np.ndarray:
    """Convert (F, 24 or 52, 3) axis-angle vectors to a layout's joints. Missing fingers are at rest."""
    if rotvec.shape[1] == layout.num_joints:
        return rotvec
    turned = np.zeros((len(rotvec), layout.num_joints, 3))
    turned[:, :FIRST_FINGER] = rotvec[:, :FIRST_FINGER]
    return turned


def skin(body: BodyFile, motion: MotionFile, frames: list[int], worn: np.ndarray | float = 0.0) -> np.ndarray:
    """Return the skin (N, V, 3) in N frames, in world metres (Loper et al. 2015).

    ``worn`` is the offset between skin and clothes at rest, in metres.
    """
    rest = body.rest_joints(motion.betas)
    rotvec = rotvec_on(motion, body.layout)[frames]
    G, p = pose_joints(rest, rotvec, motion.transl[frames])
    shaped = np.broadcast_to(body.shaped(motion.betas) + worn, (len(frames), len(body.v_template), 3))
    if body.posedirs is not None:
        feature = (matrix_from_rotvec(rotvec[:, 1:]) - np.eye(3)).reshape(len(frames), -1)
        shaped = shaped + np.tensordot(feature, body.posedirs, axes=(1, 2))
    offset = p - (G @ rest[..., None])[..., 0]
    blend_G = np.tensordot(body.weights, G, axes=(1, 1)).transpose(1, 0, 2, 3)
    blend_p = np.tensordot(body.weights, offset, axes=(1, 1)).transpose(1, 0, 2)
    return (blend_G @ shaped[..., None])[..., 0] + blend_p
