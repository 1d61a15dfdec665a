"""Where a pose stands before a camera: found again from its picture, however many points are wrong or missing."""

import numpy as np

from solver_backend.priors.lifted_take import place_before_camera, smoothed_places

RNG = np.random.default_rng(0)


def scene(frames: int = 20) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points = 0.5 * RNG.normal(size=(frames, 14, 3))
    places = np.stack([RNG.uniform(-1, 1, frames), RNG.uniform(-0.5, 0.5, frames), RNG.uniform(3, 6, frames)], axis=1)
    seen = points + places[:, None]
    return points, places, seen[..., :2] / seen[..., 2:]


def test_a_pose_is_found_where_it_stands() -> None:
    points, places, image = scene()
    np.testing.assert_allclose(place_before_camera(points, image, np.ones(image.shape[:2])), places, atol=1e-6)


def test_wrong_points_lose_their_weight_and_missing_ones_have_none() -> None:
    points, places, image = scene()
    weight = np.ones(image.shape[:2])
    image[:, 0] += 0.4
    image[:, 1], weight[:, 1] = np.nan, 0.0
    off = np.linalg.norm(place_before_camera(points, image, weight) - places, axis=1)
    assert np.median(off) < 0.05
    weight[3] = 0.0
    weight[3, :2] = 1.0
    assert np.isnan(place_before_camera(points, image, weight)[3]).all()


def test_a_pose_behind_the_camera_has_no_place() -> None:
    points, _, image = scene()
    assert np.isnan(place_before_camera(points, -image[::-1], np.ones(image.shape[:2]))).any()


def test_smoothing_keeps_a_straight_line_and_what_is_missing() -> None:
    line = np.linspace(0, 1, 90)[:, None] * [1.0, 2.0, 3.0]
    line[40] = np.nan
    smooth = smoothed_places(line, 30.0)
    assert np.isnan(smooth[40]).all()
    np.testing.assert_allclose(smooth[15:26], line[15:26], atol=1e-3)
    noisy = line + 0.05 * RNG.normal(size=line.shape)
    inner = slice(15, 75)
    assert np.nanstd((smoothed_places(noisy, 30.0) - line)[inner]) < 0.5 * np.nanstd((noisy - line)[inner])
