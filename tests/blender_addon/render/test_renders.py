"""Renders: the body is where the cameras see its joints, footage is straight, the video has the take's time."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.lens import distort, normalised, pixels
from blender_addon._exchange.progress import silent
from blender_addon.render.contact_sheet import open_lettering, render_contact_sheet
from blender_addon.render.picture import draw_dots, layer_from_render, write_png
from blender_addon.render.preview import PreviewSettings, preview_frames, render_preview
from blender_addon.render.stage import RenderQuality, encode_video, open_footage, open_stage
from blender_addon.render.subject import DETECTION_DOT, KEYPOINT_DOT, RenderedTake, footage_backdrop
from blender_addon.render.view import View
from blender_addon.scene.bake import BakedTake, bake_take
from blender_addon.scene.cameras import Footage


@pytest.fixture
def subject(take: BakedTake, files: Any) -> RenderedTake:
    return RenderedTake(take, files.motion, files.body, files.capture)


@pytest.mark.parametrize("index", range(4))
def test_body_is_rendered_where_its_joints_project(subject: RenderedTake, tmp_path: Path, index: int) -> None:
    """Also with unlike focal lengths, an off-centre principal point and a cut-out window."""
    camera = subject.capture.cameras[index]
    view = View(camera, (camera.image_size[0] // 6, camera.image_size[1] // 6))
    with open_stage("test", (subject.take.body,), view, RenderQuality(shrink=1), tmp_path) as stage:
        for frame in (0, 44):
            alpha = layer_from_render(stage.render(float(subject.times[frame])))[..., 3]
            uv, _ = view.project(subject.joints[frame])
            at = np.round(uv).astype(int)
            inside = (at >= 0).all(axis=1) & (at < view.size).all(axis=1)
            covered = alpha[at[inside, 1], at[inside, 0]] > 0
            assert covered.mean() > 0.9, "joints lie inside the body"
            window = view.window(subject.joints[frame])
            assert window is not None
            x0, y0, x1, y1 = window
            assert alpha.sum() == alpha[y0:y1, x0:x1].sum() > 100, "nothing of the body is outside the window"
            part = layer_from_render(stage.render(float(subject.times[frame]), (x0, y0, x1, y1)))[..., 3]
            assert part.shape == (y1 - y0, x1 - x0)
            assert np.abs(part - alpha[y0:y1, x0:x1]).mean() < 0.002


@pytest.mark.slow
def test_contact_sheet_shows_poses_and_cameras_and_leaves_the_scene(
    scene: bpy.types.Scene, subject: RenderedTake, tmp_path: Path
) -> None:
    heard, before = [], _census()
    frame, engine = scene.frame_current, scene.render.engine
    render_contact_sheet(tmp_path / "sheet.png", subject, lambda *step: heard.append(step))
    assert _census() == before
    assert (scene.frame_current, scene.render.engine, bpy.context.scene) == (frame, engine, scene)
    assert heard[-1] == ("rendering the contact sheet", 16, 16)
    sheet = _read_png(tmp_path / "sheet.png")
    assert sheet.shape[1] == 1580
    cells = [sheet[y : y + 330, x : x + 260] for y in (0, 334) for x in range(0, 1580, 264)]
    for cell in cells:
        blue = (cell[..., 2].astype(int) - cell[..., 0] > 40).mean()
        assert 0.02 < blue < 0.5, "a body in a blue suit stands in every cell"
    assert len({cell.tobytes() for cell in cells}) == 12


@pytest.mark.slow
def test_video_plays_the_take_at_its_speed(subject: RenderedTake, tmp_path: Path) -> None:
    path = tmp_path / "walk.mp4"
    settings = PreviewSettings(size=(320, 180), most_fps=10.0)
    render_preview(path, subject, silent, settings)
    with open_footage(Footage((path,)), (320, 180), tmp_path) as reader:
        assert reader.length == 20
        assert reader.scene.render.fps / reader.scene.render.fps_base == pytest.approx(10.0)
        first, last = reader.image(0), reader.image(19)
    assert np.abs(first.astype(int) - last).mean() > 0.5
    orange = (first[..., 0].astype(int) - first[..., 2] > 80).sum()
    assert orange > 30, "detections are drawn"


def test_video_without_a_capture_shows_a_view_of_our_own(scene: bpy.types.Scene, files: Any, tmp_path: Path) -> None:
    take = bake_take(scene, files.motion, files.body)
    subject = RenderedTake(take, files.motion, files.body)
    render_preview(tmp_path / "a.mp4", subject, silent, PreviewSettings(size=(160, 90), most_frames=3))
    with open_footage(Footage((tmp_path / "a.mp4",)), (160, 90), tmp_path) as reader:
        assert reader.length == 3
        picture = reader.image(1).astype(int)
    assert (picture[..., 2] - picture[..., 0] > 30).sum() > 50


@pytest.mark.parametrize(
    ("frames", "fps", "shown", "video_fps"),
    [
        (100, 30.0, 100, 30.0),
        (100, 59.94, 50, 29.97),
        (101, 120.0, 26, 30.0),
        (100, 50.0, 50, 25.0),
        (1000, 25.0, 360, 25.0),
    ],
)
def test_fast_takes_are_thinned_at_their_own_speed(frames: int, fps: float, shown: int, video_fps: float) -> None:
    found, rate = preview_frames(frames, fps, PreviewSettings())
    assert len(found) == shown and rate == pytest.approx(video_fps)
    assert found[-1] / fps == pytest.approx((shown - 1) / rate)


def test_footage_is_read_in_order_and_straightened(files: Any, tmp_path: Path) -> None:
    """A sequence that shows bent detections: straightened, the dots lie where detections are drawn."""
    camera = files.capture.cameras[1]
    view = View(camera, (640, 360))
    spots = np.array([[120.0, 80.0], [500.0, 300.0], [320.0, 180.0]])
    bent = pixels(distort(normalised(spots, view.K), camera.distortion, "opencv"), view.K)
    assert np.linalg.norm(bent - spots, axis=1).max() > 3
    for number in range(3):
        picture = np.full((360, 640, 3), 40 * number, np.uint8)
        draw_dots(picture, bent, 5.0, (1.0, 1.0, 1.0))
        write_png(tmp_path / f"frame_{number:03d}.png", picture)
    footage = Footage(tuple(sorted(tmp_path.glob("frame_*.png"))))
    with ExitStack() as stack:
        backdrop = footage_backdrop(stack, footage, view, tmp_path)
        pictures = [backdrop(index) for index in (0, 1, 2, 7)]
    assert [int(p[10, 320, 0]) for p in pictures] == [0, 40, 80, 80]
    for u, v in spots:
        cut = pictures[0][int(v) - 12 : int(v) + 13, int(u) - 12 : int(u) + 13, 0].astype(float)
        y, x = np.mgrid[-12:13, -12:13]
        assert abs((cut * x).sum() / cut.sum()) < 0.3 and abs((cut * y).sum() / cut.sum()) < 0.3


def test_video_keeps_colours(scene: bpy.types.Scene, tmp_path: Path) -> None:
    colours = [(200, 40, 40), (40, 180, 60), (60, 80, 200), (128, 128, 128)]
    files = []
    for i, colour in enumerate(colours):
        files.append(tmp_path / f"c_{i}.png")
        write_png(files[-1], np.full((32, 64, 3), colour, np.uint8))
    encode_video(files, (64, 32), 24000 / 1001, tmp_path / "c.mp4")
    with open_footage(Footage((tmp_path / "c.mp4",)), (64, 32), tmp_path) as reader:
        found = [reader.image(i)[16, 32] for i in range(4)]
    np.testing.assert_allclose(found, colours, atol=8)


def test_detections_follow_time_and_fall_back_to_keypoints(subject: RenderedTake) -> None:
    view = View(subject.capture.cameras[0], (480, 270))
    xy, colour = subject.detections(view)
    assert colour == DETECTION_DOT and xy.shape == (60, 24, 2)
    fast = replace(subject, capture=replace(subject.capture, fps=60.0))
    late, _ = fast.detections(View(fast.capture.cameras[0], (480, 270)))
    np.testing.assert_array_equal(late[10], xy[20])
    assert np.isnan(late[30:]).all()
    bare = replace(subject, capture=replace(subject.capture, xy=None))
    points, colour = bare.detections(view)
    assert colour == KEYPOINT_DOT and points.shape == (60, 17, 2) and np.isnan(points[30, 3]).all()


def test_words_are_written(scene: bpy.types.Scene, tmp_path: Path) -> None:
    picture = np.zeros((30, 200, 3), np.uint8)
    with open_lettering(tmp_path, 20) as letters:
        letters.write(picture, "cam 1 ü", 4, 5)
        letters.write(picture, "", 4, 5)
    assert (picture[5:25] > 200).any() and picture[5:25, 4:].any(axis=2).sum() > 600
    assert not picture[:5].any() and not picture[25:].any()


def _census() -> dict[str, int]:
    kinds = (
        "scenes",
        "objects",
        "cameras",
        "meshes",
        "materials",
        "curves",
        "collections",
        "actions",
        "node_groups",
    )
    return {kind: len(getattr(bpy.data, kind)) for kind in kinds}


def _read_png(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    width, height = image.size
    values = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    return np.round(values.reshape(height, width, 4)[::-1, :, :3] * 255).astype(np.uint8)
