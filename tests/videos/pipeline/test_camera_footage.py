"""Folders of footage as people have them: side by side, a folder a camera, chapters, pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.camera_calibration.boards.footage import board_footage
from solver_backend.io.footage import join_chapters, parts_of
from solver_backend.videos.pipeline.layout import NoVideos, look_through


def touch(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    return root


def takes(root: Path) -> dict[str, dict[str, str]]:
    return {
        take.name: {c: v.relative_to(root).as_posix() for c, v in zip(take.cameras, take.videos, strict=True)}
        for take in look_through(root).takes
    }


def test_a_folder_a_camera_with_one_take(tmp_path):
    root = touch(tmp_path / "walk", "left/trial1.mp4", "right/trial1.mp4", "calibration/Calib.toml")
    assert takes(root) == {"walk": {"left": "left/trial1.mp4", "right": "right/trial1.mp4"}}


def test_a_folder_a_camera_with_several_takes(tmp_path):
    root = touch(tmp_path, *(f"cam_0{c}/{take}.mp4" for c in (1, 2, 10) for take in ("jump", "walk")))
    found = takes(root)
    assert list(found) == ["jump", "walk"]
    assert found["walk"] == {f"cam_0{c}": f"cam_0{c}/walk.mp4" for c in (1, 2, 10)}


def test_takes_with_several_videos_each_are_no_cameras(tmp_path):
    root = touch(tmp_path, *(f"{take}/cam{c}.mp4" for take in ("jump", "walk") for c in (1, 2)))
    assert takes(root)["jump"] == {"cam1": "jump/cam1.mp4", "cam2": "jump/cam2.mp4"}


def test_pictures_of_each_camera_are_footage(tmp_path):
    root = touch(tmp_path / "dance", *(f"images/0{c}/{f:06d}.jpg" for c in (1, 2) for f in range(3)))
    assert takes(root) == {"dance": {"01": "images/01", "02": "images/02"}}
    assert [p.name for p in parts_of(root / "images" / "01")] == [f"{f:06d}.jpg" for f in range(3)]


def test_opencaps_tree(tmp_path):
    cameras = [f"Videos/Cam{c}/InputMedia" for c in (0, 1)]
    names = [f"{camera}/{take}/{take}{end}" for camera in cameras for take in ("squat", "walk")
             for end in (".mov", "_sync.mp4")]  # fmt: skip
    root = touch(tmp_path, *names, "Videos/Cam0/OutputMedia/walk/walk.mp4", "Videos/Cam1/OutputMedia/walk/walk.mp4")
    assert takes(root) == {
        take: {f"Cam{c}": f"Videos/Cam{c}/InputMedia/{take}/{take}_sync.mp4" for c in (0, 1)}
        for take in ("squat", "walk")
    }


@pytest.mark.parametrize(
    ("names", "recordings"),
    [
        (["GX010101", "GX020101", "GX030101", "GX010102"], [["GX010101", "GX020101", "GX030101"], ["GX010102"]]),
        (["GH010007", "GH020007", "GX010007"], [["GH010007", "GH020007"], ["GX010007"]]),
        (["GOPR0012", "GP010012", "GP020012", "GOPR0013"], [["GOPR0012", "GP010012", "GP020012"], ["GOPR0013"]]),
        (["left_GX010101", "left_GX020101", "right_GX010101"],
         [["left_GX010101", "left_GX020101"], ["right_GX010101"]]),
        (["GX020101", "GX010102"], [["GX010102"], ["GX020101"]]),
        (["GX010101", "GX030101"], [["GX010101"], ["GX030101"]]),
        (["cam1", "cam2"], [["cam1"], ["cam2"]]),
    ],
)  # fmt: skip
def test_chapters_are_one_recording(names, recordings):
    found = join_chapters(Path(f"{name}.MP4") for name in reversed(names))
    assert [[path.stem for path in parts] for parts in found] == recordings


def test_chapters_of_one_camera_are_a_take_of_one(tmp_path):
    [take] = look_through(touch(tmp_path, "GX010101.MP4", "GX020101.MP4")).takes
    assert [path.name for path in take.videos] == ["GX010101.MP4"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(NoVideos, match="Chapters such as"):
        look_through(tmp_path / "empty")


def test_chapters_are_read_one_after_the_other(tmp_path):
    import numpy as np

    pytest.importorskip("av")
    from solver_backend.videos.files.video import probe, read_pictures
    from tests.support.videos import write_dots

    tracks = np.random.default_rng(0).uniform(20, 100, (6, 3, 2))
    for number in (1, 2):
        write_dots(tmp_path / f"GX0{number}0101.mp4", tracks, [0.1 * f for f in range(6)])
    info = probe(tmp_path / "GX010101.mp4")
    assert info.num_frames == 12 and info.fps == pytest.approx(10.0, rel=0.01)
    times = [picture.time_s for picture in read_pictures(info)]
    np.testing.assert_allclose(times, info.times_s, atol=1e-3)
    np.testing.assert_allclose(np.diff(times), 0.1, atol=2e-3)


def test_board_pictures_one_folder_deeper(tmp_path):
    root = touch(tmp_path, *(f"{camera}/calibration_images/{f}.jpg" for camera in ("back", "top") for f in range(2)))
    assert board_footage(root).extrinsic == {c: root / c / "calibration_images" for c in ("back", "top")}
    videos = touch(tmp_path / "videos", "cam1/board.mp4", "cam2/board.mp4")
    assert board_footage(videos).extrinsic == {c: videos / c / "board.mp4" for c in ("cam1", "cam2")}


def test_two_spellings_of_a_camera_are_one(tmp_path):
    root = touch(tmp_path, "cam1.mp4", "cam2.mp4", "cam01/001.png", "cam02/001.png", "cam3/001.png")
    found = board_footage(root).extrinsic
    assert found == {"cam1": root / "cam1.mp4", "cam2": root / "cam2.mp4", "cam3": root / "cam3"}


def test_pictures_below_a_folder_of_a_calibration_are_not_its_footage(tmp_path):
    root = touch(tmp_path / "session", "videos/cam1.mp4", "videos/cam2.mp4", "calibration/notes/photos/IMG.jpg")
    assert look_through(root).footage == ()
    touch(root, "calibration/cam1/001.png", "calibration/cam2/board.mp4")
    [footage] = look_through(root).footage
    folder = root / "calibration"
    assert footage.cameras == {"cam1": folder / "cam1", "cam2": folder / "cam2" / "board.mp4"}
