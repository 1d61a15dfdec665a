"""Define the body model: template, shape and pose blend shapes, skinning weights, and kinematic tree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.body_layout import FAMILY, BodyLayout
from solver_backend.exchange.errors import BodyInvalid, FileDamaged, FileMissing
from solver_backend.exchange.npz import read_npz
from solver_backend.types import NUM_BETAS
from solver_backend.types.shapes import Float, Int

DEFAULT_BODY = Path(__file__).parents[1] / "assets" / "body_neutral.npz"
REQUIRED_KEYS = ("v_template", "shapedirs", "J_regressor", "weights", "kintree_table", "f")
_LAYOUT_KEYS = ("joint_names", "joint_groups")  # For bodies outside the SMPL family: name and group of each joint.
_READ_KEYS = frozenset({*REQUIRED_KEYS, *_LAYOUT_KEYS, "posedirs", "body_id"})


@dataclass(frozen=True, eq=False)
class Body:
    """A skinned body with shape and pose correctives, in metres, Y up and facing +Z.

    ``v(betas) = v_template + shapedirs @ betas`` and ``J(betas) = J_regressor @ v(betas)`` (Loper et al. 2015).
    """

    id: str
    v_template: Float[np.ndarray, "vertices 3"]
    """(V, 3) vertices of the mean shape in metres."""
    shapedirs: Float[np.ndarray, "vertices 3 10"]
    """(V, 3, 10) derivatives of the vertices w.r.t. the shape, in metres per unit."""
    posedirs: Float[np.ndarray, "vertices 3 features"]
    """(V, 3, 9 (J - 1)) pose correctives in metres per unit of the pose feature flatten(R_j - I), j = 1..J-1."""
    J_regressor: Float[np.ndarray, "joints vertices"]
    """(J, V) weights of the vertices in each joint position. Rows sum to 1."""
    weights: Float[np.ndarray, "vertices joints"]
    """(V, J) skinning weights. Rows sum to 1."""
    layout: BodyLayout
    faces: Int[np.ndarray, "triangles 3"]
    """(T, 3) vertex indices of the triangles."""
    hands_mean: Float[np.ndarray, "hand_joints 3"] | None = None
    """(r, 3) axis-angles of the relaxed hands of SMPL-H and SMPL-X, added to the r joints that a solve leaves at rest.
    None for flat hands."""
    joints_template: Float[np.ndarray, "joints 3"] = field(init=False)
    """(J, 3) rest joints of the mean shape, in metres."""
    joints_shapedirs: Float[np.ndarray, "joints 3 10"] = field(init=False)
    """(J, 3, 10) derivatives of the rest joints w.r.t. the shape, in metres per unit."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints_template", self.J_regressor @ self.v_template)
        object.__setattr__(self, "joints_shapedirs", np.tensordot(self.J_regressor, self.shapedirs, axes=(1, 0)))

    def rest_joints(self, betas: Float[np.ndarray, " 10"]) -> Float[np.ndarray, "joints 3"]:
        """Return the (J, 3) rest joint positions in metres for a body shape."""
        return self.joints_template + self.joints_shapedirs @ np.asarray(betas, dtype=np.float64)

    @property
    def parents(self) -> tuple[int, ...]:
        """Parent of each joint, -1 for the root."""
        return self.layout.parents

    @cached_property
    def recorded_joints(self) -> tuple[int, ...]:
        """Joints that motions of this body store. For the SMPL family, these are SMPL's joints."""
        return self.layout.standing_for(self.layout.recorded)

    @property
    def stature_m(self) -> float:
        """Height of the mean shape in metres."""
        return float(np.ptp(self.v_template[:, 1]))

    def stature_of(self, betas: np.ndarray) -> float:
        """Return the height in metres of the body with (10,) shape coefficients."""
        return float(np.ptp(self.v_template[:, 1] + self.shapedirs[:, 1] @ betas))


def load_body(path: Path | None = None) -> Body:
    """Read a body file (``docs/reference/body-file.md``), by default the built-in one, or raise ``BodyInvalid``."""
    return _load_body(Path(path) if path is not None else DEFAULT_BODY)


@lru_cache(maxsize=4)
def _load_body(path: Path) -> Body:
    try:
        arrays = read_npz(path, _READ_KEYS.__contains__)
    except (FileMissing, FileDamaged) as error:
        raise BodyInvalid(f"The body file cannot be read: {error.message}", where=str(path)) from error
    return body_from_arrays(arrays, where=str(path), default_id=path.stem)


def body_from_arrays(arrays: Mapping[str, Any], *, where: str, default_id: str) -> Body:
    """Check arrays with SMPL's names, and create a body from them.

    Raises:
        BodyInvalid: an array is missing, not finite or misshapen, a face refers to an unknown vertex, or the joints do
          not form a tree in which parents come first.
    """
    if missing := [key for key in REQUIRED_KEYS if key not in arrays]:
        what = f"The body file does not contain {', '.join(missing)}. It contains {', '.join(sorted(arrays))}."
        raise BodyInvalid(what, where=where, hint=f"A body file contains {', '.join(REQUIRED_KEYS)}.")
    body_id = str(arrays["body_id"]) if "body_id" in arrays else default_id
    names, groups = (arrays.get(key) for key in _LAYOUT_KEYS)
    arrays = {key: _numbers(key, arrays[key], where) for key in (*REQUIRED_KEYS, "posedirs") if key in arrays}
    v_template, kintree = arrays["v_template"], _whole(arrays["kintree_table"])
    count, num_joints = len(v_template), kintree.shape[-1] if kintree.ndim == 2 and len(kintree) else 0
    parents = tuple(-1 if p >= num_joints or p < 0 else int(p) for p in kintree[0]) if num_joints else ()
    layout = _layout(body_id, parents, names, groups, where)
    posedirs = arrays.get("posedirs")
    if posedirs is None:
        posedirs = np.zeros((count, 3, 9 * (num_joints - 1)))
    if np.shape(posedirs)[-1] == 93:
        what = "STAR models are not supported, because their 93 pose correctives use another formula."
        raise BodyInvalid(what, where=where, hint="Use the SMPL, SMPL-H or SMPL-X file of the same body.")
    expected = {
        "v_template": (v_template, (count, 3)),
        "shapedirs": (arrays["shapedirs"][..., :NUM_BETAS], (count, 3, NUM_BETAS)),
        "posedirs": (posedirs, (count, 3, 9 * (num_joints - 1))),
        "J_regressor": (arrays["J_regressor"], (num_joints, count)),
        "weights": (arrays["weights"], (count, num_joints)),
        "kintree_table": (kintree, (2, num_joints)),
    }
    for name, (value, shape) in expected.items():
        if value.shape != shape:
            raise BodyInvalid(f"{name} has shape {value.shape}, but {shape} is expected.", where=where)
    weights, shares = arrays["weights"], arrays["weights"].sum(axis=1, keepdims=True)
    if count == 0 or shares.min() <= 0:
        raise BodyInvalid("'weights' has vertices without a joint. Every row must sum to 1.", where=where)
    faces = _whole(arrays["f"])
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.min(initial=0) < 0 or faces.max(initial=0) >= count:
        found = f"f has shape {faces.shape} and entries {faces.min(initial=0)} to {faces.max(initial=0)}"
        raise BodyInvalid(f"{found}, but (triangles, 3) with vertices 0 to {count - 1} is expected.", where=where)
    checked = {name: expected[name][0] for name in ("v_template", "shapedirs", "posedirs", "J_regressor")}
    return Body(id=body_id, **checked, weights=weights / shares, layout=layout, faces=faces)


def _whole(values: np.ndarray) -> np.ndarray:
    """Convert numbers to indices. Numbers beyond 32 bits become an invalid index instead of wrapping around."""
    return np.clip(np.asarray(values, np.float64), -1, 2**32).astype(np.int64)


def _layout(
    body_id: str, parents: tuple[int, ...], names: np.ndarray | None, groups: np.ndarray | None, where: str
) -> BodyLayout:
    try:
        if names is not None:
            own = tuple(str(name) for name in np.ravel(names))
            return BodyLayout(body_id, own, parents, own if groups is None else tuple(map(str, np.ravel(groups))))
        if len(parents) in FAMILY:
            return replace(FAMILY[len(parents)], parents=parents)
    except BodyInvalid as error:
        raise BodyInvalid(error.message, where=where, hint=error.hint) from error
    known = ", ".join(f"{count} ({layout.name})" for count, layout in FAMILY.items())
    hint = "If the body is not of the SMPL family, name its joints in joint_names. See docs/reference/body-file.md."
    raise BodyInvalid(f"kintree_table has {len(parents)} joints, but {known} are expected.", where=where, hint=hint)


def _numbers(name: str, value: Any, where: str) -> np.ndarray:
    value = np.asarray(value)
    if value.ndim == 0 or value.dtype.kind not in "fiub":
        raise BodyInvalid(
            f"{name} contains {value.dtype} of shape {value.shape}, but numbers are expected.", where=where
        )
    if not np.isfinite(value).all():
        raise BodyInvalid(f"{name} contains NaN or infinite values.", where=where)
    return value.astype(np.float64)
