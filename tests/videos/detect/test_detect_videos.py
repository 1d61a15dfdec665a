from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import solver_backend.videos.detect.detect_videos as detecting
from research.simulation.filming import around
from solver_backend.cli.main import main
from solver_backend.exchange.diagnostics import Where
from solver_backend.exchange.errors import CalibrationMismatch, Cancelled, CaptureInvalid, NoDetections
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.footage import VideoHeader, with_sizes_of
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.png import read_png
from solver_backend.types import Detections, JointSet
from solver_backend.videos.detect import assemble
from solver_backend.videos.detect.assemble import assembled, everybody, in_video_pixels
from solver_backend.videos.detect.detect_videos import Glance, detect_videos, joint_set_of
from solver_backend.videos.detect.detector import DetectorOutputsUnknown, chosen_detector
from solver_backend.videos.files.video import SameVideoTwice, VideoUnreadable
from solver_backend.videos.pipeline.pictures import glances_picture
from solver_backend.videos.sync.clocks import Clocks, at_times
from solver_backend.videos.sync.synchronise import speeds
from solver_backend.videos.video_detections import VideoDetections, read_detections, write_detections
from tests.support.pose_models import write_rtmpose
from tests.support.videos import write_dots, write_timed_video

pytest.importorskip("av")
pytest.importorskip("onnxruntime")
FRAMES = 20


def tracks(seed: int) -> np.ndarray:
    """Return (F, 3, 2) of three dots that wander apart."""
    rng = np.random.default_rng(seed)
    start = np.array([[30.0, 25.0], [120.0, 40.0], [80.0, 95.0]])
    return start + np.cumsum(rng.normal(0, 1.0, (FRAMES, 3, 2)), axis=0)


@pytest.fixture
def filmed(tmp_path: Path) -> tuple[list[Path], Path]:
    """Return two videos and a model."""
    folder = tmp_path / "take" / "videos"
    folder.mkdir(parents=True)
    times = np.arange(FRAMES) / 30.0
    videos = [write_dots(folder / f"cam{c}.mp4", tracks(c), times) for c in (1, 2)]
    return videos, write_rtmpose(tmp_path / "model.onnx")


def test_detections_of_videos_are_found_and_kept(
    filmed: tuple[list[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    videos, model = filmed
    told: list[tuple[int, int]] = []
    choice = chosen_detector(str(model))
    found = detect_videos(videos, choice, tmp_path / "kept", lambda stage, done, total: told.append((done, total)))
    for c, item in enumerate(found, start=1):
        assert item.joint_set is JointSet.COCO_17 and item.size == (160, 120) and (item.track[:, 0] == 0).all()
        np.testing.assert_allclose(item.times_s, np.arange(FRAMES) / 30.0, atol=1e-3)
        # Rows of the model's answer are 1.5 to 2 px; dots are told by their upper left corner.
        np.testing.assert_allclose(item.xy[:, 0, :3], tracks(c), atol=4.5)
    assert told[-1] == (2 * FRAMES, 2 * FRAMES)
    monkeypatch.setattr(detecting, "DetectorProcess", None)  # nothing is started again
    again = detect_videos(videos, choice, tmp_path / "kept")
    np.testing.assert_allclose(again[1].xy, found[1].xy, atol=1e-3, equal_nan=True)
    videos[0].touch()
    assert detect_videos(videos, choice, tmp_path / "kept")[0].video_hash == found[0].video_hash


def test_pictures_are_shown_with_their_people_while_others_are_searched(
    filmed: tuple[list[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    videos, model = filmed
    monkeypatch.setattr(detecting, "_POLL_S", 0.01)
    monkeypatch.setattr(detecting, "_GLANCE_S", 0.0)
    shown: list[Glance] = []
    detect_videos(videos, chosen_detector(str(model)), tmp_path / "kept", jobs=1, show=shown.extend)
    assert {glance.video for glance in shown} == set(videos)
    for glance in shown:
        places = glance.people[0, :3, :2]
        way = tracks(videos.index(glance.video) + 1)
        assert np.abs(way - places).max((1, 2)).min() < 4.5, "on the dots of one of the pictures"
    names = {video: video.parent.name for video in videos}
    drawn = read_png(glances_picture(shown[-1:], tmp_path / "detect.png", names))
    white = (drawn == 255).all(-1)
    assert white.sum() > 3 * 20 and glances_picture([], tmp_path / "none.png", {}).is_file()


@pytest.mark.parametrize(("cores", "jobs", "threads"), [(1, 0, 1), (2, 0, 1), (8, 0, 4), (8, 1, 8), (3, 0, 1)])
def test_two_videos_share_all_cores(
    filmed: tuple[list[Path], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    cores: int,
    jobs: int,
    threads: int,
) -> None:
    given: list[int] = []

    def start(choice: object, count: int) -> None:
        given.append(count)
        raise Cancelled("It was only looked at.")

    monkeypatch.setattr(detecting, "usable_cores", lambda: cores)
    monkeypatch.setattr(detecting, "DetectorProcess", start)
    with pytest.raises(Cancelled):
        detect_videos(filmed[0], chosen_detector(str(filmed[1])), tmp_path / "kept", jobs=jobs)
    assert set(given) == {threads}


def test_a_changed_video_is_done_again(filmed: tuple[list[Path], Path], tmp_path: Path) -> None:
    videos, model = filmed
    detect_videos(videos, chosen_detector(str(model)), tmp_path / "kept")
    write_dots(videos[1], tracks(7), np.arange(FRAMES) / 30.0)
    found = detect_videos(videos, chosen_detector(str(model)), tmp_path / "kept")
    np.testing.assert_allclose(found[1].xy[:, 0, :3], tracks(7), atol=4.5)
    assert len(list((tmp_path / "kept").iterdir())) == 3


def test_cancelling_ends_the_processes_and_leaves_nothing(filmed: tuple[list[Path], Path], tmp_path: Path) -> None:
    videos, model = filmed

    def cancel(stage: str, done: int, total: int) -> None:
        raise Cancelled("The work was cancelled.")

    with pytest.raises(Cancelled):
        detect_videos(videos, chosen_detector(str(model)), tmp_path / "kept", cancel, jobs=1)
    assert not [path for path in (tmp_path / "kept").iterdir() if path.name.startswith(".")]


def test_bad_videos_have_a_name(filmed: tuple[list[Path], Path], tmp_path: Path) -> None:
    videos, model = filmed
    choice = chosen_detector(str(model))
    copy = videos[0].with_name("cam3.mp4")
    copy.write_bytes(videos[0].read_bytes())
    with pytest.raises(SameVideoTwice, match="cam1.mp4 and cam3.mp4"):
        detect_videos([*videos, copy], choice, tmp_path / "kept")
    copy.write_bytes(b"")
    with pytest.raises(VideoUnreadable, match="no bytes"):
        detect_videos([*videos, copy], choice, tmp_path / "kept")


def test_a_number_of_keypoints_that_no_joint_set_has() -> None:
    with pytest.raises(DetectorOutputsUnknown, match="21 keypoints"):
        joint_set_of({"name": "hand", "num_keypoints": 21})


def test_the_verb_writes_a_capture_and_previews(
    filmed: tuple[list[Path], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    videos, model = filmed
    out = tmp_path / "out" / "capture.npz"
    command = [
        "cameras detect",
        str(videos[0].parent),
        "--out",
        str(out),
        "--detector",
        str(model),
        "--sync",
        "none",
        "--json",
    ]
    assert main([*command, "--preview", str(tmp_path / "out")]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    capture = read_capture(out)
    assert result["event"] == "result" and capture.cameras is None and capture.keypoints is not None
    assert capture.keypoints.xy.shape == (2, FRAMES, 17, 2) and capture.keypoints.fps == 30.0
    assert [path.name for path in capture.footage if path] == ["cam1.mp4", "cam2.mp4"]
    assert (tmp_path / "out" / "cam2_detections.mp4").is_file()
    assert "cameras_not_calibrated" in [item.code for item in capture.problems]


def detections(**changes) -> VideoDetections:
    times = np.arange(30) / 30.0
    line = np.stack([100.0 + 60.0 * times, 50.0 + 30.0 * times], axis=-1)
    xy = np.broadcast_to(line[:, None, None], (30, 1, 17, 2)) + np.arange(17)[:, None] * 5.0
    plain = VideoDetections(
        Path("cam1.mp4"), "h", "d", JointSet.COCO_17, (640, 480), times, xy, np.ones((30, 1, 17)),
        np.zeros((30, 1), int),
    )  # fmt: skip
    return replace(plain, **changes)


def test_views_of_other_rates_and_offsets_come_to_the_same_moments() -> None:
    first = detections()
    times = np.cumsum(np.r_[3.0, np.tile([1 / 25, 1 / 50, 1 / 30], 10)])  # uneven, its clock begins at 3 s
    line = np.stack([100.0 + 60.0 * (times - 3.0 + 0.2), 50.0 + 30.0 * (times - 3.0 + 0.2)], axis=-1)
    xy = np.broadcast_to(line[:, None, None], (31, 1, 17, 2)) + np.arange(17)[:, None] * 5.0
    second = detections(
        video=Path("cam2.mp4"), times_s=times, xy=xy, confidence=np.ones((31, 1, 17)), track=np.zeros((31, 1), int)
    )
    clocks = replace(Clocks.alike(("cam1", "cam2")), offset_s=np.array([0.0, -0.2]), method="test")
    capture = assembled("t", [first, second], clocks, None)
    (late,) = [item for item in capture.notes if item.code == "clock_estimated"]
    assert late.where.cameras == ("cam2",) and late.values["offset_ms"] == -200
    keypoints = capture.keypoints
    assert keypoints is not None and keypoints.num_frames == 24  # 0.2 s to 29/30 s
    np.testing.assert_allclose(keypoints.xy[0], keypoints.xy[1], atol=1e-3)


def test_videos_of_other_lengths_rates_and_intervals_are_noted_by_camera() -> None:
    times = np.r_[np.arange(5), np.arange(7, 12)] / 25.0  # two pictures lack
    short = detections(
        video=Path("cam2.mp4"), times_s=times, xy=np.ones((10, 1, 17, 2)), confidence=np.ones((10, 1, 17)),
        track=np.zeros((10, 1), int),
    )  # fmt: skip
    capture = assembled("t", [detections(), short], Clocks.alike(("cam1", "cam2")), None)
    found = {item.code: item for item in (*capture.notes, *capture.problems)}
    assert found["intervals_uneven"].where == Where("cam2.mp4", cameras=("cam2",))
    assert found["intervals_uneven"].values["gap_ms"] == pytest.approx(120.0)
    assert found["video_rates_differ"].values["rates"] == ["25", "30"]
    assert found["common_time_short"].values["longest"] == pytest.approx(29 / 30, abs=1e-5)
    assert {"detector_used", "person_chosen", "cameras_not_calibrated"} <= set(found)


def test_detections_in_step_are_not_touched() -> None:
    both = [detections(), detections(video=Path("cam2.mp4"))]
    keypoints = assembled("t", both, Clocks.alike(("cam1", "cam2")), None).keypoints
    assert keypoints is not None
    np.testing.assert_array_equal(keypoints.xy[0], both[0].xy[:, 0].astype(np.float32))


def test_a_lying_person_is_chosen_before_a_smaller_standing_one() -> None:
    line = np.linspace(0.0, 1.0, 17)
    lying, standing = (np.stack([a * line, b * line], axis=-1) for a, b in ((300.0, 40.0), (60.0, 200.0)))
    xy = np.broadcast_to(np.stack([standing, lying]), (30, 2, 17, 2))
    pair = detections(xy=xy, confidence=np.ones((30, 2, 17)), track=np.tile([0, 1], (30, 1)))
    keypoints = assembled("t", [pair, pair], Clocks.alike(("a", "b")), None).keypoints
    assert keypoints is not None
    np.testing.assert_allclose(keypoints.xy[0, 5], lying, atol=1e-4)
    few = np.arange(17) < 4
    lone = detections(xy=xy, confidence=np.tile(np.stack([0.0 * few, few]), (30, 1, 1)), track=pair.track)
    keypoints = assembled("t", [lone, lone], Clocks.alike(("a", "b")), None).keypoints
    assert keypoints is not None
    np.testing.assert_array_equal(keypoints.confidence[0, 5], few)


def test_no_hands_are_resampled_where_no_video_has_any(monkeypatch: pytest.MonkeyPatch) -> None:
    resampled: list[int] = []

    def counted(values: np.ndarray, *times: np.ndarray) -> np.ndarray:
        resampled.append(values.ndim)
        return at_times(values, *times)

    monkeypatch.setattr(assemble, "at_times", counted)
    found, _ = everybody([detections(), detections()], Clocks.alike(("a", "b")))
    assert found.hands is None and resampled == [4, 3, 4, 3]
    hands = np.ones((30, 1, 2, 21, 3))
    found, _ = everybody([detections(), detections(hands=hands)], Clocks.alike(("a", "b")))
    assert found.hands is not None and np.isnan(found.hands[0]).all() and (found.hands[1] == 1).all()


def test_nobody_and_no_common_time_have_a_name() -> None:
    nobody = detections(confidence=np.zeros((30, 1, 17)))
    with pytest.raises(NoDetections, match="did not find a person"):
        assembled("t", [nobody, nobody], Clocks.alike(("a", "b")), None)
    late = replace(Clocks.alike(("a", "b")), offset_s=np.array([0.0, 5.0]))
    with pytest.raises(NoDetections, match="do not overlap"):
        assembled("t", [detections(), detections()], late, None)


def calibrated(width: int, height: int) -> Calibration:
    cameras = around(np.array([[0.0, 0.0, 1.0]] * 2), 2)
    sizes = np.array([[width, height]] * 2)
    return Calibration(replace(cameras, image_size=sizes), Path("calib.toml"), (True, True))


def test_a_calibration_of_another_shape_of_picture_is_refused_and_a_larger_one_scaled() -> None:
    both = [detections(), detections(video=Path("cam2.mp4"))]  # 640 x 480
    with pytest.raises(CalibrationMismatch, match="for 480 x 640 px, but the video has 640 x 480 px") as caught:
        assembled("t", both, Clocks.alike(("a", "b")), calibrated(480, 640))
    assert "portrait" in caught.value.hint
    large, (note, _) = in_video_pixels(calibrated(1280, 960), both)
    np.testing.assert_allclose(large.K[0, 0, 0], 0.5 * calibrated(1280, 960).cameras.K[0, 0, 0])
    assert tuple(large.image_size[1]) == (640, 480) and note.code == "calibration_scaled"
    cut, (note, _) = in_video_pixels(calibrated(648, 480), both)
    np.testing.assert_array_equal(cut.K, calibrated(648, 480).cameras.K)
    assert note.code == "calibration_scaled" and note.where.cameras == ("cam01",)


def test_a_calibration_in_stored_pixels_fits_a_video_that_is_shown_wider(tmp_path: Path) -> None:
    picture = np.zeros((120, 120, 3), np.uint8)
    path = write_timed_video(tmp_path / "v.mp4", [picture] * 3, np.arange(3) / 30.0, aspect=Fraction(4, 3))
    both = [detections(video=path), detections(video=Path("cam2.mp4"))]  # 640 x 480
    fitted, (note, *_) = in_video_pixels(calibrated(480, 480), both[:1])
    K, before = fitted.K[0], calibrated(480, 480).cameras.K[0]
    np.testing.assert_allclose([K[0, 0] / before[0, 0], K[1, 1] / before[1, 1]], [4 / 3, 1.0])
    assert tuple(fitted.image_size[0]) == (640, 480) and note.code == "calibration_scaled"
    with pytest.raises(CalibrationMismatch):
        in_video_pixels(calibrated(480, 480), both)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (np.zeros(0), "times do not increase"), (np.full(30, np.nan), "times do not increase"),
        (-np.arange(30.0), "times do not increase"), (np.zeros(30), "frame rate must be"),
        (np.r_[np.arange(29) / 30.0, 1e9], r"span 1e\+09 s"),
    ],
)  # fmt: skip
def test_times_that_cannot_be_are_named(times: np.ndarray, message: str) -> None:
    with pytest.raises(CaptureInvalid, match=message):
        detections(times_s=times)


def test_points_beyond_any_picture_are_missing_ones() -> None:
    sound = detections()
    xy = sound.xy.copy()
    xy[0, 0, 0], xy[1, 0, 0] = (np.nan, 5.0), (1e30, 5.0)
    found = detections(xy=xy)
    assert (found.confidence[:2, 0, 0] == 0).all() and np.isnan(found.xy[:2, 0, 0]).all()
    assert (found.confidence[2:] == sound.confidence[2:]).all()


def test_one_picture_has_no_speeds() -> None:
    assert speeds(np.ones((1, 17, 2)), np.zeros(1), JointSet.COCO_17).values.shape[0] == 1


@pytest.mark.parametrize(("changed", "words"), [({"xy": 16}, "do not match"), ({"size": 0}, "image size")])
def test_a_damaged_file_of_detections_is_detected_again(tmp_path: Path, changed: dict[str, int], words: str) -> None:
    points = np.zeros((2, 1, 17, 2))
    facts = "v.mp4", "ab12", "detector", JointSet.COCO_17, (640, 480), np.arange(2) / 30
    path = tmp_path / "v.npz"
    write_detections(path, VideoDetections(tmp_path / facts[0], *facts[1:], points, points[..., 0], np.zeros((2, 1))))
    arrays = dict(np.load(path))
    if "xy" in changed:
        arrays |= {key: arrays[key][:, :, : changed["xy"]] for key in ("xy", "confidence")}
    else:
        arrays["size"] = np.zeros(2)
    np.savez(path, **arrays)
    with pytest.raises(CaptureInvalid, match=f"{words}.*Detect the video again"):
        read_detections(path, tmp_path / "v.mp4")


def test_images_that_a_codec_filled_up_are_no_other_size() -> None:
    """A calibration on decoded blocks of 16 pixels has 1088 rows for a video of 1080."""
    points = np.full((2, 3, 1, 17, 2), 100.0)
    seen = Detections(("a", "b"), points, np.ones(points.shape[:-1]), JointSet.COCO_17)
    for height, codes in ((1088, []), (1096, ["video_size_differs"] * 2)):
        made = with_sizes_of(calibrated(1920, height), [VideoHeader(30.0, 3, (1920, 1080))] * 2, seen)
        assert [item.code for item in made.problems] == codes
        np.testing.assert_array_equal(made.cameras.image_size, [[1920, height]] * 2)
