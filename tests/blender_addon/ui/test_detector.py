"""The detector for videos: shown before a file is chosen, set up after asking and without a network, tested."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from blender_addon import backend_environment
from blender_addon._exchange.video_settings import DETECTORS, NamedDetector
from blender_addon.solving import pythons
from blender_addon.ui import preferences
from blender_addon.ui.operators.base import current
from blender_addon.ui.operators.videos import MOCAP_OT_set_up_detector
from tests.support.narrow_layout import NarrowContext
from tests.support.panel_layout import Layout
from tests.support.stub_wheels import litert_wheels

ROOT = Path(__file__).resolve().parents[3]
SHIPPED = [*(ROOT / "solver_backend").rglob("*.py"), *(ROOT / "blender_addon").rglob("*.py")]


@pytest.fixture
def home(mocap, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr(pythons, "environment_folder", lambda kind="mediapipe": tmp_path / "Benützer" / kind)
    monkeypatch.setattr(pythons, "backend_folder", lambda: tmp_path)
    monkeypatch.delenv("MANIFOLD_MOCAP_DETECTOR_PYTHON", raising=False)
    return tmp_path


def drawn() -> list[str]:
    layout = Layout()
    bpy.types.VIEW3D_PT_mocap_videos.draw(SimpleNamespace(layout=layout), NarrowContext(400))
    return layout.drawn


def test_the_panel_shows_that_there_is_none_and_how_to_get_one(home) -> None:
    assert not bpy.context.scene.mocap.videos.folder
    assert any("No detector is set up" in text for text in drawn())
    assert not any("Test Detector" in text for text in drawn())
    assert bpy.ops.mocap.test_detector() == {"CANCELLED"}


def test_an_empty_stature_says_what_it_means(home) -> None:
    videos = bpy.context.scene.mocap.videos
    assert "label:Automatic" in drawn()
    videos.stature = 1.8
    assert "label:Automatic" not in drawn()


def test_an_included_detector_needs_no_set_up_and_finds_fingers(home, monkeypatch) -> None:
    monkeypatch.setattr(backend_environment, "included_wheels", lambda: home)
    assert any("The included detector finds body and hands" in text for text in drawn())
    assert not any("Set Up Detector" in text or "Test Detector" in text for text in drawn())
    assert preferences.detector_for(bpy.context) is None and not preferences.lacks_detector(bpy.context)
    videos = bpy.context.scene.mocap.videos
    assert videos.fingers and any("fingers" in text for text in drawn())
    videos.hands = "/there/hand_landmark_full.tflite"
    assert not any("fingers" in text for text in drawn())
    videos.detector, videos.model = "model", "/there/pose_landmark_heavy.tflite"
    assert not preferences.lacks_detector(bpy.context), "the included LiteRT runs other models, too"


def test_only_a_detector_of_its_own_environment_waits_for_one(home, monkeypatch) -> None:
    monkeypatch.setitem(DETECTORS, "fixed", NamedDetector("Fixed", "The same points in every picture", "fixed_pose"))
    lacks = {}
    for name in DETECTORS:
        mocap = SimpleNamespace(videos=SimpleNamespace(detector=name, model=""))
        context = SimpleNamespace(scene=SimpleNamespace(mocap=mocap), preferences=bpy.context.preferences)
        lacks[name] = preferences.lacks_detector(context)
        assert preferences.detector_for(context) is None
    assert lacks == {"mediapipe": True, "fixed": False}


def test_the_model_that_a_description_names_waits_for_litert(home) -> None:
    videos, described = bpy.context.scene.mocap.videos, home / "own.json"
    videos.detector, videos.model = "model", str(described)
    for model, lacks in (("own.tflite", True), ("own.onnx", False)):
        described.write_text(f'{{"model": "{model}"}}')
        assert preferences.lacks_detector(bpy.context) == lacks
    for text in ("[]", "{", '{"model": 3}'):
        described.write_text(text)
        assert not preferences.lacks_detector(bpy.context)


@pytest.mark.parametrize("kind", ["mediapipe", "litert"])
def test_the_question_fits_its_window_and_names_source_and_folder(home, kind: str) -> None:
    layout = Layout()
    for wheels in ("", str(home)):
        MOCAP_OT_set_up_detector.draw(SimpleNamespace(layout=layout, kind=kind, wheels=wheels), bpy.context)
    folder = f"into {pythons.environment_folder(kind)}"
    texts = [text.removeprefix("label:") for text in layout.drawn]
    assert {"the package registry (pypi.org)", "the folder below", folder} <= set(texts)
    assert max(len(text) for text in texts if text != folder) < 72, "letters that 440 px hold"


def test_a_model_file_needs_the_python_that_runs_it(home) -> None:
    videos = bpy.context.scene.mocap.videos
    videos.detector, videos.model = "model", "/there/pose_landmark_full.tflite"
    assert any("No detector is set up" in text for text in drawn())
    videos.model = "/there/rtmpose.onnx"
    assert any("runs in the solver's Python" in text for text in drawn())


def test_a_python_is_tested_and_its_answer_shown(home, monkeypatch) -> None:
    python = pythons.environment_folder() / "bin" / "python"
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
    with pytest.raises(RuntimeError, match="could not be installed from the wheel folder"):
        bpy.ops.mocap.set_up_detector(wheels=str(wheels))
    assert current.last.error["code"] == "detector_not_made"
    assert any("--no-index" in line or "mediapipe" in line for line in current.last.log)
    assert any("could not be installed" in text for text in drawn())


@pytest.mark.slow
def test_litert_is_set_up_from_wheels_and_models_of_a_folder(home, tmp_path: Path) -> None:
    wheels = tmp_path / "wheels"
    litert_wheels(wheels)
    videos = bpy.context.scene.mocap.videos
    assert "--hand-model" not in videos.arguments()
    assert bpy.ops.mocap.set_up_detector(kind="litert", wheels=str(wheels)) == {"FINISHED"}
    folder = pythons.environment_folder("litert")
    assert pythons.made_litert_python() == folder / pythons._BELOW
    assert pythons.made_python() is None, "MediaPipe package is missing"
    models = ["hand_landmark_full.tflite", "pose_landmark_full.tflite", "pose_landmark_lite.tflite"]
    assert sorted(path.name for path in (folder / "models").iterdir()) == models
    assert videos.detector == "model" and Path(videos.model) == folder / "models" / models[1]
    assert preferences.detector_for(bpy.context) == pythons.made_litert_python()
    assert any("LiteRT 2.3.0" in text for text in drawn()) and not any("No detector" in text for text in drawn())
    assert Path(videos.hands) == folder / "models" / "hand_landmark_full.tflite"
    assert videos.arguments()[-2:] == ["--hand-model", videos.hands]
    assert preferences.litert_python(bpy.context) == pythons.made_litert_python()


@pytest.mark.slow
def test_a_detector_that_cannot_be_made_leaves_the_earlier_one(home, tmp_path: Path) -> None:
    """A failed or cancelled set-up is no detector, and one that worked is still there."""
    earlier = pythons.environment_folder("litert") / pythons._BELOW
    earlier.parent.mkdir(parents=True)
    earlier.write_text("an earlier one")
    (tmp_path / "wheels").mkdir()
    with pytest.raises(RuntimeError, match="could not be installed from the wheel folder"):
        bpy.ops.mocap.set_up_detector(kind="litert", wheels=str(tmp_path / "wheels"))
    assert pythons.made_litert_python() == earlier and earlier.read_text() == "an earlier one"
    assert pythons.made_python() is None


def test_a_python_that_makes_no_environments_is_named(home, monkeypatch) -> None:
    """Debian's Python has no ensurepip: Blender's own cannot be used there, and the free space is not at fault."""
    monkeypatch.setattr(pythons, "find_spec", lambda name: None)
    monkeypatch.setattr(pythons, "_candidates", lambda *_: ())
    with pytest.raises(RuntimeError, match="ensurepip is missing.*python3-venv"):
        bpy.ops.mocap.set_up_detector(kind="litert", wheels=str(home))
    assert not pythons.environment_folder("litert").exists()


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
