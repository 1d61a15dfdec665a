"""Body files: what is read, and what is refused with which words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_addon._exchange.errors import BodyInvalid
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions import skeleton
from solver_backend.types import SMPL_JOINTS, SMPL_PARENTS


def test_tree_is_the_solvers_tree() -> None:
    assert skeleton.JOINTS == SMPL_JOINTS
    assert skeleton.PARENTS == SMPL_PARENTS


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": np.ones((5, 24))}, r"weights has shape \(5, 24\), but \(576, 24\)"),
        ({"v_template": np.full((576, 3), np.nan)}, "v_template contains NaN"),
        ({"kintree_table": np.zeros((2, 24))}, "joint hierarchy differs from SMPL"),
        ({"kintree_table": np.full((2, 24), 1e300)}, "joint hierarchy differs from SMPL"),
        ({"f": np.array([[0, 1, 600]]), "face_material": None}, r"faces must refer to vertices 0 to 575"),
        ({"f": np.array([[0, 1, 2]])}, r"face_material has shape .* \(1,\) is expected"),
        ({"weights": np.zeros((576, 24))}, "has no skinning weight"),
        ({"weights": np.array(["a", "b"])}, r"weights is <U1 of shape \(2,\), but an array of numbers"),
        ({"v_template": np.array(1.0)}, r"v_template is float64 of shape \(\), but an array of numbers"),
        ({"kintree_table": np.zeros((0, 52))}, r"kintree_table has shape \(0, 52\)"),
    ],
)
def test_wrong_bodies_are_named(tmp_path: Path, files: Any, change: dict[str, Any], message: str) -> None:
    with pytest.raises(BodyInvalid, match=message):
        read_body(_changed(files.body_path, tmp_path, change))


def test_default_body_ships_with_the_source_tree() -> None:
    body = read_body(default_body_path())
    assert body.id and len(body.v_template) > 1000
    assert 1.5 < np.ptp(body.v_template[:, 1]) < 2.0


def _changed(source: Path, folder: Path, change: dict[str, Any]) -> Path:
    arrays = dict(np.load(source)) | change
    path = folder / "changed.npz"
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path


def test_a_body_is_kept_while_its_file_stays_as_it_is(tmp_path: Path, files: Any) -> None:
    path = _changed(files.body_path, tmp_path, {"body_id": np.array("first")})
    body = read_body(path)
    assert read_body(path) is body
    with pytest.raises(ValueError, match="read-only"):
        body.v_template[0] = 0.0
    _changed(files.body_path, tmp_path, {"body_id": np.array("another")})
    assert read_body(path).id == "another"
