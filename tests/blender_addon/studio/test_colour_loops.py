"""Through Blender's pixels and back: dots and a board are found where the written cameras say they are."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pytest
from scipy import ndimage

from blender_addon.studio.colour_film import film_in_colour
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.png import read_png
from solver_backend.types import Cameras
from tests.support.blob_reading import triangulated
from tests.support.studio_shots import board, board_points, colour_shot, dots

COLUMNS, ROWS, SQUARE_M = 8, 6, 0.11
PAIR = {"preset": "webcam_ring_4", "layout": "corners", "count": 2, "room_m": [3.8, 3.8], "height_m": 1.3}


def cameras_of(folder: Path) -> Cameras:
    cameras = read_capture(folder / "clean.npz").cameras
    assert cameras is not None
    return cameras


@pytest.mark.slow
def test_keypoints_drawn_as_dots_are_found_within_three_tenths_of_a_pixel(tmp_path: Path) -> None:
    folder = colour_shot(tmp_path, camera_arrays=[PAIR], seed=4)
    capture = read_capture(folder / "clean.npz")
    points = np.asarray(capture.truth["keypoints3d"])
    assert film_in_colour(folder, stand_in=dots(points)) == 2
    cameras, keypoints = capture.require_multiview()
    errors = []
    for view, name in enumerate(cameras.names):
        grey = read_png(folder / "rgb" / name / "000000.png").max(axis=2).astype(float)
        bright = np.maximum(grey - np.median(grey) - 3, 0.0)
        label, count = cast(tuple[np.ndarray, int], ndimage.label(bright > 0))
        blobs = np.array(ndimage.center_of_mass(bright, label, range(1, count + 1)))[:, ::-1]
        true = keypoints.xy[view, 0]
        apart = np.linalg.norm(true[:, None] - true[None], axis=-1) + 1e6 * np.eye(len(true))
        for xy in true[np.isfinite(true).all(axis=1) & (np.nanmin(apart, axis=1) > 18)]:
            errors.append(np.linalg.norm(blobs - xy, axis=1).min())
    assert len(errors) > 12
    assert max(errors) < 0.3


@pytest.mark.slow
def test_corners_of_a_board_reproject_to_a_tenth_of_a_pixel(tmp_path: Path) -> None:
    turns = [(0.1, -0.2)]
    folder = colour_shot(tmp_path, frames=len(turns), camera_arrays=[PAIR])
    cameras = cameras_of(folder)
    # The board stands where both cameras look, and faces a place between them.
    middle = triangulated(cameras, [0, 1], cameras.K[:, :2, 2])
    towards = cameras.centres.mean(axis=0) - middle
    towards /= np.linalg.norm(towards)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    facing = np.stack([right, np.cross(towards, right), towards], axis=1)
    poses = [(facing @ exp_so3(np.array([a, b, 0.3 * a])), middle + 0.4 * towards) for a, b in turns]
    film_in_colour(folder, stand_in=board(COLUMNS, ROWS, SQUARE_M, poses))
    off, space = [], []
    for frame, (R, t) in enumerate(poses):
        corners = board_points(COLUMNS, ROWS, SQUARE_M) @ R.T + t
        true = project(cameras, corners)
        found = []
        for view in range(2):
            grey = cv2.cvtColor(read_png(folder / "rgb" / cameras.names[view] / f"{frame:06d}.png"), cv2.COLOR_RGB2GRAY)
            good, xy = cv2.findChessboardCornersSB(grey, (COLUMNS, ROWS), flags=cv2.CALIB_CB_ACCURACY)
            assert good, (frame, view)
            distance = np.linalg.norm(xy[:, 0][None] - true[view][:, None], axis=-1)
            found.append(xy[distance.argmin(axis=1), 0])
            off.append(found[-1] - true[view])
        space += [
            triangulated(cameras, [0, 1], np.stack([found[0][k], found[1][k]])) - c for k, c in enumerate(corners)
        ]
    off = np.concatenate(off)
    assert np.abs(off.mean(axis=0)).max() < 0.03, "half a pixel would show here"
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.1
    assert 1e3 * np.sqrt((np.array(space) ** 2).sum(axis=1).mean()) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["workbench"])
def test_the_person_is_where_the_mask_says_and_a_second_run_makes_the_same_pixels(tmp_path: Path, engine: str) -> None:
    given = {"film": ["rgb", "masks"], "looks": ["everyday"], "rgb": {"engine": engine}, "seed": 5}
    first, second = (colour_shot(tmp_path / part, **given) for part in "ab")
    for folder in (first, second):
        assert film_in_colour(folder) == 4
        assert film_in_colour(folder) == 0, "what is there stays"
    names = sorted(p.relative_to(first) for p in (first / "rgb").rglob("*.png"))
    assert all((first / name).read_bytes() == (second / name).read_bytes() for name in names)
    for name in names:
        picture = read_png(first / name).astype(float)
        mask = read_png(first / "masks" / name.relative_to("rgb"))
        edge = np.hypot(*(ndimage.sobel(ndimage.gaussian_filter(picture.mean(axis=2), 1.0), axis=a) for a in (0, 1)))
        person = (mask >= 1) & (mask <= 6)
        rim = person & ~np.asarray(ndimage.binary_erosion(person, iterations=2), bool)
        elsewhere = ~np.asarray(ndimage.binary_dilation(person, iterations=4), bool) & (mask == 9)
        assert np.median(edge[rim]) > 3 * np.median(edge[elsewhere])
