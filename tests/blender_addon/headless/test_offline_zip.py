"""The zip that includes a detector: offline, in a new profile, beside no other package, and with the same detections.

``MOCAP_DETECTOR_ZIP`` names the zip for this Python (``build_addon.py --with-detector linux-x64``). Needs the real
recordings and a right to switch the network off (``unshare``, Linux).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import numpy as np
import pytest

OFFLINE = Path(__file__).parents[2] / "gui" / "offline.py"
TRIAL = "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial/videos"
PACKAGES = ("numpy", "bpy")  # Nothing else is in Blender's Python.


@pytest.mark.slow
def test_videos_become_a_body_offline_with_the_command_lines_detections(tmp_path: Path, shared_data: Path) -> None:
    archive = Path(os.environ.get("MOCAP_DETECTOR_ZIP", ""))
    if not archive.is_file():
        pytest.skip("no zip with a detector: set MOCAP_DETECTOR_ZIP")
    offline = ["unshare", "--net"]
    if subprocess.run([*offline, "true"], capture_output=True, check=False).returncode:
        pytest.skip("the network cannot be switched off here")
    python = _python_with(tmp_path / "python", *PACKAGES)
    inside, outside = tmp_path / "in Blender", tmp_path / "command line"
    for folder in (inside, outside):
        shutil.copytree(shared_data / TRIAL, folder)
    own = {"HOME": str(tmp_path), "PATH": str(tmp_path / "none"), "BLENDER_USER_RESOURCES": str(tmp_path / "user")}
    command = [shutil.which("unshare") or "unshare", "--net", str(python), str(OFFLINE), str(archive), str(inside)]
    done = subprocess.run(command, capture_output=True, text=True, env=own, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["other_python"] == "" and found["network"] and found["already_installed"] == []
    assert found["packages"].startswith(str(tmp_path / "user"))
    assert found["frames"] == 100 and found["finger_rad"] > 0.03

    detector = tmp_path / "detector"
    with zipfile.ZipFile(archive) as held:
        for name in held.namelist():
            if name.startswith("backend/detector/"):
                held.extract(name, detector)
            elif name.startswith("wheels/ai_edge_litert"):
                zipfile.ZipFile(held.extract(name, tmp_path)).extractall(detector / "packages")
    models = detector / "backend" / "detector"
    litert = _python_with(tmp_path / "litert", "numpy")
    packages = next((tmp_path / "litert").glob("lib*/**/site-packages"))
    (packages / "litert.pth").write_text(str(detector / "packages"))
    words = ["from-videos", str(outside), "--until", "capture", "--detector", str(models / "pose_landmark_full.tflite")]
    words += ["--python", str(litert), "--hand-model", str(models / "hand_landmark_full.tflite")]
    subprocess.run(
        [sys.executable, "-m", "solver_backend", *words, "--hand-python", str(litert)],
        check=True, capture_output=True,
    )  # fmt: skip
    files = [f"detections/{path.name}" for path in sorted((outside / "mocap" / "detections").iterdir())]
    assert len(files) == 4
    for name in (*files, "capture.npz"):
        ours, theirs = (np.load(folder / "mocap" / name) for folder in (inside, outside))
        for key in {"times_s", "track", "xy", "confidence", "hands", "K", "R", "t"} & set(theirs.files):
            np.testing.assert_array_equal(ours[key], theirs[key], err_msg=f"{name}: {key}")


def _python_with(folder: Path, *packages: str) -> Path:
    """Return a Python of its own with some packages of this one."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    there = next(folder.glob("lib*/**/site-packages"))
    for name in packages:
        for path in Path(sysconfig.get_path("purelib")).glob(f"{name}*"):
            (there / path.name).symlink_to(path)
    return folder / "bin" / "python"
