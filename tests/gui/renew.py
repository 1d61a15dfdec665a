"""The pictures of the documents: screenshots of a run, cropped and put into ``docs/images``."""

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


CLIP = IMAGES / "blender_take.webp"
_SIDEBAR, _CLIP_SIZE = 1038, (950, 800)  # Pixels: the animation shows the viewport and the timeline.
_CLIP_FPS, _CLIP_QUALITY = 5.0, 70  # Quality of WebP: body and points stay sharp.
MOST_CLIP_BYTES = 2_500_000  # The largest animation that a page loads quickly.


def write_animation(pictures: Path, path: Path) -> Path:
    """Write a run's pictures of frames as an endless animation.

    Raises:
        ValueError: the run took no pictures of frames, or the animation is too large for a page.
    """
    shown = [cv2.imread(str(one))[_TOP:_BOTTOM, _LEFT:_SIDEBAR] for one in sorted(pictures.glob("*_frame_*.png"))]
    if not shown:
        raise ValueError(f"{pictures} has no pictures of frames.")
    animation = cv2.Animation()
    animation.frames = [cv2.resize(one, _CLIP_SIZE, interpolation=cv2.INTER_AREA) for one in shown]
    animation.durations = [round(1000 / _CLIP_FPS)] * len(shown)
    animation.loop_count = 0
    cv2.imwriteanimation(str(path), animation, [cv2.IMWRITE_WEBP_QUALITY, _CLIP_QUALITY])
    if (size := path.stat().st_size) > MOST_CLIP_BYTES:
        raise ValueError(f"{path} has {size} bytes. At most {MOST_CLIP_BYTES} are allowed.")
    return path
