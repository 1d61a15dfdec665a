"""The recordings that scripts work with, laid where Blender sees them: real ones, and sensors that are painted."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

SENSORS, WAND = "Sensoren ü", "Stab"
"""Folders of two sensors before markers that rise, and of a wand that is waved before two."""
KATA = "Kata ü.c3d"  # A recording of markers that is long enough to be stopped by hand.
WALK = "Gang ü.c3d"  # A short recording of markers.
FIGURES = "Figuren ü"  # Folder of characters of other programs, written by their exporters.
WHEELS = "Räder ü"  # Folder of wheels that hold next to nothing, of LiteRT.
VIDEOS = "Videos ü"  # Folder of four videos of a person, without a calibration.
LONG_DEMO = "demo_1000.npz"  # Capture of the demo's person, 1,000 frames long.
_WAVED_S, _LONG = 20.0, 1000


def lay_out(out: Path, script: str) -> None:
    """Copy the recordings beside the repository, and write those that a script needs besides."""
    recordings = Path(os.environ["MOCAP_SHARED_DATA"]) / "multiview"
    for source, name in (("pose2sim", "Aufnahme ü"), ("pose2sim_session", "Sitzung ü")):
        shutil.copytree(recordings / source, out / name)
    if script in ("sensors.py", "live_speed.py"):
        shutil.copy(recordings.parent / "markers" / "cmu_pairs" / "135_02.c3d", out / KATA)
    if script == "sensors.py":
        _sensors(out / SENSORS)
        _wand(out / WAND)
    elif script in ("first_animation.py", "pictures.py"):
        shutil.copy(recordings.parent / "markers" / "cmu_pairs" / "02_01.c3d", out / WALK)
    elif script == "characters.py":
        _characters(out / FIGURES)
    elif script == "videos.py":
        trial = recordings / "pose2sim" / "S00_P00_SingleParticipant" / "S00_P00_T01_BalancingTrial"
        shutil.copytree(trial / "videos", out / VIDEOS)
    elif script == "detector.py":
        _wheels(out / WHEELS)
    elif script == "retarget_speed.py":
        _long_demo(out / LONG_DEMO)


def _long_demo(path: Path) -> None:
    from solver_backend.io.native.capture_file import write_capture
    from solver_backend.synthesis.embedded.demo import demo_capture

    write_capture(path, demo_capture(_LONG))


def _wheels(folder: Path) -> None:
    from tests.support.stub_wheels import litert_wheels

    litert_wheels(folder)


def _characters(folder: Path) -> None:
    from tests.support.foreign_files import CHARACTERS

    folder.mkdir()
    for character in CHARACTERS.values():
        character.write(folder)


def _sensors(folder: Path) -> None:
    from tests.support.recorded_markers import recorded

    recorded(folder, frames=240)


def _wand(folder: Path) -> None:
    from solver_backend.camera_calibration.formats import write_calibration
    from tests.support.waved_wand import Waving, as_tables, sensors, waved

    cameras = sensors(2)
    folder.mkdir()
    for name, table in as_tables(waved(cameras, Waving(seconds=_WAVED_S))).items():
        (folder / name).write_text(table)
    for c, name in enumerate(cameras.names):
        write_calibration(folder / f"{name}.toml", cameras.subset([c]))
