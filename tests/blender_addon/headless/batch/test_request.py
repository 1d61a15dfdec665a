"""What a folder holds of captures: files and folders of any kind beside each other, or a session's trials."""

from __future__ import annotations

from pathlib import Path

import pytest

from blender_addon.headless.batch.request import BatchRequest, captures_in


def trial(folder: Path) -> None:
    (folder / "pose" / "cam01_json").mkdir(parents=True)
    (folder / "Config.toml").touch()


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    folder = tmp_path / "captures"
    for name in ("walk", "run"):
        trial(folder / name)
    (folder / "jump" / "cam01").mkdir(parents=True)
    for name in ("sit.c3d", "old.npz", "kick.trc", "notes.txt"):
        (folder / name).touch()
    return folder


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in captures_in(BatchRequest(folder, folder / "out")))


def test_trials_hide_no_other_captures_of_the_folder(mixed: Path) -> None:
    assert names(mixed) == ["jump", "kick.trc", "old.npz", "run", "sit.c3d", "walk"]


@pytest.mark.parametrize(
    "of_session", ["Config.toml", "calibration/Calib.toml", "Participant_1/Trial_1/pose/cam01_json/x"]
)
def test_a_sessions_own_folders_are_no_captures(mixed: Path, of_session: str) -> None:
    (mixed / of_session).parent.mkdir(parents=True, exist_ok=True)
    (mixed / of_session).touch()
    found = names(mixed)
    assert {"kick.trc", "run", "sit.c3d", "walk"} <= set(found) and not {"calibration", "jump", "old.npz"} & set(found)
