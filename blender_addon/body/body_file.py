"""The body file: an SMPL-type body with our material and texture layout beside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from .._exchange.errors import BodyInvalid
from .._exchange.finger_joints import HANDS_FILE
from .._exchange.npz import read_arrays
from .._exchange.schema import Fields
from ..backend_environment import PACKAGE, backend_folder
from ..conventions.skeleton import NUM_BETAS, SMPL, BodyLayout
from .fingers import add_finger_joints, has_fingers
from .smpl_family import on_smpl_joints

_REQUIRED = ("v_template", "shapedirs", "J_regressor", "weights", "kintree_table", "f")
_BLANK = ("blank_vertices", "blank_offsets")
_OPTIONAL = ("posedirs", "body_id", "uv", "face_material", "license", *_BLANK)
_TEXTS = frozenset({"body_id", "license"})
_ASSET = Path("assets", "body_neutral.npz")
_OWN_LICENCE = "GPL-3.0-or-later"
_Key = ParamSpec("_Key")
_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class BodyFile:
    """A skinned body in its rest frame: Y up, facing +Z, left = +X, metres."""

    id: str
    """Name the motion files use for it."""
    v_template: np.ndarray
    """(V, 3) metres."""
    shapedirs: np.ndarray
    """(V, 3, 10) metres per unit of shape."""
    posedirs: np.ndarray | None
    """(V, 3, 9 (J - 1)) metres per unit of pose feature flatten(R_j - I), j = 1..J-1."""
    J_regressor: np.ndarray
    """(J, V), rows sum to 1."""
    weights: np.ndarray
    """(V, J), rows sum to 1."""
    faces: np.ndarray
    """(T, 3) vertex indices."""
    uv: np.ndarray | None = None
    """(V, 2) texture coordinates."""
    face_material: np.ndarray | None = None
    """(T,) index of each face's material."""
    blank_face: tuple[np.ndarray, np.ndarray] | None = None
    """(N,) vertices and (N, 3) metres that take the face away; None where the body has no such look."""
    layout: BodyLayout = SMPL
    """Names and tree of the J joints: SMPL's, or those with fingers."""
    flat_hands: np.ndarray | None = None
    """(30, 3, 3) rotations of finger bones from rest to a flat hand; None where a hand at rest is flat."""
    licence: str = ""
    """SPDX identifier, "" where the file states none."""

    def shaped(self, betas: np.ndarray) -> np.ndarray:
        """Return the (V, 3) vertices at rest, ``v_template + shapedirs @ betas`` (Loper et al. 2015, eq. 8)."""
        return self.v_template + self.shapedirs @ betas

    def rest_joints(self, betas: np.ndarray) -> np.ndarray:
        """Return the (J, 3) joints at rest, ``J_regressor @ shaped`` (Loper et al. 2015, eq. 10)."""
        return self.J_regressor @ self.shaped(betas)


def once_a_body(
    function: Callable[Concatenate[BodyFile, _Key], _Result],
) -> Callable[Concatenate[BodyFile, _Key], _Result]:
    """Let a function of a body and of hashable values compute each result once while that body is in use.

    Results are shared: nobody may write into them.
    """
    known: WeakKeyDictionary[BodyFile, dict[object, _Result]] = WeakKeyDictionary()

    @wraps(function)
    def call(body: BodyFile, *args: _Key.args, **kwargs: _Key.kwargs) -> _Result:
        results, key = known.setdefault(body, {}), (args, tuple(kwargs.items()))
        if key not in results:
            results[key] = function(body, *args, **kwargs)
        return results[key]

    return call


def default_body_path() -> Path:
    """Return the path of the body that ships with the solver.

    Raises:
        BackendMissing: the solver is not there.
    """
    return backend_folder() / PACKAGE / _ASSET


def read_body(path: Path, layout: BodyLayout = SMPL) -> BodyFile:
    """Read a body with SMPL's key names, of the SMPL, SMPL-H or SMPL-X family.

    The last two are kept while their files stay as they are, so that the next take on them finds what was computed
    once a body. Their arrays are read-only.

    Args:
        path: of the file.
        layout: which joints are kept: SMPL's 24, or ``SMPL_HANDS``'s with fingers, where the body has any.

    Raises:
        FileMissing, FileDamaged: see ``read_arrays``.
        BodyInvalid: an array has the wrong shape, another tree, or values that are not finite.
    """
    path = Path(path)
    if path.suffix.lower() == ".pkl":
        raise BodyInvalid(
            "Blender reads bodies from .npz files, not from pickles.", where=str(path), hint="Take the model's .npz."
        )
    fingers = layout.num_joints > SMPL.num_joints
    return _read(path, layout, (_state(path), _state(default_hands_path()) if fingers else None))


@lru_cache(maxsize=2)
def _read(path: Path, layout: BodyLayout, state: object) -> BodyFile:
    """Read a body; another ``state`` of its files is another body."""
    stored = read_arrays(path, required=_REQUIRED, optional=_OPTIONAL)
    _require_numbers(stored, path)
    if layout.num_joints > SMPL.num_joints and has_fingers(stored, default_hands_path()):
        arrays = add_finger_joints(stored, path, default_hands_path())
    else:
        arrays, layout = on_smpl_joints(stored, path), SMPL
    arrays["shapedirs"] = np.asarray(arrays["shapedirs"])[..., :NUM_BETAS]
    _check(arrays, path, layout)
    weights, fields = np.asarray(arrays["weights"], np.float64), Fields(path, arrays)
    posedirs, uv, material = (arrays.get(key) for key in ("posedirs", "uv", "face_material"))
    body = BodyFile(
        id=fields.text("body_id", path.stem),
        v_template=np.asarray(arrays["v_template"], np.float64),
        shapedirs=np.asarray(arrays["shapedirs"], np.float64),
        posedirs=posedirs,
        J_regressor=np.asarray(arrays["J_regressor"], np.float64),
        weights=weights / weights.sum(axis=1, keepdims=True),
        faces=np.asarray(arrays["f"]).astype(np.int64),
        uv=None if uv is None else np.asarray(uv, np.float64),
        face_material=None if material is None else np.asarray(material).astype(np.int64),
        blank_face=_blank_face(arrays),
        layout=layout,
        flat_hands=arrays.get("flat_hands"),
        licence=fields.text("license", _OWN_LICENCE if _ships_with_us(path) else ""),
    )
    for array in [*vars(body).values(), *(body.blank_face or ())]:
        if isinstance(array, np.ndarray):
            array.flags.writeable = False
    return body


def _state(path: Path) -> tuple[int, int] | None:
    """Return when a file was written and its size; None where it cannot be looked at, which reading names."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def default_hands_path() -> Path:
    """Return the path of the finger joints of the body that ships.

    Raises:
        BackendMissing: the solver is not there.
    """
    return default_body_path().with_name(HANDS_FILE)


def _blank_face(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
    if not set(_BLANK) <= set(arrays):
        return None
    vertices, offsets = (arrays[name] for name in _BLANK)
    return vertices.astype(np.int64), np.asarray(offsets, np.float32)


def _ships_with_us(path: Path) -> bool:
    return path.resolve().parts[-len(_ASSET.parts) :] == _ASSET.parts


def _require_numbers(arrays: dict[str, np.ndarray], path: Path) -> None:
    for key in set(arrays) - _TEXTS:
        if arrays[key].dtype.kind not in "fiub" or not arrays[key].ndim:
            raise BodyInvalid(
                f"{key} is {arrays[key].dtype} of shape {arrays[key].shape}; an array of numbers is expected.",
                where=str(path), hint="Take the model's own .npz, as it was downloaded.",
            )  # fmt: skip


def _check(arrays: dict[str, np.ndarray], path: Path, layout: BodyLayout) -> None:
    vertices, faces, joints = len(arrays["v_template"]), len(arrays["f"]), layout.num_joints
    shapes = {
        "v_template": (vertices, 3), "shapedirs": (vertices, 3, NUM_BETAS), "J_regressor": (joints, vertices),
        "weights": (vertices, joints), "kintree_table": (2, joints), "f": (faces, 3), "uv": (vertices, 2),
        "posedirs": (vertices, 3, 9 * (joints - 1)), "face_material": (faces,),
        "blank_offsets": (len(arrays.get("blank_vertices", ())), 3),
    }  # fmt: skip
    for key, shape in shapes.items():
        if key not in arrays:
            continue
        if arrays[key].shape != shape:
            raise BodyInvalid(f"{key} has shape {arrays[key].shape}; {shape} is expected.", where=str(path))
        if not np.isfinite(arrays[key]).all():
            raise BodyInvalid(f"{key} holds NaN or infinite values.", where=str(path))
    if not faces or arrays["f"].min() < 0 or arrays["f"].max() >= vertices:
        raise BodyInvalid(f"The faces must name vertices 0..{vertices - 1}.", where=str(path))
    blank = arrays.get("blank_vertices", np.zeros(1, int))
    if blank.ndim != 1 or not blank.size or blank.min() < 0 or blank.max() >= vertices:
        raise BodyInvalid(f"blank_vertices must name vertices 0..{vertices - 1}.", where=str(path))
    if (arrays["weights"].sum(axis=1) <= 0).any():
        raise BodyInvalid("A vertex has no skinning weight.", where=str(path))
    if tuple(arrays["kintree_table"][0].astype(np.int64)[1:]) != layout.parents[1:]:
        raise BodyInvalid("The tree is not SMPL's tree of joints.", where=str(path))
