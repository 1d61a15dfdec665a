"""Pictures as arrays: files, blending, dots, placement and views."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_addon._exchange.lens import distort, normalised, pixels
from blender_addon.errors import RenderFailed
from blender_addon.render.contact_sheet import canvas_size, pack, row
from blender_addon.render.picture import (
    Resampling,
    blend,
    draw_dots,
    layer_from_render,
    read_targa,
    soften_edges,
    write_png,
)
from blender_addon.render.subject import straightening_map
from blender_addon.render.view import View, close_view, look_at, three_quarter_view


def test_png_holds_the_picture(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, size=(7, 5, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", picture)
    data = (tmp_path / "a.png").read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n" and struct.unpack(">II", data[16:24]) == (5, 7)
    start = data.index(b"IDAT")
    length = struct.unpack(">I", data[start - 4 : start])[0]
    rows = np.frombuffer(zlib.decompress(data[start + 4 : start + 4 + length]), np.uint8).reshape(7, 16)
    np.testing.assert_array_equal(rows[:, 1:].reshape(7, 5, 3), picture)


def test_targa_is_read_from_either_end(tmp_path: Path) -> None:
    pixels_bgra = np.random.default_rng(1).integers(0, 256, size=(3, 4, 4), dtype=np.uint8)
    for descriptor, expected in ((0x28, pixels_bgra), (0x08, pixels_bgra[::-1])):
        header = struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, 4, 3, 32, descriptor)
        (tmp_path / "a.tga").write_bytes(header + pixels_bgra.tobytes())
        np.testing.assert_array_equal(read_targa(tmp_path / "a.tga"), expected[..., [2, 1, 0, 3]])
    (tmp_path / "a.tga").write_bytes(header[:17])
    for path in (tmp_path / "a.tga", tmp_path / "missing.tga"):
        with pytest.raises(RenderFailed, match="did not write an image.*OpenGL"):
            read_targa(path)


def test_layer_averages_colour_by_alpha() -> None:
    rendered = np.zeros((2, 2, 4), np.uint8)
    rendered[0, 0] = 200, 100, 50, 255
    layer = layer_from_render(rendered, 2)
    np.testing.assert_allclose(layer[0, 0], np.array([200, 100, 50, 255]) / 4 / 255, atol=1e-6)


def test_blend_is_over_and_cuts_what_lies_outside() -> None:
    picture = np.full((4, 4, 3), 100, np.uint8)
    layer = np.zeros((3, 3, 4), np.float32)
    layer[..., :3], layer[..., 3] = 0.5 * 0.5, 0.5
    blend(picture, layer, 2, -1)
    expected = np.full((4, 4), 100)
    expected[:2, 2:] = round(100 * 0.5 + 0.25 * 255)
    np.testing.assert_array_equal(picture[..., 0], expected)
    blend(picture, layer, 40, 0)


def test_dots_are_centred_to_a_fraction_of_a_pixel() -> None:
    picture = np.zeros((41, 61, 3), np.uint8)
    draw_dots(picture, np.array([[30.3, 20.6], [np.nan, 1], [-50, 3]]), 4.0, (1.0, 1.0, 1.0))
    weight = picture[..., 0].astype(float)
    v, u = np.mgrid[:41, :61]
    np.testing.assert_allclose(
        [(u * weight).sum() / weight.sum(), (v * weight).sum() / weight.sum()], [30.3, 20.6], atol=0.02
    )


def test_resampling_is_bilinear_and_fills_the_outside() -> None:
    v, u = np.mgrid[:20, :30]
    picture = np.stack([u * 4, v * 5, 0 * u], -1).astype(np.uint8)
    uv = np.array([[[3.5, 7.25], [29.0, 19.0], [-0.4, 4.0], [-0.6, 4.0]]])
    found = Resampling(uv, (30, 20), (9, 8, 7))(picture)
    np.testing.assert_array_equal(found[0], [[14, 36, 0], [116, 95, 0], [0, 20, 0], [9, 8, 7]])


def test_soft_edges_change_the_outline_alone() -> None:
    layer = np.zeros((9, 9, 4), np.float32)
    layer[2:7, 2:7] = 0.5, 0.25, 0.125, 1.0
    soft = soften_edges(layer)
    np.testing.assert_array_equal(soft[3:6, 3:6], layer[3:6, 3:6])
    np.testing.assert_allclose(soft[4, [0, 1, 2, 3], 3], [0, 0.25, 0.75, 1])
    np.testing.assert_allclose(soft.sum(axis=(0, 1)), layer.sum(axis=(0, 1)), rtol=1e-6)


def test_tiles_have_the_wanted_area_and_do_not_overlap() -> None:
    four = pack([(1920, 1080)] * 4, (848, 480))
    assert [(t.x, t.y) for t in four] == [(0, 0), (428, 0), (0, 244), (428, 244)] and {t.width for t in four} == {424}
    portrait = pack([(1080, 1920)] * 4, (848, 480))
    assert {t.y for t in portrait} == {0}, "four upright pictures stand side by side"
    assert pack([], (10, 10)) == row([], 10, 10) == []
    for tiles in (four, portrait, pack([(4, 3), (3, 4), (16, 9)], (848, 480)), row([(9, 16), (16, 9)], 1560, 460)):
        width, height = canvas_size(tiles)
        assert width % 2 == height % 2 == 0 and 0.6 < width * height / (848 * 480) < 1.8
        cover = np.zeros((height, width), int)
        for t in tiles:
            assert t.width % 2 == t.height % 2 == 0
            cover[t.y : t.y + t.height, t.x : t.x + t.width] += 1
        assert cover.max() == 1


def test_row_keeps_below_the_most_height_and_is_centred() -> None:
    low = row([(1080, 1920)] * 4, 1580, 460)
    assert {t.height for t in low} == {460} and abs(low[0].x - (1580 - low[-1].x - low[-1].width)) <= 1
    wide = row([(1920, 1080)] * 4, 1580, 460)
    assert 0 <= 1580 - canvas_size(wide)[0] <= 8


def test_view_scales_the_camera_by_pixel_edges(files: Any) -> None:
    camera = files.capture.cameras[1]
    view = View(camera, (camera.image_size[0] // 4, camera.image_size[1] // 4))
    points = files.motion.joints[0]
    full, depth = View(camera, camera.image_size).project(points)
    small, _ = view.project(points)
    np.testing.assert_allclose((small + 0.5) * 4, full + 0.5, atol=1e-9)
    assert (depth > 0).all()
    np.testing.assert_allclose(view.from_detections(files.capture.xy[1, 0]), small, atol=1e-3)


def test_window_holds_the_body(files: Any) -> None:
    view = View(files.capture.cameras[0], (424, 240))
    uv, _ = view.project(files.motion.joints[9])
    window = view.window(files.motion.joints[9])
    assert window is not None
    x0, y0, x1, y1 = window
    assert (uv > [x0, y0]).all() and (uv < [x1, y1]).all() and (x1 - x0) * (y1 - y0) < 0.4 * 424 * 240
    assert view.window(files.motion.joints[9] + [0, 0, 90.0]) is None
    behind = replace(view.camera, R=np.diag([-1.0, 1, -1]) @ view.camera.R, t=np.diag([-1.0, 1, -1]) @ view.camera.t)
    assert View(behind, (424, 240)).window(files.motion.joints[9]) is None


def test_look_at_has_the_target_in_the_middle_and_z_up() -> None:
    camera = look_at("a", np.array([3.0, -2.0, 1.5]), np.array([0.2, 0.1, 1.0]), (400, 300), 0.6)
    view = View(camera, (400, 300))
    uv, _ = view.project(np.array([[0.2, 0.1, 1.0], [0.2, 0.1, 1.3]]))
    np.testing.assert_allclose(uv[0], [199.5, 149.5], atol=1e-9)
    assert uv[1, 1] < uv[0, 1] and abs(uv[1, 0] - uv[0, 0]) < 1e-9


@pytest.mark.parametrize("size", [(400, 300), (200, 500)])
def test_three_quarter_view_frames_everything_from_the_front(size: tuple[int, int]) -> None:
    points = np.random.default_rng(2).uniform([-2, -1, 0], [1, 3, 2], size=(60, 3))
    camera = three_quarter_view(points, 0.7, size)
    uv, depth = View(camera, size).project(points)
    assert (uv > 0).all() and (uv < size).all() and (depth > 0).all()
    towards = -camera.R.T @ camera.t - points.mean(axis=0)
    assert towards @ [np.cos(0.7), np.sin(0.7), 0] > 0 and towards[2] > 0


def test_straightening_map_undoes_the_lens(files: Any) -> None:
    """Where the straight picture shows a point, the map names the recorded pixel of that point."""
    camera = files.capture.cameras[1]
    view = View(camera, (320, 180))
    sources = straightening_map(view, camera.image_size, view.size)
    assert sources is not None
    straight = np.array([100, 60])
    bent = pixels(distort(normalised(straight.astype(float), view.K), camera.distortion, "opencv"), view.K)
    np.testing.assert_allclose(sources[60, 100], bent, atol=1e-9)
    np.testing.assert_allclose(straightening_map(view, (640, 360), view.size), sources, atol=1e-9)


def test_cut_footage_keeps_its_scale(files: Any) -> None:
    """A video of 1080 pixels for a calibration of 1088: pixel 540 of the image is pixel 540 of the video."""
    camera = replace(files.capture.cameras[0], image_size=(1088, 1920))
    view = View(camera, (1088, 1920))
    assert straightening_map(view, (1088, 1920), view.size) is None
    assert straightening_map(view, (544, 960), view.size) is None
    scaled = straightening_map(view, (1080, 1920), view.size)
    assert scaled is not None
    np.testing.assert_allclose((scaled[7, 540] + 0.5) * [1080 / 1088, 1] - 0.5, [540, 7], atol=1e-9)


def test_close_view_is_a_part_of_the_image(files: Any) -> None:
    camera, joints = files.capture.cameras[0], files.motion.joints
    view = close_view(camera, joints, (480, 270))
    x, y, share = view.part
    assert 0.5 <= share < 1 and x >= 0 and y >= 0
    assert x + share * 1920 <= 1920 and y + share * 1080 <= 1080
    uv, _ = view.project(joints)
    assert (uv > 0).all() and (uv < view.size).all(), "the body stays in the picture"
    full, _ = View(camera, camera.image_size).project(joints)
    np.testing.assert_allclose((uv + 0.5) / view.scale + [x, y], full + 0.5, atol=1e-9)
    sources = straightening_map(view, (1920, 1080), (960, 540))
    assert sources is not None
    np.testing.assert_allclose((sources[0, 0] + 0.5) * 2, [x, y] + 0.5 / view.scale, atol=1e-9)
    np.testing.assert_allclose(View(view.pinhole, view.size).K, view.K)
    assert close_view(camera, joints + [0, 0, 500.0], (480, 270)).part == (0.0, 0.0, 1.0)
