"""The tutorials' pictures: what ``pictures.py`` took, cropped and put into ``docs/images``."""

from __future__ import annotations

from pathlib import Path

import cv2

IMAGES = Path(__file__).parents[2] / "docs" / "images"
_LEFT, _TOP, _RIGHT, _BOTTOM = 0, 22, 1316, 896
"""Pixels of the window that show menus, viewport, sidebar and timeline; the outliner is left out."""
_QUALITY = 80  # Of WebP: about 50 kB a picture, with letters that stay sharp.
MOST_BYTES = 150_000  # Of one picture.


def renew(pictures: Path, images: Path) -> list[Path]:
    """Crop each picture of a run and write it as ``guide_NAME.webp``.

    Args:
        pictures: folder of ``NUMBER_NAME.png``.
        images: where they go.

    Returns:
        What was written.
    """
    written = []
    for path in sorted(pictures.glob("*.png")):
        picture = cv2.imread(str(path))
        name = path.stem.partition("_")[2]
        written.append(images / f"guide_{name}.webp")
        cv2.imwrite(str(written[-1]), picture[_TOP:_BOTTOM, _LEFT:_RIGHT], [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    return written
