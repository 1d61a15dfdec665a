"""A body's finger joints: our own body's from the file of its hands, SMPL-H's and SMPL-X's from their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .._exchange.body_layout import FAMILY, SMPL_HANDS
from .._exchange.errors import BodyInvalid
from .._exchange.finger_joints import HANDS_KEYS, Skinning, needs_hands_file, with_finger_joints
from .._exchange.npz import read_arrays


def has_fingers(arrays: dict[str, np.ndarray], hands_file: Path) -> bool:
    """Return whether a body has finger joints, its own or in the file of the hands of the body that ships.

    Args:
        arrays: with SMPL's keys.
        hands_file: finger joints of the body that ships.
    """
    given = FAMILY.get(_joint_count(arrays))
    if given is None or not needs_hands_file(given):
        return given is not None
    hands = read_arrays(hands_file, required=("body_id",))
    return "body_id" in arrays and str(arrays["body_id"]) == str(hands["body_id"])


def add_finger_joints(arrays: dict[str, np.ndarray], path: Path, hands_file: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a body with SMPL's keys on the joints of ``SMPL_HANDS``.

    Args:
        arrays: with SMPL's keys, of a body of SMPL's, SMPL-H's or SMPL-X's joints.
        path: of the file, for errors.
        hands_file: finger joints of the body that ships.

    Raises:
        BodyInvalid: the arrays are no such body, or it has no fingers.
    """
    tree, vertices, count = np.asarray(arrays["kintree_table"]), len(arrays["v_template"]), _joint_count(arrays)
    if count not in FAMILY:
        raise BodyInvalid(f"A body of {count} joints has no fingers that are known.", where=str(path))
    features = 9 * (count - 1)
    shapes = {"J_regressor": (count, vertices), "weights": (vertices, count), "posedirs": (vertices, 3, features)}
    for key, shape in shapes.items():
        if key in arrays and np.shape(arrays[key]) != shape:
            raise BodyInvalid(f"{key} has shape {np.shape(arrays[key])}; {shape} is expected.", where=str(path))
    given = FAMILY[count]
    if tuple(tree[0].astype(np.int64)[1:]) != given.parents[1:]:
        raise BodyInvalid(f"The tree is not {given.name}'s tree of joints.", where=str(path))
    hands = read_arrays(hands_file, required=HANDS_KEYS) if needs_hands_file(given) else None
    weights, regressor = (np.asarray(arrays[key], np.float64) for key in ("weights", "J_regressor"))
    own = Skinning(weights, regressor, arrays.get("posedirs"))
    body_id = str(arrays["body_id"]) if "body_id" in arrays else path.stem
    found = with_finger_joints(given, own, body_id, hands)
    reduced = {
        **arrays, "weights": found.weights, "J_regressor": found.J_regressor,
        "kintree_table": np.array([SMPL_HANDS.parents, range(SMPL_HANDS.num_joints)]),
    }  # fmt: skip
    if hands is not None:
        reduced["flat_hands"] = np.asarray(hands["flat"], np.float64)
    return reduced if found.posedirs is None else {**reduced, "posedirs": found.posedirs}


def _joint_count(arrays: dict[str, np.ndarray]) -> int:
    tree = np.asarray(arrays["kintree_table"])
    return tree.shape[1] if tree.ndim == 2 and len(tree) == 2 else 0
