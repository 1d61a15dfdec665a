"""The README's clip: a solved recording's video as a small WebP that loops.

``python3 dev.py demo RECORDING --out build/clip`` solves and films it, ``python -m supply.clip build/clip/motion.mp4``
puts it into ``docs/images``. The recording is Pose2Sim's demo (BSD-3-Clause, see the README).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2

CLIP = Path(__file__).resolve().parents[1] / "docs" / "images" / "real_take.webp"
MOST_BYTES = 2_000_000
_EVERY, _QUALITY = 2, 60
"""One frame of so many is kept; quality of WebP, at which body and points stay sharp."""


def write_clip(video: Path, clip: Path) -> Path:
    """Write a video as an endless WebP.

    Args:
        video: any that OpenCV reads.
        clip: file to write; replaced where it exists.

    Raises:
        ValueError: the video has no frames, or the clip would be larger than a page should load.
    """
    source = cv2.VideoCapture(str(video))
    pictures = []
    while (read := source.read())[0]:
        pictures.append(read[1])
    rate = source.get(cv2.CAP_PROP_FPS)
    source.release()
    if not pictures:
        raise ValueError(f"{video} holds no frames.")
    animation = cv2.Animation()
    animation.frames = pictures[::_EVERY]
    animation.durations = [round(1000 * _EVERY / rate)] * len(animation.frames)
    animation.loop_count = 0
    cv2.imwriteanimation(str(clip), animation, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    if (size := clip.stat().st_size) > MOST_BYTES:
        raise ValueError(f"{clip} has {size} bytes; {MOST_BYTES} are the most.")
    return clip


def main() -> int:
    """Write the clip of the video that is named."""
    parser = argparse.ArgumentParser(prog="python -m supply.clip", description=__doc__)
    parser.add_argument("video", type=Path)
    parser.add_argument("--out", type=Path, default=CLIP)
    options = parser.parse_args()
    path = write_clip(options.video, options.out)
    sys.stdout.write(f"{path} ({path.stat().st_size / 1e3:.0f} kB)\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
