"""Videos at their own rate, webcams by OpenCV or PyAV, OAK cameras: pictures as they come; what is missing is named."""

from __future__ import annotations

import builtins
import io
import time
from types import SimpleNamespace

import numpy as np
import pytest

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.sensors.devices.oak import ColourPicture, OakPictures
from solver_backend.videos.files.video import VideoUnreadable
from solver_backend.videos.streaming.moments import ReplayedVideo, Webcam
from tests.support.videos import write_timed_video

RED = np.full((48, 64, 3), (250, 10, 10), np.uint8)


def test_a_video_comes_at_its_own_times_and_again_if_asked(tmp_path):
    path = write_timed_video(tmp_path / "cam01.mp4", [RED] * 5, [0.0, 0.05, 0.1, 0.2, 0.25])
    video = ReplayedVideo("cam01", path, repeat=True)
    video.open()
    assert video.size == (64, 48)
    start, found = time.perf_counter(), []
    for picture in video.pictures(start):
        assert time.perf_counter() >= picture.arrived == start + picture.time_s
        found.append(picture)
        if len(found) == 8:
            video.close()
    assert [picture.number for picture in found] == list(range(8))
    assert [picture.time_s for picture in found[:5]] == pytest.approx([0.0, 0.05, 0.1, 0.2, 0.25], abs=2e-3)
    again = found[5].time_s
    assert 0.25 < again < 0.4 and found[7].time_s - again == pytest.approx(0.1, abs=2e-3)
    assert np.abs(found[0].rgb().astype(int) - RED).max() < 12


def test_a_video_is_played_once_unless_asked_and_a_missing_one_is_named(tmp_path):
    path = write_timed_video(tmp_path / "cam01.mp4", [RED] * 3, [0.0, 0.02, 0.04])
    video = ReplayedVideo("cam01", path)
    video.open()
    assert len(list(video.pictures(time.perf_counter()))) == 3
    with pytest.raises(VideoUnreadable):
        ReplayedVideo("cam02", tmp_path / "none.mp4").open()


class FakeCapture:
    """OpenCV's camera: three pictures in blue, green and red, then it is unplugged."""

    def __init__(self, index: int) -> None:
        self.index, self.left, self.released = index, 3, False

    def isOpened(self) -> bool:
        return self.index == 0

    def set(self, key: int, value: float) -> None:
        assert value > 0

    def get(self, key: int) -> float:
        return {3: 64, 4: 48, 5: 30.0}[key]

    def read(self):
        self.left -= 1
        return self.left >= 0, np.ascontiguousarray(RED[..., ::-1])

    def release(self) -> None:
        self.released = True


def test_a_webcam_by_opencv_gives_red_green_and_blue_until_it_is_unplugged(monkeypatch):
    constants = {"CAP_PROP_FRAME_WIDTH": 3, "CAP_PROP_FRAME_HEIGHT": 4, "CAP_PROP_FPS": 5}
    monkeypatch.setitem(__import__("sys").modules, "cv2", SimpleNamespace(VideoCapture=FakeCapture, **constants))
    camera = Webcam("left", 0)
    camera.open()
    assert camera.size == (64, 48) and camera.fps == 30.0
    start = time.perf_counter()
    found = list(camera.pictures(start))
    assert [picture.number for picture in found] == [0, 1, 2]
    assert (found[0].rgb() == RED).all() and found[2].time_s == pytest.approx(found[2].arrived - start)
    camera.close()
    with pytest.raises(VideoUnreadable, match="cannot be opened"):
        Webcam("right", 1).open()


def test_a_webcam_without_opencv_is_read_by_pyav(monkeypatch):
    av = pytest.importorskip("av")
    known, asked = builtins.__import__, []

    def imported(name, *rest):
        if name == "cv2":
            raise ModuleNotFoundError(name)
        return known(name, *rest)

    def opened(name, format, options):
        asked.append((name, format, options))
        if name.endswith("7"):
            raise OSError("no such device")
        frames = iter([av.VideoFrame.from_ndarray(RED, format="rgb24")] * 2)
        stream = SimpleNamespace(codec_context=SimpleNamespace(width=64, height=48))
        return SimpleNamespace(
            streams=SimpleNamespace(video=[stream]), decode=lambda given: frames, close=lambda: asked.append("closed")
        )

    monkeypatch.setattr(builtins, "__import__", imported)
    monkeypatch.setattr(av, "open", opened)
    monkeypatch.setattr("sys.platform", "linux")
    camera = Webcam("left", 0)
    camera.open()
    assert asked[0][:2] == ("/dev/video0", "v4l2") and asked[0][2]["video_size"] == "1280x720"
    assert camera.size == (64, 48)
    assert [(picture.rgb() == RED).all() for picture in camera.pictures(0.0)] == [True, True]
    camera.close()
    assert asked[-1] == "closed"
    with pytest.raises(VideoUnreadable, match="cannot be opened"):
        Webcam("right", 7).open()


class FakeOak:
    """An OAK's colour camera: nothing yet, then two pictures as JPEG."""

    name, size, fps = "front", (64, 48), 30.0

    def open(self) -> None:
        self.is_open = True

    def pictures(self):
        jpeg = _jpeg()
        yield None
        yield ColourPicture(jpeg, 100.5)
        yield ColourPicture(jpeg, 100.6)

    def close(self) -> None:
        self.is_open = False


def _jpeg() -> bytes:
    av = pytest.importorskip("av")
    file = io.BytesIO()
    with av.open(file, "w", format="mjpeg") as container:
        stream = container.add_stream("mjpeg", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj444p"
        for packet in (*stream.encode(av.VideoFrame.from_ndarray(RED, format="rgb24")), *stream.encode()):
            container.mux(packet)
    return file.getvalue()


def test_an_oak_gives_pictures_with_the_times_of_their_exposures():
    camera = FakeOak()
    pictures = OakPictures(camera)
    pictures.open()
    found = list(pictures.pictures(100.0))
    assert [picture.time_s for picture in found] == pytest.approx([0.5, 0.6])
    assert np.abs(found[1].rgb().astype(int) - RED).max() < 12
    pictures.close()
    assert not camera.is_open


def test_sources_of_the_command_line_are_cameras_of_the_calibrations_names(tmp_path):
    from solver_backend.cli.camera_live_verb import picture_sources

    found = picture_sources(["left=webcam:2", "webcam:0", "right=oak:1844", str(tmp_path / "cam04.mp4")], repeat=False)
    assert [source.name for source in found] == ["left", "webcam0", "right", "cam04"]
    assert [type(source).__name__ for source in found] == ["Webcam", "Webcam", "OakPictures", "ReplayedVideo"]
    with pytest.raises(CommandLineInvalid, match="same name"):
        picture_sources(["a=webcam:0", "a=webcam:1"], repeat=False)
