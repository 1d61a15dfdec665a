"""Focal lengths in files of cameras: Exif as PIL writes it, QuickTime metadata as FFmpeg and as phones write it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from solver_backend.io.footage import recorded_focal_mm
from tests.support.phone_video import KEY, phone_video


def picture(path: Path, **tags: int) -> Path:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0xA405: tags["focal"]} if tags else {})
    exif[0x010F] = "a maker"
    Image.new("RGB", (8, 8)).save(path, exif=exif)
    return path


def test_exif_of_a_picture_and_of_a_folder_of_them(tmp_path: Path) -> None:
    assert recorded_focal_mm(picture(tmp_path / "b.jpg", focal=28)) == 28.0
    assert recorded_focal_mm(picture(tmp_path / "c.jpg")) is None
    picture(tmp_path / "a.JPG", focal=24)
    assert recorded_focal_mm(tmp_path) == 24.0
    (tmp_path / "none").mkdir()
    assert recorded_focal_mm(tmp_path / "none") is None


@pytest.mark.parametrize(
    ("kind", "value"),
    [(1, b"26"), (21, struct.pack(">i", 26)), (22, struct.pack(">H", 26)), (23, struct.pack(">f", 26.0)),
     (67, struct.pack(">i", 26)), (78, struct.pack(">Q", 26))],
)  # fmt: skip
def test_metadata_of_phones(tmp_path: Path, kind: int, value: bytes) -> None:
    assert recorded_focal_mm(phone_video(tmp_path / "a.mov", kind, value)) == 26.0
    assert recorded_focal_mm(phone_video(tmp_path / "a.mov", kind, value, track=False, version=bytes(4))) == 26.0


def test_metadata_as_ffmpeg_writes_it(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    path = tmp_path / "a.mov"
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as file:
        file.metadata[KEY.decode()] = "52"
        stream = file.add_stream("mpeg4", rate=30)
        stream.width = stream.height = 64
        for _ in range(3):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")))
        file.mux(stream.encode())
    assert recorded_focal_mm(path) == 52.0


def test_nonsense_is_no_focal_length(tmp_path: Path) -> None:
    for kind, value in ((1, b"wide"), (1, b"nan"), (21, struct.pack(">i", 0)), (23, b"\0"), (99, b"26")):
        assert recorded_focal_mm(phone_video(tmp_path / "a.mov", kind, value)) is None
    whole = picture(tmp_path / "b.jpg", focal=28).read_bytes()
    video = phone_video(tmp_path / "a.mov", 1, b"26").read_bytes()
    for name, data, known in (("cut.jpg", whole, (None, 28.0)), ("cut.mov", video, (None,))):
        for cut in range(0, len(data), 5):
            (tmp_path / name).write_bytes(data[:cut])
            assert recorded_focal_mm(tmp_path / name) in known
    assert recorded_focal_mm(tmp_path / "gone.mp4") is None
