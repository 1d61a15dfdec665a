"""The README's clip: written from a video, small, endless, and named with its source and licence."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from supply.clip import CLIP, MOST_BYTES, write_clip

ROOT = Path(__file__).resolve().parents[2]


def test_a_video_becomes_an_endless_clip_of_every_second_frame(tmp_path: Path) -> None:
    video = tmp_path / "motion.mp4"
    out = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (64, 48))
    for shade in range(0, 200, 20):
        out.write(np.full((48, 64, 3), shade, np.uint8))
    out.release()
    found = cv2.imreadanimation(str(write_clip(video, tmp_path / "clip.webp")))[1]
    assert len(found.frames) == 5 and found.loop_count == 0
    assert [round(float(frame.mean()) / 40) for frame in found.frames] == [0, 1, 2, 3, 4]


def test_a_video_without_frames_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.mp4").write_bytes(b"")
    with pytest.raises(ValueError, match="holds no frames"):
        write_clip(tmp_path / "empty.mp4", tmp_path / "clip.webp")


def test_the_readmes_clip_is_small_and_has_its_licence() -> None:
    assert CLIP.stat().st_size < MOST_BYTES
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"docs/images/{CLIP.name}" in readme and "BSD 3-Clause" in readme and "Pose2Sim" in readme
    assert "BSD 3-Clause License" in (CLIP.parent / "real_take.LICENSE.txt").read_text(encoding="utf-8")
