"""The pictures of the documents: each that a page shows is there, small, and taken by a click script."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.gui.renew import CLIP, IMAGES, MOST_BYTES, MOST_CLIP_BYTES, renew, write_animation

PAGES = sorted((IMAGES.parent / "tutorials").glob("*.md")) + [IMAGES.parent / "how-to" / "edit-a-take.md"]


def test_every_picture_of_a_page_is_one_that_the_script_takes() -> None:
    taken = set(re.findall(r'user\.shot\("(\w+)"\)', (Path(__file__).parent / "pictures.py").read_text()))
    shown = {name for page in PAGES for name in re.findall(r"guide_(\w+)\.webp", page.read_text("utf-8"))}
    there = {path.stem.removeprefix("guide_") for path in IMAGES.glob("guide_*")}
    assert shown <= there == taken and len(shown) >= 8
    assert all(path.stat().st_size < MOST_BYTES for path in IMAGES.glob("guide_*"))


def test_a_run_is_cropped_and_named_by_what_it_shows(tmp_path: Path) -> None:
    picture = np.full((900, 1600, 3), 40, np.uint8)
    picture[:, 1400:] = 255
    cv2.imwrite(str(tmp_path / "07_start.png"), picture)
    [written] = renew(tmp_path, tmp_path)
    assert written.name == "guide_start.webp"
    read = cv2.imread(str(written))
    assert read.shape == (874, 1316, 3) and read.max() < 60


def test_pictures_of_frames_become_an_endless_animation_in_their_order(tmp_path: Path) -> None:
    for number in (2, 1, 3):
        picture = np.full((900, 1600, 3), 60 * number, np.uint8)
        cv2.imwrite(str(tmp_path / f"{number:02d}_frame_{number:04d}.png"), picture)
    cv2.imwrite(str(tmp_path / "04_other.png"), picture)
    found = cv2.imreadanimation(str(write_animation(tmp_path, tmp_path / "clip.webp")))[1]
    assert found.loop_count == 0
    assert [round(float(frame[..., :3].mean()) / 60) for frame in found.frames] == [1, 2, 3]


def test_a_run_without_pictures_of_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no pictures of frames"):
        write_animation(tmp_path, tmp_path / "clip.webp")


def test_the_readmes_animation_is_small_and_has_its_licence() -> None:
    assert CLIP.stat().st_size < MOST_CLIP_BYTES
    readme = (IMAGES.parents[1] / "README.md").read_text(encoding="utf-8")
    assert f"docs/images/{CLIP.name}" in readme and "BSD 3-Clause" in readme and "Pose2Sim" in readme
    assert "BSD 3-Clause License" in (IMAGES / f"{CLIP.stem}.LICENSE.txt").read_text(encoding="utf-8")
