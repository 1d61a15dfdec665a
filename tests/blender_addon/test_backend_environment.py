"""The environment of the solver's process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from blender_addon import backend_environment
from blender_addon._exchange.errors import BackendMissing
from blender_addon.backend_environment import backend_command, backend_folder, environment_for_child, included_wheels
from tests.support.full_disk import full_disk


def test_a_child_finds_the_solver_from_anywhere_and_nothing_of_the_working_folder(tmp_path: Path) -> None:
    (tmp_path / "json.py").write_text("raise SystemExit('the wrong module')")
    done = subprocess.run(
        [*backend_command(), "--version"], cwd=tmp_path, env=environment_for_child(), capture_output=True, text=True
    )
    assert done.returncode == 0 and done.stdout.startswith("Manifold MoCap "), done.stderr


def test_pythons_settings_are_not_inherited_and_others_are() -> None:
    inherited = {"PYTHONHOME": "/gone", "PYTHONPATH": "/gone", "PATH": "/bin", "LANG": "C"}
    own = environment_for_child(inherited=inherited)
    assert (own["PATH"], own["LANG"], own["PYTHONNOUSERSITE"]) == ("/bin", "C", "1")
    assert "PYTHONHOME" not in own and own["PYTHONPATH"].split(os.pathsep)[0] == str(backend_folder())
    assert "PYTHONNOUSERSITE" not in environment_for_child(Path(sys.executable), inherited)


def test_what_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BackendMissing, match=r"No Python was found to run the solver.*Choose another Python"):
        backend_command(tmp_path / "python")
    monkeypatch.setattr(backend_environment, "_ADDON", tmp_path / "addon")
    with pytest.raises(BackendMissing, match="The solver is not in the add-on's folder"):
        environment_for_child()


def test_no_byte_code_is_kept_on_a_disk_that_is_nearly_full() -> None:
    assert "PYTHONDONTWRITEBYTECODE" not in environment_for_child()
    with full_disk(1_000_000):
        assert environment_for_child()["PYTHONDONTWRITEBYTECODE"] == "1"


def test_blenders_own_python_finds_the_wheels_of_an_included_detector(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "site" / "ai_edge_litert" / "__init__.py"
    monkeypatch.setattr(backend_environment, "find_spec", lambda name: SimpleNamespace(origin=str(package)))
    monkeypatch.setattr(backend_environment, "backend_folder", lambda: tmp_path)
    monkeypatch.setattr(backend_environment, "included_wheels", included_wheels.__wrapped__)
    assert "MANIFOLD_MOCAP_PACKAGES" not in environment_for_child(), "nothing is included"
    (tmp_path / "detector").mkdir()
    own = environment_for_child()
    assert (own["PYTHONPATH"], own["MANIFOLD_MOCAP_PACKAGES"]) == (str(tmp_path), str(tmp_path / "site"))
    assert "MANIFOLD_MOCAP_PACKAGES" not in environment_for_child(Path(sys.executable))


def test_panels_do_not_look_for_the_wheels_at_every_redraw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    (tmp_path / "detector").mkdir()
    monkeypatch.setattr(backend_environment, "find_spec", asked.append)
    monkeypatch.setattr(backend_environment, "backend_folder", lambda: tmp_path)
    included_wheels.cache_clear()
    assert [included_wheels() for _ in range(3)] == [None] * 3 and asked == ["ai_edge_litert"]
    included_wheels.cache_clear()
