"""The path of a carried camera from the background of its video, and what shows no path."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from solver_backend.camera_calibration.extrinsics.camera_path import Tracks, estimate_path
from solver_backend.cameras.projection import project
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.camera_paths import read_camera_path
from solver_backend.types import Cameras, JointSet
from solver_backend.videos.detect.follow_camera import follow_camera, without_camera_motion
from solver_backend.videos.video_detections import VideoDetections
from tests.support.carried_camera import camera_way
from tests.support.textured_room import picture, textures

cv2 = pytest.importorskip("cv2")
WIDTH, HEIGHT, FRAMES, FPS = 480, 270, 36, 30.0
KEYPOINTS = JointSet.COCO_17.num_keypoints


def camera() -> Cameras:
    K = np.array([[[400.0, 0, (WIDTH - 1) / 2], [0, 400.0, (HEIGHT - 1) / 2], [0, 0, 1]]])
    return Cameras(("phone",), K, np.zeros((1, 8)), np.eye(3)[None], np.zeros((1, 3)), np.array([[WIDTH, HEIGHT]]))


def pelvis(frames: int = FRAMES) -> np.ndarray:
    time = np.arange(frames) / FPS
    return np.stack([-0.6 + 1.2 * time, 0.3 * np.sin(time), np.ones(frames)], axis=1)


def seen(R: np.ndarray, t: np.ndarray) -> VideoDetections:
    """Return a person of 17 keypoints around the pelvis."""
    body = np.random.default_rng(0).uniform([-0.25, -0.25, -1.0], [0.25, 0.25, 0.7], (KEYPOINTS, 3))
    xy = np.asarray(project(camera().carried(R, t), pelvis()[:, None] + body))[0]
    return VideoDetections(
        Path("walk.mp4"), "", "none", JointSet.COCO_17, (WIDTH, HEIGHT), np.arange(FRAMES) / FPS, xy[:, None],
        np.ones((FRAMES, 1, KEYPOINTS)), np.zeros((FRAMES, 1), dtype=int),
    )  # fmt: skip


def filmed(found: VideoDetections, R: np.ndarray, t: np.ndarray) -> Iterator[np.ndarray]:
    """Yield pictures of a textured room, with a dark body that hides a part of it."""
    walls = textures(cv2)
    for frame in range(FRAMES):
        shown = picture(cv2, walls, camera(), R[frame], t[frame])
        low, high = found.xy[frame, 0].min(axis=0), found.xy[frame, 0].max(axis=0)
        cv2.ellipse(shown, (((low + high) / 2).tolist(), (high - low).tolist(), 0.0), (40, 40, 40), -1)
        yield shown


def off_m(R: np.ndarray, centre: np.ndarray, truth: tuple[np.ndarray, np.ndarray]) -> tuple[float, float]:
    """Return the mean error of places after the best similarity, and the walked distance, metres."""
    true = -np.einsum("fba,fb->fa", *truth)
    s, Q, q = umeyama(centre, true, with_scale=True)
    walked = np.linalg.norm(np.diff(true[::5], axis=0), axis=1).sum()
    return float(np.linalg.norm(s * centre @ Q.T + q - true, axis=1).mean()), float(walked)


@pytest.mark.slow
@pytest.mark.parametrize("style", ["hand-held", "orbit"])
def test_a_path_is_found_in_pictures_of_a_room(style: str, tmp_path: Path) -> None:
    R, t = camera_way(pelvis(), FPS, style, 5)
    t = t * 0.75  # so that the camera stays in the room
    found = seen(R, t)
    out = follow_camera(found, camera(), filmed(found, R, t), tmp_path / "camera_path.txt")
    assert out is not None
    path = read_camera_path(out, FRAMES, FPS)
    error, walked = off_m(path.R, path.centre, (R, t))
    assert error < 0.02 * walked


def tracks(R: np.ndarray, t: np.ndarray, noise_px: float = 0.4, life: int = 30) -> np.ndarray:
    """Return (F, P, 2) tracks of points of a room, each for ``life`` frames, one of twenty adrift."""
    rng = np.random.default_rng(2)
    X = rng.uniform([-5, -5, 0], [5, 5, 3], (3600, 3))
    X[:1800, 1] = 5.0
    px = np.asarray(project(camera().carried(R, t), np.tile(X, (len(R), 1, 1))))[0]
    px = np.where(((px >= 0) & (px < [WIDTH, HEIGHT])).all(-1, keepdims=True), px, np.nan)
    px += noise_px * rng.normal(size=px.shape)
    start = rng.integers(10 - life, len(R) - 8, px.shape[1])
    number = np.arange(len(R))[:, None]
    px = np.where(((number >= start) & (number < start + life))[..., None], px, np.nan)
    px[:, ::20] += 0.5 * number[..., None]
    return px[:, np.isfinite(px).all(-1).sum(axis=0) >= 8]


@pytest.mark.parametrize("style", ["hand-held", *(pytest.param(s, marks=pytest.mark.slow) for s in ("dolly", "orbit"))])
def test_tracked_points_tell_the_path(style: str) -> None:
    R, t = camera_way(pelvis(60), FPS, style, 3)
    found = estimate_path(camera(), Tracks.of(tracks(R, t)))
    assert found is not None and found.error_px < 1.0
    error, walked = off_m(found.R, -np.einsum("fba,fb->fa", found.R, found.t), (R, t))
    assert error < 0.01 * walked


@pytest.mark.slow
def test_a_path_that_half_of_the_background_contradicts_is_no_path() -> None:
    R, t = camera_way(pelvis(60), FPS, "hand-held", 3)
    shown = tracks(R, t)
    middle, number = camera().K[0, :2, 2], np.arange(60)
    wobbling = middle + (shown - middle) * (1.0 + 0.15 * np.sin(number / 5.0))[:, None, None]
    drifting = shown + (np.arange(shown.shape[1]) % 2 * number[:, None])[..., None] * [3.0, 0.0]
    assert estimate_path(camera(), Tracks.of(wobbling)) is None
    assert estimate_path(camera(), Tracks.of(drifting)) is None


def test_a_path_can_start_after_a_turn() -> None:
    R, t = camera_way(pelvis(60), FPS, "hand-held", 3)
    turn = exp_so3(np.linspace(-0.3, 0.0, 25)[:, None] * [0.0, 1.0, 0.0])
    R = np.concatenate([turn @ R[0], R])
    t = np.concatenate([turn @ t[0], t])
    found = estimate_path(camera(), Tracks.of(tracks(R, t)))
    assert found is not None
    error, walked = off_m(found.R, -np.einsum("fba,fb->fa", found.R, found.t), (R, t))
    assert error < 0.02 * walked


def test_a_path_starts_after_a_long_stand_and_pan() -> None:
    R, t = camera_way(pelvis(60), FPS, "hand-held", 3)
    turn = exp_so3(np.linspace(-1.6, 0.0, 110)[:, None] * [0.0, 1.0, 0.0])
    still = np.tile(turn[0] @ R[0], (40, 1, 1)), np.tile(turn[0] @ t[0], (40, 1))
    R, t = np.concatenate([still[0], turn @ R[0], R]), np.concatenate([still[1], turn @ t[0], t])
    found = estimate_path(camera(), Tracks.of(tracks(R, t)))
    assert found is not None
    centre = -np.einsum("fba,fb->fa", found.R, found.t)
    error, walked = off_m(found.R, centre, (R, t))
    assert error < 0.02 * walked
    moved = np.linalg.norm(centre[:140] - centre[0], axis=1).max() / np.linalg.norm(centre[-1] - centre[0])
    assert moved < 0.02
    off = log_so3(found.R @ found.R[-1].T @ R[-1] @ R.swapaxes(-1, -2))
    assert np.degrees(np.linalg.norm(off, axis=1)).max() < 1.0


def with_a_stop(style: str, seed: int, moving: int, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return camera poses of 60 frames in motion and a stop of some frames before those from ``moving`` on."""
    R, t = camera_way(pelvis(moving + 60), FPS, style, seed)
    number = np.concatenate([np.arange(60), np.full(frames, 59), np.arange(60, moving + 60)])
    return R[number], t[number]


@pytest.mark.parametrize(("style", "seed"), [("hand-held", 3), pytest.param("orbit", 7, marks=pytest.mark.slow)])
def test_a_camera_that_stops_after_its_walk_keeps_its_path(style: str, seed: int) -> None:
    """Rays to a point that is tracked only while the camera stands meet anywhere."""
    R, t = with_a_stop(style, seed, 0, 40)
    found = estimate_path(camera(), Tracks.of(tracks(R, t)))
    assert found is not None
    centre, true = (-np.einsum("fba,fb->fa", *poses) for poses in ((found.R, found.t), (R, t)))
    s, Q, q = umeyama(centre, true, with_scale=True)
    assert np.linalg.norm(s * centre @ Q.T + q - true, axis=1).max() < 0.03


def test_a_long_stop_before_points_that_stay_keeps_the_path() -> None:
    """Few tracks start in motion and outlast the stop. They determine poses, but not an adjustment of the keyframes."""
    R, t = with_a_stop("hand-held", 3, 0, 150)
    found = estimate_path(camera(), Tracks.of(tracks(R, t, life=200)[:, ::4]))
    assert found is not None
    centre, true = (-np.einsum("fba,fb->fa", *poses) for poses in ((found.R, found.t), (R, t)))
    s, Q, q = umeyama(centre, true, with_scale=True)
    assert np.linalg.norm(s * centre @ Q.T + q - true, axis=1).max() < 0.03


@pytest.mark.slow
def test_a_stop_without_common_points_shows_no_path() -> None:
    """Nothing transfers the scale across it."""
    R, t = with_a_stop("hand-held", 3, 60, 50)
    assert estimate_path(camera(), Tracks.of(tracks(R, t))) is None


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "frames"), [(4, 5), (4, 10)])
def test_a_fast_pan_shows_no_path_or_keeps_the_scale(seed: int, frames: int) -> None:
    R, t = camera_way(pelvis(90), FPS, "hand-held", seed)
    pan = exp_so3(np.clip((np.arange(90) - 42) / frames, 0.0, 1.0)[:, None] * np.radians(80.0) * [0.0, 1.0, 0.0])
    R, t = pan @ R, np.einsum("fab,fb->fa", pan, t)
    found = estimate_path(camera(), Tracks.of(tracks(R, t)))
    assert (found is None) == (frames == 5)
    if found is not None:
        error, walked = off_m(found.R, -np.einsum("fba,fb->fa", found.R, found.t), (R, t))
        assert error < 0.01 * walked


def test_memory_of_tracks_grows_with_the_pictures() -> None:
    names = tuple(np.arange(10 * n, 10 * n + 400) for n in range(3000))
    long = Tracks(names, tuple(np.zeros((400, 2)) + n for n in range(3000)))
    tracemalloc.start()
    table = long.table([1000, 1001, 1039])
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()
    assert table.shape == (3, 790, 2)
    assert np.isnan(table[2, :390]).all() and (table[2, 390:] == 1039).all()
    assert np.isfinite(table[:2]).all(-1).all(axis=0).sum() == 390


def test_a_turn_a_zoom_and_too_few_points_show_no_path() -> None:
    R, t = camera_way(pelvis(40), FPS, "hand-held", 3)
    centre = -R[0].T @ t[0]
    turned = tracks(R, -np.einsum("fab,b->fa", R, centre))
    still = tracks(np.tile(R[:1], (40, 1, 1)), np.tile(t[:1], (40, 1)))
    middle = camera().K[0, :2, 2]
    zoomed = middle + (still - middle) * np.linspace(1.0, 1.6, 40)[:, None, None]
    for shown in (turned, zoomed, still, tracks(R, t)[:, :15]):
        assert estimate_path(camera(), Tracks.of(shown)) is None
    blank = replace(seen(R[:FRAMES], t[:FRAMES]))
    grey = (np.full((HEIGHT, WIDTH, 3), 90, np.uint8) for _ in range(FRAMES))
    assert follow_camera(blank, camera(), grey, Path("unused.txt")) is None


@pytest.mark.parametrize("pictures", [0, 30])
def test_a_video_with_fewer_pictures_than_detections_shows_no_path(tmp_path: Path, pictures: int) -> None:
    R, t = camera_way(pelvis(), FPS, "hand-held", 5)
    found, out = seen(R, t), tmp_path / "camera_path.txt"
    few = islice(filmed(found, R, t * 0.75), pictures)
    assert follow_camera(found, camera(), few, out) is None and not out.exists()


@pytest.mark.slow
def test_only_a_carried_camera_gets_a_path(tmp_path: Path) -> None:
    R, t = camera_way(pelvis(), FPS, "hand-held", 5)
    t = t * 0.75
    calibration = Calibration(camera(), tmp_path, (True,))
    for name, moves in (("carried", True), ("still", False)):
        poses = (R, t) if moves else (np.tile(R[:1], (FRAMES, 1, 1)), np.tile(t[:1], (FRAMES, 1)))
        folder = tmp_path / name
        folder.mkdir()
        found = replace(seen(*poses), video=folder)
        for number, shown in enumerate(filmed(found, *poses)):
            cv2.imwrite(str(folder / f"{number:04d}.png"), shown[..., ::-1])
        out = tmp_path / f"{name}.txt"
        detections, world, diagnostics = without_camera_motion((found,), calibration, WorldSettings(), out)
        assert detections[0] is found and not diagnostics
        assert world.camera_path == (str(out) if moves else "") and out.exists() is moves
    given = WorldSettings(camera_path="path.txt")
    assert without_camera_motion((found,), calibration, given, out) == ((found,), given, [])
