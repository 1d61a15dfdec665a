"""The built extension: complete, reproducible, accepted by Blender's own tool, and able to solve on its own."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

import build_addon
import solver_backend
from solver_backend.evaluation.evaluate import CODED_FRAMES
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.embedded.demo import demo_capture

_SOLVE = """
import json, subprocess, sys
from manifold_mocap.backend_environment import backend_command, environment_for_child
code = "import solver_backend; print(solver_backend.__file__)"
environment = environment_for_child()
run = lambda *command: subprocess.run(command, env=environment, capture_output=True, text=True, encoding="utf-8")
found = run(sys.executable, "-c", code)
solved = run(*backend_command(), "solve", sys.argv[1], "--out", sys.argv[2], *sys.argv[3:], "--json")
print(json.dumps([found.stdout.split("\\n"), solved.returncode, solved.stdout.splitlines()[-1:], solved.stderr]))
"""


@pytest.fixture(scope="session")
def extension_zip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the extension once."""
    return build_addon.build(tmp_path_factory.mktemp("dist"))


@pytest.fixture
def bare_python(tmp_path: Path) -> Path:
    """Return a Python of its own that has NumPy and nothing else, as Blender's has."""
    folder = tmp_path / "bare"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    packages = next(folder.glob("lib*/**/site-packages"))
    for source in Path(np.__file__).parents[1].glob("numpy*"):
        (packages / source.name).symlink_to(source, target_is_directory=True)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def tool(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run Blender's extension tool."""
    path = build_addon.extension_tool()
    if path is None:
        pytest.skip("the bpy module, which carries Blender's extension tool, is not installed")
    return subprocess.run([sys.executable, str(path), *map(str, arguments)], capture_output=True, text=True)


def test_a_zip_with_a_detector_names_its_wheels_and_holds_its_models(tmp_path: Path) -> None:
    wheel = tmp_path / "ai_edge_litert-2.3.0-cp311-cp311-manylinux_2_27_x86_64.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("ai_edge_litert/__init__.py", "")
    detector = build_addon.Detector("linux-x64", "3.11", (wheel,), {"pose_landmark_full.tflite": b"model"})
    path = build_addon.build(tmp_path, detector)
    assert path.name == "manifold_mocap-0.1.0-linux-x64-python3.11.zip"
    with zipfile.ZipFile(path) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        assert archive.read("backend/detector/pose_landmark_full.tflite") == b"model"
        assert archive.read(f"wheels/{wheel.name}") == wheel.read_bytes()
    assert (manifest["platforms"], manifest["wheels"]) == (["linux-x64"], [f"./wheels/{wheel.name}"])
    assert manifest["permissions"].keys() == {"camera", "files", "network"}
    assert tool("validate", path).returncode == 0


def test_zip_is_complete_small_and_reproducible(
    extension_zip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(subprocess, "run", lambda *_, **__: pytest.fail("a build needs no other program"))
        again = build_addon.build(tmp_path)
    assert extension_zip.read_bytes() == again.read_bytes()
    names = zipfile.ZipFile(extension_zip).namelist()
    for name in ("blender_manifest.toml", "__init__.py", "animation/action.py", "backend/solver_backend/cli/main.py",
                 "backend/solver_backend/assets/body_neutral.npz", "LICENSE"):  # fmt: skip
        assert name in names
    left_out = ("__pycache__", ".pyc", "training/", "baselines", "/vposer", "svae", "lie_vae", "catalogue")
    assert not [name for name in names for part in left_out if part in name]
    assert not [name for name in names if name.endswith(".whl")], "the solver needs NumPy alone"
    assert extension_zip.stat().st_size < 13 * 2**20
    bill = json.loads(extension_zip.with_suffix(".cdx.json").read_text(encoding="utf-8"))
    held = {component.get("purl", component["name"]) for component in bill["components"]}
    assert "backend/solver_backend/assets/body_neutral.npz" in held
    whole = bill["metadata"]["component"]["hashes"][0]["content"]
    assert whole == hashlib.sha256(extension_zip.read_bytes()).hexdigest()


def test_boards_without_a_detector_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert build_addon.main(["--out", str(tmp_path), "--with-boards"]) == 1
    assert "--with-detector" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_manifest_asks_for_permissions_with_a_reason_and_has_the_solvers_version() -> None:
    manifest = tomllib.loads(build_addon.MANIFEST.read_text(encoding="utf-8"))
    assert manifest["version"] == solver_backend.__version__
    assert set(manifest["permissions"]) == {"camera", "files", "network"}
    assert all(0 < len(why) <= 64 and not why.endswith(".") for why in manifest["permissions"].values())


def test_blenders_tool_validates_and_builds_it(extension_zip: Path, tmp_path: Path) -> None:
    validated = tool("validate", extension_zip)
    assert validated.returncode == 0, validated.stdout + validated.stderr
    zipfile.ZipFile(extension_zip).extractall(tmp_path / "source")
    built = tool("build", "--source-dir", tmp_path / "source", "--output-dir", tmp_path)
    assert built.returncode == 0, built.stdout + built.stderr
    ours, theirs = zipfile.ZipFile(extension_zip), zipfile.ZipFile(tmp_path / extension_zip.name)
    assert {n: ours.read(n) for n in ours.namelist()} == {
        n: theirs.read(n) for n in theirs.namelist() if not n.endswith("/")
    }


def test_build_writes_a_static_repository(
    extension_zip: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    tool("--help")
    assert build_addon.main(["--out", str(tmp_path)]) == 0
    assert "MiB)" in capfd.readouterr().out
    index = json.loads((tmp_path / "index.json").read_text(encoding="utf-8"))
    [entry] = index["data"]
    assert (entry["id"], entry["archive_url"]) == ("manifold_mocap", f"./{extension_zip.name}")
    assert entry["archive_size"] == extension_zip.stat().st_size
    assert entry["archive_hash"] == f"sha256:{hashlib.sha256(extension_zip.read_bytes()).hexdigest()}"
    remote = ["--remote-url", (tmp_path / "index.json").as_uri(), "--local-dir", tmp_path / "installed"]
    assert tool("sync", *remote).returncode == 0
    blender = ["--blender-version", "4.5.0", "--python-version", "3.11.0", "--local-cache", "0"]
    installed = tool("install", "manifold_mocap", *remote, *blender)
    assert installed.returncode == 0, installed.stdout
    assert (tmp_path / "installed" / "manifold_mocap" / "backend" / "solver_backend" / "__main__.py").is_file()


def test_the_unpacked_zip_solves_with_numpy_alone(extension_zip: Path, bare_python: Path, tmp_path: Path) -> None:
    installed = tmp_path / "extensions ü"
    zipfile.ZipFile(extension_zip).extractall(installed / "manifold_mocap")
    capture, motion = tmp_path / "kurze Aufnahme.npz", tmp_path / "motion ü.npz"
    write_capture(capture, demo_capture(CODED_FRAMES))  # so many that the report compares with the truth in full
    report = tmp_path / "report.html"
    command = [str(bare_python), "-c", _SOLVE, str(capture), str(motion), "--report", str(report), "--iterations", "2"]
    done = subprocess.run(
        command, cwd=installed, capture_output=True, text=True, encoding="utf-8", env={"PYTHONUTF8": "1"}
    )
    assert done.returncode == 0, done.stderr
    (solver, *_), code, last, said = json.loads(done.stdout)
    assert code == 0, said
    assert Path(solver).is_relative_to(installed / "manifold_mocap" / "backend")
    assert json.loads(last[0])["event"] == "result"
    assert read_motion(motion).num_frames == CODED_FRAMES and report.is_file()
