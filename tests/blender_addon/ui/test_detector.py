"""The detector for videos: shown before a file is chosen, set up after asking and without a network, tested."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from blender_addon.solving.detector import find_python
from blender_addon.ui import preferences
from blender_addon.ui.operators.solver_operator import current
from blender_addon.ui.panels import videos as videos_panel
from tests.support.narrow_layout import NarrowContext
from tests.support.panel_layout import Layout

ROOT = Path(__file__).resolve().parents[3]
SHIPPED = [*(ROOT / "solver_backend").rglob("*.py"), *(ROOT / "blender_addon").rglob("*.py")]


@pytest.fixture
def home(mocap, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr(find_python, "environment_folder", lambda: tmp_path / "Benützer" / "detector")
    monkeypatch.setattr(find_python, "backend_folder", lambda: tmp_path)
    monkeypatch.delenv("MANIFOLD_MOCAP_DETECTOR_PYTHON", raising=False)
    return tmp_path


def drawn() -> list[str]:
    layout = Layout()
    videos_panel.VIEW3D_PT_mocap_videos.draw(SimpleNamespace(layout=layout), NarrowContext(400))
    return layout.drawn


def test_the_panel_shows_that_there_is_none_and_how_to_get_one(home) -> None:
    assert not bpy.context.scene.mocap.videos.folder
    assert any("No detector is set up" in text for text in drawn())
    assert not any("Test Detector" in text for text in drawn())
    assert bpy.ops.mocap.test_detector() == {"CANCELLED"}


def test_a_python_is_tested_and_its_answer_shown(home, monkeypatch) -> None:
    python = find_python.environment_folder() / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.symlink_to(sys.executable)
    assert any("not tested yet" in text for text in drawn())
    assert bpy.ops.mocap.test_detector() == {"FINISHED"}
    assert any(f"in Python {sys.version.split()[0]}" in text for text in drawn())
    assert preferences.detector_python(bpy.context) == python


@pytest.mark.slow
def test_an_empty_folder_of_wheels_is_named_and_nothing_is_asked_of_a_network(home, tmp_path: Path) -> None:
    wheels = tmp_path / "wheels ü"
    wheels.mkdir()
    with pytest.raises(RuntimeError, match="could not be installed from the folder of wheels"):
        bpy.ops.mocap.set_up_detector(wheels=str(wheels))
    assert current.last.error["code"] == "detector_not_made"
    assert any("--no-index" in line or "mediapipe" in line for line in current.last.log)
    assert any("could not be installed" in text for text in drawn())


@pytest.mark.slow
def test_no_message_names_a_file_that_is_not_in_the_zip() -> None:
    found = []
    for path in SHIPPED:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        prose = {
            id(node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        }
        found += [
            f"{path.relative_to(ROOT)}:{node.lineno}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose
            if any(name in node.value for name in ("dev.py", "build_addon.py", "pyproject.toml"))
        ]
    assert not found
