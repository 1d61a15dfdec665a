"""Names of folders and takes, and the capture a dropped file stands for."""

from __future__ import annotations

from pathlib import Path

import pytest

from blender_addon.solving import take_paths
from blender_addon.solving.take_paths import capture_folder, capture_root, next_take, safe_name
from solver_backend.io.detections.search import POSE_FOLDERS


@pytest.mark.parametrize(
    ("name", "safe"),
    [("walk 1", "walk 1"), ("Läufer/Ω:7", "Läufer_Ω_7"), ("...", "capture"), ("a\tb*?", "a_b_"), ("動き", "動き")],
)
def test_safe_names(name, safe):
    assert safe_name(name) == safe


def test_captures_of_one_name_get_folders_of_their_own():
    one, other = (capture_folder(Path("base"), Path(f"/{day}/trial 1")) for day in ("monday", "tuesday"))
    assert (
        one != other
        and one.name.startswith("trial 1_")
        and one == capture_folder(Path("base"), Path("/monday/trial 1"))
    )


def test_take_numbers_are_not_used_twice(tmp_path):
    assert next_take(tmp_path).motion.name == "take_01.npz"
    (tmp_path / "take_07.job.json").touch()
    (tmp_path / "take_x.npz").touch()
    take = next_take(tmp_path)
    assert (take.number, take.motion.name, take.report.name, take.job.name) == (
        8, "take_08.npz", "take_08.html", "take_08.job.json",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("dropped", "root"),
    [
        ("trial/pose/cam01_json/f_000.json", "trial"),
        ("folders/cam01/f_000.json", "folders"),
        ("trial/Config.toml", "trial"),
        ("folders/Calib.toml", "folders"),
        ("folders/calibration.json", "folders"),
        ("trial/calibration/Calib.qca.txt", "trial"),
        ("trial/videos/cam01.mp4", "trial"),
        ("folders/intrinsics/lens.yml", "folders"),
        ("elsewhere/nexus.txt", "elsewhere/nexus.txt"),
        ("trial/walk.c3d", "trial/walk.c3d"),
        ("elsewhere/walk.TRC", "elsewhere/walk.TRC"),
        ("capture.npz", "capture.npz"),
        ("trial", "trial"),
    ],
)
def test_a_dropped_file_stands_for_its_capture(tmp_path, dropped, root):
    for folder in ("trial/pose/cam01_json", "folders/cam01", "folders/cam02"):
        (tmp_path / folder).mkdir(parents=True)
        for frame in range(3):
            (tmp_path / folder / f"f_{frame:03d}.json").touch()
    others = ("trial/Config.toml", "folders/Calib.toml", "folders/calibration.json", "capture.npz", dropped)
    for path in (tmp_path / name for name in others if name != "trial"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert capture_root(tmp_path / dropped) == tmp_path / root


def test_the_folders_of_poses_are_those_the_solver_knows():
    assert frozenset(POSE_FOLDERS) == take_paths._POSE_FOLDERS
