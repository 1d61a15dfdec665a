"""Our posing of SMPL, SMPL-H and SMPL-X files against the package ``body-models``, to a micrometre."""

import numpy as np
import pytest

from solver_backend.body.files.choices import load_smpl_file
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.geometry.rotations import exp_so3
from tests.body.oracle import CASES, GOLDEN, body_models_vertices, model, state


def our_vertices(family, flat, folder):
    np.savez(folder / "model.npz", **model(family))
    body, given = load_smpl_file(folder / "model.npz", family=family, flat_hands=flat), state(family)
    root, turns = exp_so3(given["rotvec"][:, 0]), given["rotvec"][:, 1:].copy()
    if body.hands_mean is not None:  # added to the axis-angle vector, before it becomes a rotation (Romero et al. 2017)
        turns[:, body.layout.num_solved :] += body.hands_mean
    return pose_mesh(body, given["betas"], root, exp_so3(turns), given["transl"])


@pytest.mark.parametrize(("family", "flat"), CASES)
def test_kept_answers(family, flat, tmp_path):
    with np.load(GOLDEN) as golden:
        expected = golden[f"{family} {'flat' if flat else 'relaxed'}"]
    np.testing.assert_allclose(our_vertices(family, flat, tmp_path), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize(("family", "flat"), CASES)
def test_live_answers(family, flat, tmp_path):
    pytest.importorskip("body_models", reason="body-models needs NumPy 2; its kept answers are tested")
    expected = body_models_vertices(family, flat)
    np.testing.assert_allclose(our_vertices(family, flat, tmp_path), expected, atol=1e-6, rtol=0)


def test_relaxed_hands_matter_and_bodies_without_are_named(tmp_path):
    flat, relaxed = (our_vertices("SMPL-X", flat, tmp_path) for flat in (True, False))
    assert np.abs(flat - relaxed).max() > 0.01
    arrays = model("SMPL-X")
    del arrays["hands_meanl"]
    np.savez(tmp_path / "model.npz", **arrays)
    with pytest.raises(BodyInvalid, match=r"no relaxed hand pose \(hands_meanl, hands_meanr\)"):
        load_smpl_file(tmp_path / "model.npz", flat_hands=False)
    np.savez(tmp_path / "model.npz", **{**model("SMPL-X"), "hands_meanr": np.zeros(12)})
    with pytest.raises(
        BodyInvalid, match=r"hands_meanr is float64 of shape \(12,\), but 45 finite numbers are expected"
    ):
        load_smpl_file(tmp_path / "model.npz", flat_hands=False)
