"""SMPL-H and SMPL-X bodies on SMPL's joints: fingers go with the hand, jaw and eyes with the head."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .._exchange.body_layout import FAMILY, SMPL
from .._exchange.errors import BodyInvalid


def on_smpl_joints(arrays: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an SMPL-H or SMPL-X body with SMPL's joints; those of other bodies as they are.

    With flat hands the skin is the same: correctives of fingers, jaw and eyes vanish at rest and are left out.

    Args:
        arrays: with SMPL's keys.
        path: of the file, for errors.

    Raises:
        BodyInvalid: the arrays are no such body.
    """
    tree = np.asarray(arrays["kintree_table"])
    count = tree.shape[1] if tree.ndim == 2 and len(tree) == 2 else 0
    if count not in FAMILY or FAMILY[count] is SMPL:
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
