"""SMPL-H and SMPL-X bodies on SMPL's 24 joints: fingers go with the hand, jaw and eyes with the head."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .._exchange.errors import BodyInvalid
from ..conventions.skeleton import NUM_JOINTS, PARENTS

_BODY = 22
"""Joints that the whole family shares."""
_MIDDLE_FINGERS = {52: (25, 40), 55: (28, 43)}
"""Roots of the left and right middle finger, which stand for SMPL's hands, by number of joints."""
_CARRIED_BY = {15: 15, 20: 22, 21: 23}
"""Joint that carries what hangs on the head, the left wrist and the right wrist."""


def on_24_joints(arrays: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an SMPL-H or SMPL-X body with 24 joints; those of other bodies as they are.

    With flat hands the skin is the same: correctives of fingers, jaw and eyes vanish at rest and are left out.

    Args:
        arrays: with SMPL's keys.
        path: of the file, for errors.

    Raises:
        BodyInvalid: the arrays are no such body.
    """
    tree = np.asarray(arrays["kintree_table"])
    count = tree.shape[1] if tree.ndim == 2 and len(tree) == 2 else 0
    if count not in _MIDDLE_FINGERS:
        return arrays
    parents, vertices = tree[0].astype(np.int64), len(arrays["v_template"])
    shapes = {
        "J_regressor": (count, vertices),
        "weights": (vertices, count),
        "posedirs": (vertices, 3, 9 * (count - 1)),
    }
    for key, shape in shapes.items():
        if key in arrays and arrays[key].shape != shape:
            raise BodyInvalid(f"{key} has shape {arrays[key].shape}; {shape} is expected.", where=str(path))
    if (parents[1:] >= np.arange(1, count)).any() or (parents[1:] < 0).any():
        raise BodyInvalid("A joint comes before its parent.", where=str(path))
    carrier = [*range(_BODY)]
    for joint in range(_BODY, count):
        above = int(parents[joint])
        carrier.append(carrier[above] if above >= _BODY else _CARRIED_BY.get(above, above))
    weights = np.zeros((vertices, NUM_JOINTS))
    np.add.at(weights.T, carrier, np.asarray(arrays["weights"], np.float64).T)
    rows = [*range(_BODY), *_MIDDLE_FINGERS[count]]
    reduced = {
        **arrays,
        "weights": weights,
        "J_regressor": np.asarray(arrays["J_regressor"])[rows],
        "kintree_table": np.array([[*parents[:_BODY], *PARENTS[_BODY:]], range(NUM_JOINTS)]),
    }
    if "posedirs" in arrays:
        body = np.asarray(arrays["posedirs"])[:, :, : 9 * (_BODY - 1)]
        reduced["posedirs"] = np.concatenate([body, np.zeros((vertices, 3, 9 * (NUM_JOINTS - _BODY)))], axis=2)
    return reduced
