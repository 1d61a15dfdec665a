"""The built extension in a real Blender: installed by its own tool, solving and exporting in its own Python.

Needs ``MOCAP_REAL_BLENDER``: the path of a script that runs commands where Blender is installed, and sees the folder
``WORK`` as ``/work_io`` there.
"""

from __future__ import annotations

import json
import os
import subprocess
import zipfile
from pathlib import Path

import pytest

import build_addon
from blender_addon._exchange.motion_file import read_motion
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture

INSIDE = "/work_io"


@pytest.mark.slow
@pytest.mark.parametrize("suite", ["trixie", "sid"])
def test_install_solve_and_export(suite: str, tmp_path: Path) -> None:
    tool = os.environ.get("MOCAP_REAL_BLENDER")
    if not tool:
        pytest.skip("no real Blender: set MOCAP_REAL_BLENDER")
    archive = build_addon.build(tmp_path)
    write_capture(tmp_path / "Aufnahme ü.npz", demo_capture(24))
    environment = os.environ | {"WORK": str(tmp_path), "BLENDER_USER_RESOURCES": f"{INSIDE}/user"}

    def blender(*command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [tool, "run", "--suite", suite, "--", "blender", "--command", *command],
            env=environment, capture_output=True, text=True, encoding="utf-8", timeout=600,
        )  # fmt: skip

    installed = blender("extension", "install-file", "-r", "user_default", "-e", f"{INSIDE}/{archive.name}")
    assert installed.returncode == 0, installed.stdout + installed.stderr
    zipfile.ZipFile(archive).extractall(tmp_path / "source")
    source = ["--source-dir", f"{INSIDE}/source", "--output-dir", f"{INSIDE}/source"]
    assert blender("extension", "build", *source).returncode == 0
    motion = f"{INSIDE}/motion.npz"
    solved = blender("manifold_mocap", "solve", f"{INSIDE}/Aufnahme ü.npz", "--out", motion, "--json")
    assert solved.returncode == 0, solved.stderr
    assert json.loads(solved.stdout.splitlines()[-1])["event"] == "result"
    assert read_motion(tmp_path / "motion.npz").num_frames == 24
    exported = blender("manifold_mocap", "export", motion, "--out", f"{INSIDE}/aus", "--format", "fbx", "trc", "bvh")
    assert exported.returncode == 0, exported.stderr
    assert sorted(p.name for p in (tmp_path / "aus").iterdir()) == ["motion.bvh", "motion.fbx", "motion.trc"]
    again = blender("manifold_mocap", "solve", f"{INSIDE}/Aufnahme ü.npz", "--out", motion, "--json")
    assert again.returncode == 3 and json.loads(again.stdout.splitlines()[-1])["code"] == "output_exists"
