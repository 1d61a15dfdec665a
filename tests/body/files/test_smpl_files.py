"""SMPL-family files: what loads, what is refused, and that nothing runs."""

import os
import pickle
import sys
import types

import numpy as np
import pytest

from solver_backend.body.files.choices import load_smpl_file
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.errors import BodyInvalid, UnsafePickle
from solver_backend.types import SMPL_PARENTS

_PARENTS_H = [*SMPL_PARENTS[:22]] + [20, 22, 23, 20, 25, 26, 20, 28, 29, 20, 31, 32, 20, 34, 35]
_PARENTS_H += [21, 37, 38, 21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50]
_PARENTS_X = [*SMPL_PARENTS[:22], 15, 15, 15] + [p + 3 if p > 21 else p for p in _PARENTS_H[22:]]
PARENTS = {"SMPL": list(SMPL_PARENTS), "SMPL-H": _PARENTS_H, "SMPL-X": _PARENTS_X}


def random_model(family: str, vertices: int = 60, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    parents = PARENTS[family]
    joints = len(parents)
    kintree = np.array([[4294967295, *parents[1:]], range(joints)], dtype=np.uint32)
    return {
        "v_template": rng.normal(size=(vertices, 3)), "shapedirs": 0.1 * rng.normal(size=(vertices, 3, 16)),
        "posedirs": 0.01 * rng.normal(size=(vertices, 3, 9 * (joints - 1))),
        "J_regressor": rng.dirichlet(np.ones(vertices), size=joints),
        "weights": rng.dirichlet(np.ones(joints), size=vertices),
        "kintree_table": kintree, "f": rng.integers(0, vertices, (20, 3)).astype(np.uint32),
    }  # fmt: skip


@pytest.mark.parametrize("family", PARENTS)
def test_npz_of_every_family(family, tmp_path):
    arrays = random_model(family)
    np.savez(tmp_path / "model.npz", **arrays)
    body = load_smpl_file(tmp_path / "model.npz", family=family)
    assert body.layout.name == family and body.parents == (-1, *PARENTS[family][1:])
    np.testing.assert_array_equal(body.shapedirs, arrays["shapedirs"][..., :10])
    identity = np.tile(np.eye(3), (1, len(body.parents) - 1, 1, 1))
    joints = forward_kinematics(body, np.zeros(10), np.eye(3)[None], identity, np.zeros((1, 3))).joints[0]
    np.testing.assert_allclose(joints, arrays["J_regressor"] @ arrays["v_template"], atol=1e-12)
    assert len(body.recorded_joints) == 24


class _FakeModules:
    """chumpy and SciPy's old path, only while a test file is written."""

    def __init__(self, monkeypatch) -> None:
        self.ch, self.csc = types.ModuleType("chumpy.ch"), types.ModuleType("scipy.sparse.csc")
        vars(self.ch)["Ch"] = type("Ch", (), {"__module__": "chumpy.ch"})
        vars(self.csc)["csc_matrix"] = type("csc_matrix", (), {"__module__": "scipy.sparse.csc"})
        for name, module in (
            ("chumpy", types.ModuleType("chumpy")),
            ("chumpy.ch", self.ch),
            ("scipy.sparse.csc", self.csc),
        ):
            monkeypatch.setitem(sys.modules, name, module)


def test_old_pickle_with_chumpy_and_sparse_arrays(tmp_path, monkeypatch):
    sparse = pytest.importorskip("scipy.sparse")
    arrays = random_model("SMPL")
    with monkeypatch.context() as patch:
        fake = _FakeModules(patch)
        shaped = fake.ch.Ch()
        shaped.__dict__.update(x=arrays["shapedirs"])
        chosen = fake.ch.Ch()
        chosen.__dict__.update(a=arrays["v_template"], idxs=np.arange(180), preferred_shape=(60, 3))
        matrix = sparse.csc_matrix(arrays["J_regressor"])
        regressor = fake.csc.csc_matrix()
        regressor.__dict__.update(
            data=matrix.data, indices=matrix.indices, indptr=matrix.indptr, _shape=arrays["J_regressor"].shape
        )
        content = {**arrays, "shapedirs": shaped, "v_template": chosen, "J_regressor": regressor}
        (tmp_path / "model.pkl").write_bytes(pickle.dumps(content, protocol=2))
    body = load_smpl_file(tmp_path / "model.pkl")
    np.testing.assert_allclose(body.v_template, arrays["v_template"])
    np.testing.assert_allclose(body.J_regressor, arrays["J_regressor"])
    np.testing.assert_allclose(body.shapedirs, arrays["shapedirs"][..., :10])


def test_pickle_that_runs_code_is_refused_and_does_not_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "pwned"),)

    (tmp_path / "evil.pkl").write_bytes(pickle.dumps({"v_template": Evil()}))
    with pytest.raises(UnsafePickle, match=r"asks for (posix|nt)\.mkdir.*No code was run"):
        load_smpl_file(tmp_path / "evil.pkl")
    assert not (tmp_path / "pwned").exists()


def test_code_hidden_in_an_object_array_is_refused(tmp_path):
    class Evil:
        def __reduce__(self):
            return eval, ("1 + 1",)

    array = np.empty(1, dtype=object)
    array[0] = Evil()
    (tmp_path / "evil.pkl").write_bytes(pickle.dumps({"v_template": array}))
    with pytest.raises(UnsafePickle, match=r"builtins\.eval"):
        load_smpl_file(tmp_path / "evil.pkl")


@pytest.mark.parametrize("hands", [np.array("x" * 50), np.array([b"\xff"] * 45), np.zeros(44)])
def test_relaxed_hands_that_are_no_45_numbers_are_named(hands, tmp_path):
    np.savez(tmp_path / "model.npz", **{**random_model("SMPL-H"), "hands_meanl": np.zeros(45), "hands_meanr": hands})
    with pytest.raises(BodyInvalid, match="hands_meanr is .*, but 45 finite numbers are expected"):
        load_smpl_file(tmp_path / "model.npz", flat_hands=False)


def spoil(arrays, **changes):
    return {k: v for k, v in {**arrays, **changes}.items() if v is not None}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weights": None, "f": None}, "does not contain weights, f. It contains J_regressor"),
        ({"v_template": np.full((60, 3), np.nan)}, "v_template contains NaN"),
        ({"weights": np.ones((59, 24))}, r"weights has shape \(59, 24\), but \(60, 24\) is expected"),
        (
            {"kintree_table": np.zeros((2, 30))},
            r"kintree_table has 30 joints, but 24 \(SMPL\), 52 \(SMPL-H\), 55 \(SMPL-X\)",
        ),
        ({"kintree_table": np.zeros((0, 24))}, "kintree_table has 0 joints"),
        ({"posedirs": np.zeros((60, 3, 93))}, "STAR models are not supported"),
        ({"J_regressor": np.full((24, 60), np.inf)}, "J_regressor contains NaN or infinite"),
        ({"kintree_table": np.full((2, 24), np.nan)}, "kintree_table contains NaN"),
        ({"kintree_table": np.array([[-1, -1, *[0] * 22], range(24)])}, r"not a tree: a single root \(-1\)"),
        ({"kintree_table": np.array([[-1, 1e300, *[0] * 22], range(24)])}, r"not a tree: a single root \(-1\)"),
        ({"f": np.full((20, 3), -1e300)}, "entries -1 to 0, but"),
        ({"kintree_table": np.array([[-1, *[23] * 23], range(24)])}, "parents must precede their children"),
        ({"v_template": np.array(["a", "b"])}, r"v_template contains <U1 of shape \(2,\), but numbers are expected"),
        ({"v_template": np.float64(3)}, r"v_template contains float64 of shape \(\), but numbers"),
        ({"weights": np.zeros((60, 24))}, "'weights' has vertices without a joint"),
        ({"shapedirs": np.zeros((60, 3, 5))}, r"shapedirs has shape \(60, 3, 5\), but \(60, 3, 10\) is expected"),
        (
            {"f": np.full((4, 3), 60)},
            r"f has shape \(4, 3\) and entries 0 to 60, but .* with vertices 0 to 59 is expected",
        ),
        ({"f": np.full((4, 3), -1)}, "entries -1 to 0, but "),
        ({"f": np.zeros((4, 2), int)}, r"f has shape \(4, 2\)"),
    ],
)
def test_spoiled_files_say_what_was_expected_and_found(changes, message, tmp_path):
    np.savez(tmp_path / "model.npz", **spoil(random_model("SMPL"), **changes))
    with pytest.raises(BodyInvalid, match=message):
        load_smpl_file(tmp_path / "model.npz")


def test_another_family_is_named(tmp_path):
    np.savez(tmp_path / "model.npz", **random_model("SMPL-X"))
    with pytest.raises(BodyInvalid, match=r"This is a SMPL-X file \(55 joints\), but SMPL is expected"):
        load_smpl_file(tmp_path / "model.npz", family="SMPL")


@pytest.mark.parametrize("name", ["model.npz", "model.pkl"])
def test_truncated_files(name, tmp_path):
    path = tmp_path / name
    if name.endswith("npz"):
        np.savez(path, **random_model("SMPL"))
    else:
        path.write_bytes(pickle.dumps(random_model("SMPL")))
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(BodyInvalid, match="cannot be read"):
        load_smpl_file(path)
