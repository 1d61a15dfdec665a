"""The tutorials' pictures: each that a page shows is there, small, and taken by the click script."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from tests.gui.renew import IMAGES, MOST_BYTES, renew

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
