"""The body model: template, shape and pose blend shapes, skinning weights, kinematic tree."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from solver_backend.errors import BodyInvalid
from solver_backend.types import NUM_BETAS, NUM_JOINTS

DEFAULT_BODY = Path(__file__).parents[1] / "assets" / "body_neutral.npz"
_REQUIRED = ("v_template", "shapedirs", "J_regressor", "weights", "kintree_table", "f")


@dataclass(frozen=True)
class Body:
    """A skinned, shaped and corrected body in its rest frame: Y up, facing +Z, left = +X, metres.

    ``v(betas) = v_template + shapedirs @ betas`` and ``J(betas) = J_regressor @ v(betas)`` (Loper et al. 2015, eqs. 8, 10).
    """

    id: str
    """Name written to Motion files."""
    v_template: np.ndarray
    """(V, 3) metres."""
    shapedirs: np.ndarray
    """(V, 3, 10) metres per unit of shape."""
    posedirs: np.ndarray
    """(V, 3, 207) metres per unit of pose feature flatten(R_j - I), j = 1..23."""
    J_regressor: np.ndarray
    """(24, V), rows sum to 1."""
    weights: np.ndarray
    """(V, 24), rows sum to 1."""
    parents: tuple[int, ...]
    """Parent of each joint; -1 at the root."""
    faces: np.ndarray
    """(T, 3) vertex indices."""
    joints_template: np.ndarray = field(init=False)
    """(24, 3) rest joints of the mean shape."""
    joints_shapedirs: np.ndarray = field(init=False)
    """(24, 3, 10) metres per unit of shape."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints_template", self.J_regressor @ self.v_template)
        directions = np.tensordot(self.J_regressor, self.shapedirs, axes=(1, 0))
        object.__setattr__(self, "joints_shapedirs", directions)

    def rest_joints(self, betas: np.ndarray) -> np.ndarray:
        """Return the (24, 3) rest joints of a shape."""
        return self.joints_template + self.joints_shapedirs @ np.asarray(betas, dtype=np.float64)

    @property
    def stature_m(self) -> float:
        """Height of the mean shape in metres."""
        return float(np.ptp(self.v_template[:, 1]))


def load_body(path: Path | None = None) -> Body:
    """Read a body from an ``.npz`` with SMPL's key names.

    Raises:
        BodyInvalid: keys are missing, shapes or joint counts are wrong, or values are not finite.
    """
    return _load_body(Path(path) if path is not None else DEFAULT_BODY)


@lru_cache(maxsize=4)
def _load_body(path: Path) -> Body:
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {key: data[key] for key in data.files}
    except (OSError, ValueError, KeyError) as error:
        raise BodyInvalid(f"The body file cannot be read: {error}", where=str(path)) from error
    missing = [key for key in _REQUIRED if key not in arrays]
    if missing:
        raise BodyInvalid(
            f"The body file lacks {', '.join(missing)}; found {', '.join(sorted(arrays))}.",
            where=str(path),
            hint=f"A body file holds {', '.join(_REQUIRED)}.",
        )
    return body_from_arrays(arrays, where=str(path), default_id=path.stem)


def body_from_arrays(arrays: dict[str, np.ndarray], *, where: str, default_id: str) -> Body:
    """Check SMPL-named arrays and build a body.

    Raises:
        BodyInvalid: an array has the wrong shape, the wrong number of joints, or values that are not finite.
    """
    v_template = np.asarray(arrays["v_template"], dtype=np.float64)
    count = len(v_template)
    posedirs = arrays.get("posedirs")
    if posedirs is None:
        posedirs = np.zeros((count, 3, 9 * (NUM_JOINTS - 1)))
    expected = {
        "v_template": (v_template, (count, 3)),
        "shapedirs": (np.asarray(arrays["shapedirs"], dtype=np.float64)[..., :NUM_BETAS], (count, 3, NUM_BETAS)),
        "posedirs": (np.asarray(posedirs, dtype=np.float64), (count, 3, 9 * (NUM_JOINTS - 1))),
        "J_regressor": (np.asarray(arrays["J_regressor"], dtype=np.float64), (NUM_JOINTS, count)),
        "weights": (np.asarray(arrays["weights"], dtype=np.float64), (count, NUM_JOINTS)),
        "kintree_table": (np.asarray(arrays["kintree_table"]).astype(np.int64), (2, NUM_JOINTS)),
    }
    for name, (value, shape) in expected.items():
        if value.shape != shape:
            raise BodyInvalid(f"{name} has shape {value.shape}; {shape} is expected.", where=where)
        if not np.isfinite(value).all():
            raise BodyInvalid(f"{name} holds NaN or infinite values.", where=where)
    parents = tuple(-1 if p > NUM_JOINTS or p < 0 else int(p) for p in expected["kintree_table"][0][0])
    if any(p >= j for j, p in enumerate(parents)):
        raise BodyInvalid(f"Parents {parents} do not come before their children.", where=where)
    weights = expected["weights"][0]
    return Body(
        id=str(arrays["body_id"]) if "body_id" in arrays else default_id,
        v_template=v_template,
        shapedirs=expected["shapedirs"][0],
        posedirs=expected["posedirs"][0],
        J_regressor=expected["J_regressor"][0],
        weights=weights / weights.sum(axis=1, keepdims=True),
        parents=parents,
        faces=np.asarray(arrays["f"]).astype(np.int64),
    )
