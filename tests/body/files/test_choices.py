"""Choosing a body by name or path; the add-on looks in the same folder."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from blender_addon.body import body_file
from blender_addon.errors import BodyMissing
from solver_backend.body.body import DEFAULT_BODY
from solver_backend.body.files.choices import (
    list_bodies,
    load_chosen_body,
    resolve_body,
)
from solver_backend.exchange.body_choice import FOLDER_VARIABLE, SHIPPED, bodies_folder
from solver_backend.exchange.errors import BodyInvalid, BodyUnknown


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder of bodies that the environment names."""
    folder = tmp_path / "bodies ü"
    monkeypatch.setenv(FOLDER_VARIABLE, str(folder))
    return folder


def test_shipped_body_is_always_a_choice(folder: Path) -> None:
    assert [(body.name, body.path) for body in list_bodies()] == [(SHIPPED, DEFAULT_BODY)]
    assert resolve_body(SHIPPED) == DEFAULT_BODY
    assert load_chosen_body(SHIPPED).id == "manifold_neutral"


def test_files_of_the_folder_are_choices_by_name(folder: Path) -> None:
    folder.mkdir()
    shutil.copy(DEFAULT_BODY, folder / "tall.npz")
    (folder / "notes.txt").write_text("no body", encoding="utf-8")
    assert [body.name for body in list_bodies()] == [SHIPPED, "tall"]
    assert resolve_body("tall") == folder / "tall.npz"
    assert resolve_body(str(folder / "tall.npz")) == folder / "tall.npz"


def test_unknown_names_list_the_known_ones(folder: Path) -> None:
    folder.mkdir()
    shutil.copy(DEFAULT_BODY, folder / "tall.npz")
    with pytest.raises(BodyUnknown, match=r"Unknown body 'short'. Known bodies: neutral, tall") as error:
        resolve_body("short")
    assert error.value.where == str(folder)
    with pytest.raises(BodyUnknown, match="no such body file") as error:
        resolve_body("gone/smpl.pkl")
    assert "neutral, tall" in error.value.hint


def test_file_that_is_no_body_is_named(folder: Path) -> None:
    folder.mkdir()
    np.savez(folder / "cube.npz", v_template=np.zeros((8, 3)))
    with pytest.raises(BodyInvalid, match="does not contain shapedirs"):
        load_chosen_body("cube")


@pytest.mark.parametrize(("suffix", "joints"), [(".npz", 24), (".npz", 52), (".npz", 55), (".pkl", 24)])
def test_smpl_family_files_work_by_path(tmp_path: Path, suffix: str, joints: int) -> None:
    path = smpl_file(tmp_path / f"model{suffix}", joints)
    body = load_chosen_body(str(path))
    assert len(body.parents) == joints and body.shapedirs.shape[-1] == 10


@pytest.mark.parametrize("platform", ["linux", "darwin", "win32"])
@pytest.mark.parametrize(
    "environment",
    [{}, {"XDG_DATA_HOME": "/data"}, {"APPDATA": "/roaming"}, {FOLDER_VARIABLE: "/own"}, {FOLDER_VARIABLE: "~/own"}],
)
def test_addon_and_solver_agree_on_the_folder(platform: str, environment: dict[str, str]) -> None:
    found = bodies_folder(environment, platform)
    assert found == body_file.bodies_folder(environment, platform)
    assert (
        found == Path(environment[FOLDER_VARIABLE]).expanduser()
        if FOLDER_VARIABLE in environment
        else found.is_absolute()
    )
    assert body_file.SHIPPED == SHIPPED


def test_addon_finds_the_body_of_a_motion(folder: Path) -> None:
    folder.mkdir()
    shutil.copy(DEFAULT_BODY, folder / "tall.npz")
    for choice in (SHIPPED, "tall", str(folder / "tall.npz")):
        provenance = json.dumps({"settings": {"body": choice}})
        assert body_file.body_path_of(provenance) == resolve_body(choice)
    for silent in ("", "no json", "{}", '{"settings": null}'):
        assert body_file.body_path_of(silent) == DEFAULT_BODY
    with pytest.raises(BodyMissing, match="solved with the body 'short', but its file does not exist") as error:
        body_file.body_path_of(json.dumps({"settings": {"body": "short"}}))
    assert str(folder) in error.value.hint


def smpl_file(path: Path, joints: int) -> Path:
    """Write a random file with the keys of the SMPL family."""
    import pickle

    rng, vertices = np.random.default_rng(0), 40
    arrays = {
        "v_template": rng.normal(size=(vertices, 3)), "shapedirs": rng.normal(size=(vertices, 3, 16)),
        "J_regressor": np.full((joints, vertices), 1 / vertices), "weights": np.full((vertices, joints), 1 / joints),
        "posedirs": np.zeros((vertices, 3, 9 * (joints - 1))), "f": np.array([[0, 1, 2]]),
        "kintree_table": np.array([[2**32 - 1, *range(joints - 1)], range(joints)], dtype=np.int64),
    }  # fmt: skip
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    else:
        path.write_bytes(pickle.dumps(arrays, protocol=2))
    return path
