"""SMPL-H and SMPL-X files become bodies of 24 joints with the same skin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from blender_addon._exchange.errors import BodyInvalid
from blender_addon._exchange.motion_file import MotionFile
from blender_addon.body.body_file import default_body_path, read_body, skin
from solver_backend.body.body import load_body
from solver_backend.body.mesh import pose_mesh
from solver_backend.geometry.rotations import exp_so3


def family_file(path: Path, joints: int) -> Path:
    """Write our body as SMPL-H or SMPL-X: fingers, jaw and eyes share their parents' skin."""
    rng = np.random.default_rng(0)
    with np.load(default_body_path(), allow_pickle=False) as data:
        arrays = {key: data[key] for key in ("v_template", "shapedirs", "J_regressor", "weights", "posedirs", "f")}
    parents = [0, *np.load(default_body_path())["kintree_table"][0][1:22].astype(int)]
    parents += [15] * 3 if joints == 55 else []
    for wrist in (20, 21):
        for _ in range(5):
            parents += [wrist, len(parents), len(parents) + 1]
    extra = joints - 22
    weights = np.zeros((len(arrays["weights"]), joints))
    weights[:, :22] = arrays["weights"][:, :22]
    for j, hand in enumerate(arrays["weights"][:, 22:].T):
        first = joints - 30 + 15 * j
        share = rng.dirichlet(np.ones(15), size=len(hand))
        weights[:, first : first + 15] = hand[:, None] * share
    if joints == 55:
        weights[:, 22:25] = 0.1 * weights[:, 15:16]
        weights[:, 15] *= 0.7
    regressor = np.concatenate(
        [arrays["J_regressor"][:22], np.repeat(arrays["J_regressor"][22:], extra // 2 + 1, 0)[:extra]]
    )
    posedirs = np.zeros((len(weights), 3, 9 * (joints - 1)), np.float32)
    posedirs[:, :, :189] = arrays["posedirs"][:, :, :189]
    kintree = np.array([[2**32 - 1, *parents[1:]], range(joints)])
    np.savez(
        path, **{**arrays, "weights": weights, "J_regressor": regressor, "posedirs": posedirs, "kintree_table": kintree}
    )
    return path


@pytest.mark.parametrize("joints", [52, 55])
def test_skin_is_the_solvers(tmp_path: Path, joints: int) -> None:
    path = family_file(tmp_path / "model.npz", joints)
    ours, theirs = read_body(path), load_body(path)
    assert ours.weights.shape[1] == 24 and len(theirs.parents) == joints
    rng = np.random.default_rng(1)
    rotvec, betas = 0.4 * rng.normal(size=(2, 24, 3)), rng.normal(size=10)
    rotvec[:, 22:] = 0.0
    motion = MotionFile("m", rotvec, rng.normal(size=(2, 3)), betas, fps=30.0)
    local = exp_so3(np.concatenate([rotvec[:, 1:22], np.zeros((2, joints - 22, 3))], axis=1))
    expected = pose_mesh(theirs, betas, exp_so3(rotvec[:, 0]), local, motion.transl)
    np.testing.assert_allclose(skin(ours, motion, [0, 1]), expected, atol=1e-6)
    np.testing.assert_allclose(
        ours.rest_joints(betas), theirs.rest_joints(betas)[list(theirs.recorded_joints)], atol=1e-9
    )


def test_wrong_arrays_and_pickles_are_named(tmp_path: Path) -> None:
    path = family_file(tmp_path / "model.npz", 52)
    arrays = dict(np.load(path))
    np.savez(path, **{**arrays, "weights": arrays["weights"][:, :50]})
    with pytest.raises(BodyInvalid, match=r"weights has shape \(\d+, 50\), but \(\d+, 52\) is expected"):
        read_body(path)
    (tmp_path / "model.pkl").write_bytes(b"x")
    with pytest.raises(BodyInvalid, match="not from pickles"):
        read_body(tmp_path / "model.pkl")
