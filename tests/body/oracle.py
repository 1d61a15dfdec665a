"""Vertices of made-up SMPL, SMPL-H and SMPL-X models as the pip package ``body-models`` computes them.

The models are sines of their indices: the same numbers on every machine, and of the right shape. ``body-models`` needs
NumPy 2, which the Blender 4.5 module does not bear, so its answers are kept in ``oracle.npz``. To make them again, in
an environment of its own: ``pip install body-models && python -m tests.body.oracle``.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

GOLDEN = Path(__file__).with_name("oracle.npz")
VERTICES, FRAMES = 40, 3
_TREE = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
_HAND = [0, 22, 23, 0, 25, 26, 0, 28, 29, 0, 31, 32, 0, 34, 35]


def _with_hands(before: list[int]) -> list[int]:
    shift = len(before) - 22
    left = [p + shift if p else 20 for p in _HAND]
    return [*before, *left, *(p + 15 if p != 20 else 21 for p in left)]


PARENTS = {"SMPL": [*_TREE, 20, 21], "SMPL-H": _with_hands(_TREE), "SMPL-X": _with_hands([*_TREE, 15, 15, 15])}
CASES = (("SMPL", True), ("SMPL-H", True), ("SMPL-H", False), ("SMPL-X", True), ("SMPL-X", False))
"""Family, and whether its hands are flat."""


def waves(*shape: int, phase: float) -> np.ndarray:
    """Return sines in float32, so that both readers see the same numbers."""
    count = int(np.prod(shape))
    return (
        np.sin(1.7 * np.arange(count) + phase + 0.3 * np.sin(0.37 * np.arange(count))).astype(np.float32).reshape(shape)
    )


def model(family: str) -> dict[str, np.ndarray]:
    """Return a model file's arrays."""
    parents = PARENTS[family]
    joints, num_shapes = len(parents), 400 if family == "SMPL-X" else 10
    weights, regressor = np.abs(waves(VERTICES, joints, phase=0.1)), np.abs(waves(joints, VERTICES, phase=0.2))
    weights = np.where(weights >= np.sort(weights, axis=1)[:, -4:-3], weights, 0)
    return {
        "v_template": 0.5 * waves(VERTICES, 3, phase=0.3),
        "shapedirs": np.float32(0.03) * waves(VERTICES, 3, num_shapes, phase=0.4),
        "posedirs": np.float32(0.01) * waves(VERTICES, 3, 9 * (joints - 1), phase=0.5),
        "J_regressor": (regressor / regressor.sum(1, keepdims=True)).astype(np.float32),
        "weights": (weights / weights.sum(1, keepdims=True)).astype(np.float32),
        "kintree_table": np.array([[4294967295, *parents[1:]], range(joints)], dtype=np.uint32),
        "f": (np.arange(90).reshape(30, 3) % VERTICES).astype(np.uint32),
        "hands_meanl": 0.5 * waves(45, phase=0.6),
        "hands_meanr": 0.5 * waves(45, phase=0.7),
        "joint2num": np.array({f"joint_{j}": j for j in range(joints)}, dtype=object),
    }


def state(family: str) -> dict[str, np.ndarray]:
    """Return shape, axis-angles of all joints and translation."""
    joints = len(PARENTS[family])
    return {
        "betas": waves(10, phase=0.8).astype(np.float64),
        "rotvec": 0.9 * waves(FRAMES, joints, 3, phase=0.9).astype(np.float64),
        "transl": waves(FRAMES, 3, phase=1.0).astype(np.float64),
    }


def body_models_vertices(family: str, flat: bool) -> np.ndarray:
    """Return the (F, V, 3) vertices that ``body-models`` computes."""
    from body_models.smpl.numpy import SMPL
    from body_models.smplh.numpy import SMPLH
    from body_models.smplx.numpy import SMPLX

    given = state(family)
    rotvec = given["rotvec"]
    pose = {"pelvis_rotation": rotvec[:, 0], "body_pose": rotvec[:, 1:22]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.npz"
        np.savez(path, **model(family))
        if family == "SMPL":
            pose["body_pose"], oracle = rotvec[:, 1:], SMPL(model_path=path)
        elif family == "SMPL-H":
            pose["hand_pose"], oracle = rotvec[:, 22:], SMPLH(model_path=path, flat_hand_mean=flat)
        else:
            pose |= {"head_pose": rotvec[:, 22:25], "hand_pose": rotvec[:, 25:], "expression": np.zeros((FRAMES, 10))}
            oracle = SMPLX(model_path=path, flat_hand_mean=flat)
    shape = np.tile(given["betas"], (FRAMES, 1))
    return np.asarray(oracle.forward_vertices(**pose, shape=shape, global_translation=given["transl"]))


if __name__ == "__main__":
    np.savez_compressed(
        GOLDEN, **{f"{f} {'flat' if flat else 'relaxed'}": body_models_vertices(f, flat) for f, flat in CASES}
    )
