from __future__ import annotations

import tracemalloc
from contextlib import suppress
from fractions import Fraction
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from solver_backend.videos.files import video
from solver_backend.videos.files.video import (
    SameVideoTwice,
    VideoUnreadable,
    VideoWithoutSound,
    file_hash,
    probe,
    read_pictures,
    read_sound,
    require_different,
    write_video,
)
from tests.support.videos import dots, turned_by_header, write_dots, write_timed_video

pytest.importorskip("av")
PLACES = np.array([[30.0, 20.0], [120.0, 50.0], [70.0, 100.0]])


def still(path: Path, frames: int = 12) -> Path:
    return write_dots(path, np.tile(PLACES, (frames, 1, 1)), np.arange(frames) / 30.0)


def place_of(rgb: np.ndarray, channel: int) -> np.ndarray:
    """Return (x, y), the middle of what has the colour of a channel alone."""
    others = rgb[..., [c for c in range(3) if c != channel]].max(-1)
    y, x = np.nonzero((rgb[..., channel] > 128) & (others < 100))
    return np.array([x.mean(), y.mean()])


def test_a_video_of_variable_rate_keeps_the_times_of_its_pictures(tmp_path: Path) -> None:
    times = np.cumsum([0.0, 0.033, 0.033, 0.1, 0.033, 0.02, 0.033, 0.033, 0.066, 0.033])
    info = probe(write_dots(tmp_path / "v.mp4", np.tile(PLACES, (10, 1, 1)), times))
    assert info.size == (160, 120)
    assert info.fps == pytest.approx(1 / 0.033, rel=1e-3)
    np.testing.assert_allclose(info.times_s, times, atol=1e-3)
    np.testing.assert_allclose([p.time_s for p in read_pictures(info)], times, atol=1e-3)


def test_a_constant_rate_is_the_mean(tmp_path: Path) -> None:
    info = probe(still(tmp_path / "v.mp4", 31))
    assert info.fps == pytest.approx(30.0, rel=2e-3) and info.num_frames == 31


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_pictures_are_turned_as_the_header_says(tmp_path: Path, degrees: int) -> None:
    path = still(tmp_path / "v.mp4")
    turned_by_header(path, degrees)
    info = probe(path)
    rgb = next(read_pictures(info)).rgb
    assert info.size == rgb.shape[1::-1] == ((160, 120) if degrees == 180 else (120, 160))
    # ISO 14496-12: the matrix (0, 1, -1, 0) shows x' = -y, y' = x, a quarter turn clockwise.
    shown = {90: lambda x, y: (119 - y, x), 180: lambda x, y: (159 - x, 119 - y), 270: lambda x, y: (y, 159 - x)}
    for channel, (x, y) in enumerate(PLACES):
        np.testing.assert_allclose(place_of(rgb, channel), shown[degrees](x, y), atol=1.0)


@pytest.mark.parametrize("ending", [".mp4", ".mov", ".mkv", ".avi", ".ts"])
def test_pixels_that_are_not_square_are_shown_square(tmp_path: Path, ending: str) -> None:
    """A camera of 1440 x 1080 pixels whose pictures are shown as 1920 x 1080."""
    times, size = np.arange(12) / 30.0, (120, 120)
    pictures = [dots(PLACES * (0.75, 1.0), size) for _ in times]
    info = probe(write_timed_video(tmp_path / f"v{ending}", pictures, times, aspect=Fraction(4, 3)))
    rgb = next(read_pictures(info)).rgb
    assert (info.size, info.stored) == ((160, 120), size) and rgb.shape == (120, 160, 3)
    for channel, place in enumerate(PLACES):
        # A stored pixel has its centre at 4/3 (x + 0.5) - 0.5.
        expected = (np.round(place * (0.75, 1.0)) + 0.5) * (4 / 3, 1.0) - 0.5
        np.testing.assert_allclose(place_of(rgb, channel), expected, atol=0.5)


def test_a_turned_camera_can_have_pixels_that_are_not_square(tmp_path: Path) -> None:
    pictures = [dots(PLACES * (0.75, 1.0), (120, 120))] * 12
    path = write_timed_video(tmp_path / "v.mp4", pictures, np.arange(12) / 30.0, aspect=Fraction(4, 3))
    turned_by_header(path, 90)
    info = probe(path)
    rgb = next(read_pictures(info)).rgb
    assert info.size == rgb.shape[1::-1] == (120, 160) and info.stored == (120, 120)
    np.testing.assert_allclose(place_of(rgb, 1), [119 - PLACES[1, 1], PLACES[1, 0]], atol=1.0)


def test_a_size_that_changes_within_a_recording_is_named(tmp_path: Path) -> None:
    parts = []
    for size in ((160, 120), (120, 160)):
        parts.append(
            write_timed_video(tmp_path / "part.ts", [dots(PLACES, size)] * 12, np.arange(12) / 30.0).read_bytes()
        )
    (tmp_path / "v.ts").write_bytes(b"".join(parts))
    with pytest.raises(VideoUnreadable, match="has 120 x 160 pixels, but the first one has 160 x 120") as caught:
        list(read_pictures(probe(tmp_path / "v.ts")))
    assert "Cut the recording" in caught.value.hint


@pytest.mark.parametrize("aspect", [Fraction(1000, 999), Fraction(1, 200), Fraction(200, 1)])
def test_an_aspect_that_is_nearly_square_or_impossible_changes_no_picture(tmp_path: Path, aspect: Fraction) -> None:
    path = write_timed_video(tmp_path / "v.mp4", [dots(PLACES, (160, 120))] * 3, np.arange(3) / 30.0, aspect=aspect)
    info = probe(path)
    assert info.size == info.stored == (160, 120) and next(read_pictures(info)).rgb.shape == (120, 160, 3)


@pytest.mark.parametrize(
    ("damage", "words"),
    [(lambda data: b"", "no bytes"), (lambda data: data[: len(data) // 3], "cannot be read"),
     (lambda data: b"not a video at all " * 50, "cannot be read")],
)  # fmt: skip
def test_broken_files_have_a_name(tmp_path: Path, damage, words: str) -> None:
    path = still(tmp_path / "v.mp4")
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(VideoUnreadable, match=words) as caught:
        probe(path)
    assert caught.value.where == str(path) and caught.value.hint


B_FRAMES = {"preset": "veryfast", "bf": "2", "g": "12"}  # Pictures are stored in another order than they are shown.


def moving(path: Path, times: np.ndarray, **options: dict[str, str]) -> Path:
    """Write a video with a red dot at 10 px plus 2 px per picture."""
    places = np.array([PLACES + [0.0, 0.0]] * len(times))
    places[:, 0, 0] = 10 + 2 * np.arange(len(times))
    pictures = [dots(place, (160, 120)) for place in places]
    return write_timed_video(path, pictures, times, options=B_FRAMES, container_options=options)


def check_pictures(path: Path, times: np.ndarray) -> int:
    """Check that each picture that is read has its own time, and return their number."""
    info = probe(path)
    pictures = list(read_pictures(info))
    shown = [round((place_of(picture.rgb, 0)[0] - 10) / 2) for picture in pictures]
    first = times[0] - pictures[0].time_s
    np.testing.assert_allclose([picture.time_s + first for picture in pictures], times[shown], atol=2e-3)
    assert (np.diff(shown) > 0).all() and shown[0] == 0
    return len(shown)


@pytest.mark.parametrize("ending", [".avi", ".mkv", ".mp4", ".mov", ".ts"])
def test_pictures_stored_out_of_order_have_their_own_times(tmp_path: Path, ending: str) -> None:
    times = np.arange(50) / 30.0
    assert check_pictures(moving(tmp_path / f"v{ending}", times), times) >= 49


def photos(path: Path, numbers: np.ndarray, codec: str = "mjpeg", **options: str) -> Path:
    """Write an AVI of grey pictures at these numbers of the clock, each as bright as four times its number."""
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.time_base = Fraction(1, 30)
        for number in numbers.tolist():
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 4 * number, np.uint8), format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def numbers_of(path: Path) -> np.ndarray:
    """Return (F, 2), the place of each picture on the clock and the number that is shown."""
    return np.array([[picture.time_s * 30.0, picture.rgb.mean() / 4.0] for picture in read_pictures(probe(path))])


@pytest.mark.parametrize(("codec", "late"), [("mjpeg", 0), ("libx264", 2)])
def test_pictures_that_an_avi_lacks_move_no_later_picture(tmp_path: Path, codec: str, late: int) -> None:
    options = {} if codec == "mjpeg" else {"bf": "2", "b-adapt": "0"}
    found = numbers_of(photos(tmp_path / "gap.avi", np.r_[:20, 40:60], codec, **options))
    off = found[:, 0] - found[0, 0] - found[:, 1]
    moved = np.abs(off - np.median(off)) > 1.0
    assert len(found) == 40 and moved.sum() <= late, "times in the order of decoding move pictures next to the gap"


@pytest.mark.parametrize("codec", ["mjpeg", "libx264"])
def test_a_broken_picture_of_an_avi_moves_no_other(tmp_path: Path, codec: str) -> None:
    path = photos(tmp_path / "broken.avi", np.arange(60), codec, **({} if codec == "mjpeg" else {"bf": "2", "g": "12"}))
    data = bytearray(path.read_bytes())
    at = -1
    for _ in range(30):
        at = data.index(b"00dc", at + 1)
    length = int.from_bytes(data[at + 4 : at + 8], "little")
    data[at + 8 : at + 8 + length] = bytes(length)
    path.write_bytes(data)
    found = numbers_of(path)
    assert len(found) >= 58 and np.abs(found[-10:, 0] - found[0, 0] - found[-10:, 1]).max() < 1.0


def test_a_video_of_one_broken_picture_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = probe(still(tmp_path / "v.mp4", 1))
    monkeypatch.setattr(video, "_decoded", lambda path: iter([None]))
    with pytest.raises(VideoUnreadable, match="Only 0 of the video's 1 frames"):
        list(read_pictures(info))


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.9, 0.99])
@pytest.mark.parametrize(
    ("ending", "options"),
    [(".mkv", {}), (".ts", {}), (".mp4", {"movflags": "faststart"}), (".mp4", {"movflags": "frag_keyframe+empty_moov"}),
     (".mp4", {})],
)  # fmt: skip
def test_a_recording_that_was_cut_off_is_right_as_far_as_it_goes_or_named(
    tmp_path: Path, ending: str, options: dict[str, str], share: float
) -> None:
    times = np.cumsum(np.tile([0.033, 0.02, 0.05, 0.033, 0.1], 10))  # a rate that varies
    path = moving(tmp_path / f"v{ending}", times, **options)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    hint = ""
    try:
        found = check_pictures(path, times)
    except VideoUnreadable as error:
        hint = error.hint
    if hint:
        assert "Copy the file" in hint and (ending == ".mp4" or share < 0.5)
    else:
        assert found > 0.5 * share * len(times)


def test_bytes_that_were_changed_move_no_picture_in_time(tmp_path: Path) -> None:
    times = np.arange(60) / 30.0
    whole = moving(tmp_path / "v.mkv", times).read_bytes()
    for seed in range(8):
        rng = np.random.default_rng(seed)
        data = bytearray(whole)
        at = int(rng.integers(len(data) // 3, len(data) - 8))
        data[at : at + 4] = rng.bytes(4)
        (tmp_path / "spoiled.mkv").write_bytes(data)
        given = np.zeros(1)
        with suppress(VideoUnreadable):
            given = np.array([picture.time_s for picture in read_pictures(probe(tmp_path / "spoiled.mkv"))])
        assert np.abs(given[:, None] - times).min(1).max() < 2e-3 and (np.diff(given) > 0).all()


def test_pictures_without_times_and_with_a_long_pause_are_named(tmp_path: Path) -> None:
    moving(tmp_path / "v.h264", np.arange(12) / 30.0)
    with pytest.raises(VideoUnreadable, match="frames without timestamps") as caught:
        probe(tmp_path / "v.h264")
    assert "ffmpeg -r" in caught.value.hint
    times = np.arange(30) / 30.0 + np.where(np.arange(30) > 12, 7200.0, 0.0)
    with pytest.raises(VideoUnreadable, match="After frame 12, the video has no frames for 7200 s"):
        probe(moving(tmp_path / "pause.mkv", times))
    assert probe(moving(tmp_path / "lapse.mkv", 90.0 * np.arange(4))).num_frames == 4, "a slow rate is no pause"


@pytest.mark.slow
def test_an_hour_of_pictures_is_read_in_little_memory(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    moving(tmp_path / "part.mp4", np.arange(30) / 30.0)
    with av.open(str(tmp_path / "part.mp4")) as part, av.open(str(tmp_path / "v.mkv"), "w") as whole:
        stream = whole.add_stream_from_template(part.streams.video[0])
        second = round(1 / part.streams.video[0].time_base)
        packets = [(bytes(packet), packet.pts, packet.dts) for packet in part.demux(video=0) if packet.size]
        for number in range(3600):  # the same coded second again and again
            for data, pts, dts in packets:
                packet = av.Packet(data)
                packet.pts, packet.dts = pts + number * second, dts + number * second
                packet.time_base, packet.stream = Fraction(1, second), stream
                packet.is_keyframe = (pts, dts) == packets[0][1:]
                whole.mux(packet)
    info = probe(tmp_path / "v.mkv")
    assert info.num_frames == 108_000 and info.fps == pytest.approx(30.0, rel=1e-3)
    pictures = read_pictures(info)
    assert sum(1 for _ in islice(pictures, 105_000)) == 105_000
    tracemalloc.start()
    count = sum(1 for _ in pictures)
    kept, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count == 3_000 and kept < 1e5 and most < 2e6, "3,000 pictures have 173 MB"


def test_pictures_that_are_destroyed_are_not_passed_over_in_silence(tmp_path: Path) -> None:
    path = write_dots(tmp_path / "v.mp4", np.tile(PLACES, (60, 1, 1)), np.arange(60) / 30.0)
    data = bytearray(path.read_bytes())
    start = data.index(b"mdat") + 4
    length = int.from_bytes(data[start - 8 : start - 4], "big")
    data[start : start + length - 8] = bytes(length - 8)
    path.write_bytes(bytes(data))
    with pytest.raises(VideoUnreadable):
        list(read_pictures(probe(path)))


def test_a_missing_file_and_a_file_of_sound_alone(tmp_path: Path) -> None:
    with pytest.raises(VideoUnreadable, match="no such video"):
        probe(tmp_path / "none.mp4")


def test_sound_stands_on_the_clock_of_the_pictures(tmp_path: Path) -> None:
    click = np.zeros(32_000, np.float32)
    click[16_000:16_040] = 0.9
    path = write_timed_video(tmp_path / "v.mp4", [dots(PLACES, (160, 120))] * 60, np.arange(60) / 30.0, click)
    heard = read_sound(path)
    at_s = heard.start_s + float(np.abs(heard.samples).argmax()) / heard.rate_hz
    assert at_s == pytest.approx(1.0, abs=0.01)


def test_no_sound_and_silence_have_a_name(tmp_path: Path) -> None:
    with pytest.raises(VideoWithoutSound, match="has no sound"):
        read_sound(still(tmp_path / "mute.mp4"))
    silent = write_timed_video(
        tmp_path / "silent.mp4", [dots(PLACES, (160, 120))] * 30, np.arange(30) / 30.0, np.zeros(16_000, np.float32)
    )
    with pytest.raises(VideoWithoutSound, match="silent sound"):
        read_sound(silent)


def test_written_videos_are_read_back(tmp_path: Path) -> None:
    assert write_video(tmp_path / "w.mp4", [dots(PLACES, (161, 121))] * 20, 25.0) == 20
    info = probe(tmp_path / "w.mp4")
    assert info.size == (160, 120) and info.num_frames == 20 and info.fps == pytest.approx(25.0, rel=1e-3)
    rgb = next(read_pictures(info)).rgb
    np.testing.assert_allclose(place_of(rgb, 1), PLACES[1], atol=1.0)


def test_the_same_video_twice_is_found_under_another_name(tmp_path: Path) -> None:
    first = still(tmp_path / "cam1.mp4")
    second = tmp_path / "cam2.mp4"
    second.write_bytes(first.read_bytes())
    with pytest.raises(SameVideoTwice, match="cam1.mp4 and cam2.mp4"):
        require_different({path: file_hash(path) for path in (first, second)})


def test_a_recorded_trial(shared_data: Path) -> None:
    info = probe(
        shared_data / "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial/videos/cam02.mp4"
    )
    assert (info.size, info.num_frames, info.fps) == ((1080, 1920), 100, pytest.approx(60.0))
    with pytest.raises(VideoWithoutSound, match="silent sound"):
        read_sound(info.path)
