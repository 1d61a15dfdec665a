"""Pictures of the road's steps: drawn whatever was found, and what they show is where it should be."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from solver_backend.camera_calibration.pictures import PAPER, Canvas
from solver_backend.io.png import read_png
from solver_backend.types import JointSet
from solver_backend.videos.pipeline.pictures import (
    COLOURS,
    cameras_picture,
    clocks_picture,
    detections_picture,
    draw_boards,
    mosaic,
)
from solver_backend.videos.sync.clocks import Clocks
from solver_backend.videos.video_detections import VideoDetections
from tests.support.camera_ring import ring
from tests.support.videos import write_dots


@pytest.fixture(autouse=True)
def _without_opencv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)


def seen(video: Path, frames: int, sure: float) -> VideoDetections:
    rng = np.random.default_rng([frames, int(video.stem[-1])])
    return VideoDetections(
        video, "hash", "a detector", JointSet.COCO_17, (160, 120), np.arange(frames) / 30.0,
        rng.uniform(20, 100, (frames, 1, 17, 2)), np.full((frames, 1, 17), sure), np.zeros((frames, 1), int),
    )  # fmt: skip


def test_footage_shows_who_was_found_and_is_shown_where_nobody_was(tmp_path: Path) -> None:
    pytest.importorskip("av")
    places = np.tile(np.array([[30.0, 25.0], [120.0, 40.0], [80.0, 95.0]]), (5, 1, 1))
    videos = [write_dots(tmp_path / f"cam{c}.mp4", places, np.arange(5) / 30.0) for c in range(2)]
    with_somebody = detections_picture([seen(v, 5, 0.9) for v in videos], tmp_path / "a.png")
    with_nobody = detections_picture([seen(v, 5, 0.0) for v in videos], tmp_path / "b.png")
    white = [int((read_png(path) > 250).all(-1).sum()) for path in (with_somebody, with_nobody)]
    assert white[0] > white[1] + 100


@pytest.mark.parametrize(("frames", "sure"), [((90, 90), 0.9), ((90, 90), 0.0), ((90, 1), 0.9), ((1, 1), 0.9)])
def test_clocks_are_drawn_whatever_was_found(tmp_path: Path, frames: tuple[int, int], sure: float) -> None:
    found = [seen(tmp_path / f"cam{c}.mp4", n, sure) for c, n in enumerate(frames)]
    picture = read_png(clocks_picture(found, Clocks.alike(("cam0", "cam1")), tmp_path / "sync.png"))
    near = [np.abs(picture.astype(int) - colour).sum(-1) < 150 for colour in COLOURS[:2]]
    drawn = [int(one[:, :500].sum()) for one in near]  # the names stand right of that
    assert (min(drawn) > 400) == (frames == (90, 90))


def test_cameras_stand_in_the_plan_as_they_do_from_above(tmp_path: Path) -> None:
    cameras = ring(4)
    way = np.stack([np.linspace(-0.5, 0.5, 20), np.zeros(20), np.ones(20)], axis=-1)
    way[3] = np.nan
    picture = read_png(cameras_picture(cameras, way, tmp_path / "cameras.png"))
    middles = np.array([np.argwhere((picture == colour).all(-1)).mean(0) for colour in COLOURS[:4]])[:, ::-1]
    plan = np.stack([middles[:, 0], -middles[:, 1]], axis=-1)
    plan, true = (a - a.mean(0) for a in (plan, cameras.centres[:, :2]))
    scale = (plan * true).sum() / (true**2).sum()
    assert np.abs(plan - scale * true).max() < 0.35 * np.abs(plan).max()


def test_names_and_amounts_stay_in_the_picture_and_off_the_curves(tmp_path: Path) -> None:
    cameras = ring(4)
    way = np.zeros((2, 3))
    drawn = read_png(cameras_picture(cameras, way, tmp_path / "cameras.png"))
    edge = np.concatenate([drawn[:, :3].reshape(-1, 3), drawn[:, -3:].reshape(-1, 3)])
    assert not any((np.abs(edge.astype(int) - colour).sum(-1) < 60).any() for colour in COLOURS[:4])
    found = [seen(tmp_path / f"cam{c}.mp4", 90, 0.9) for c in range(2)]
    clocks = read_png(clocks_picture(found, Clocks.alike(("cam0", "cam1")), tmp_path / "sync.png"))
    names = clocks[:200, 590:]
    assert all((np.abs(names.astype(int) - colour).sum(-1) < 90).any() for colour in COLOURS[:2])
    curves = clocks[:, :560]
    assert (np.abs(curves.astype(int) - COLOURS[0]).sum(-1) < 150).sum() > 400
    assert not (np.abs(clocks[:, 580:588].astype(int) - PAPER).sum(-1) > 60).any()
    assert Canvas().text_width("mm") > Canvas().text_width("m") > 0


def test_no_board_seen_is_an_empty_picture(tmp_path: Path) -> None:
    assert (read_png(draw_boards(tmp_path, ["cam0"], tmp_path / "boards.png")) == PAPER).all()


def test_a_canvas_takes_points_outside_and_unknown_ones(tmp_path: Path) -> None:
    canvas = Canvas(60, 40)
    canvas.line(np.array([[np.nan, 1.0], [5, 5], [500, 5], [np.nan, np.nan], [3, 30], [20, 30]]), COLOURS[0], 2)
    canvas.dots(np.array([[np.nan, 0], [30, 20]]), COLOURS[1])
    assert (canvas.rgb[5, 59] == COLOURS[0]).all() and (canvas.rgb[20, 30] == COLOURS[1]).all()
    assert (canvas.rgb[30, 40] == PAPER).all()
    sizes = [
        np.full((10, 30, 3), 200, np.uint8),
        np.full((30, 10, 3), 200, np.uint8),
        np.full((5, 5, 3), 200, np.uint8),
    ]
    assert (mosaic(sizes, ["a", "ü", "c"]).rgb == 200).all(-1).sum() > 1000


def test_a_small_picture_has_the_means_of_a_large_one() -> None:
    rng = np.random.default_rng(2)
    large = rng.integers(0, 256, (90, 120, 3), dtype=np.uint8)
    canvas = Canvas(40, 30)
    canvas.picture(0, 0, 40, 30, large)
    means = large.reshape(30, 3, 40, 3, 3).mean((1, 3))
    assert np.abs(canvas.rgb - means).max() <= 0.5001


def test_letters_differ_and_keep_their_place() -> None:
    shown = {}
    for letter in "".join(map(chr, range(33, 127))):
        canvas = Canvas(30, 30)
        canvas.text(8, 20, letter, size=1.0)
        rows, columns = np.nonzero((canvas.rgb != PAPER).any(-1))
        assert len(rows) and rows.min() >= 0 and columns.max() <= 8 + canvas.text_width(letter, 1.0)
        shown.setdefault(canvas.rgb.tobytes(), []).append(letter)
    unknown = next(same for same in shown.values() if "?" in same)
    assert all(len(same) == 1 for same in shown.values() if same is not unknown)
    assert not any(letter.isalnum() or letter in ".,-+%:/_()" for letter in unknown)
