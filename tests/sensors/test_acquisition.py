"""One sensor's markers: where they are, how sure that is, and what is no marker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from solver_backend.cameras.projection import project
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.sensors.acquisition import acquire
from solver_backend.sensors.acquisition import blobs as bright
from solver_backend.sensors.acquisition.acquire import (
    SUNLIGHT,
    Acquisition,
    Ring,
    SensorLens,
    ring_depths,
    split_merged,
)
from solver_backend.sensors.acquisition.blobs import (
    Blobs,
    connected,
    joined,
    learned_mask,
    shapes_of,
    threshold_of,
)
from solver_backend.sensors.devices.device import PicturesDiffer, SensorUnknown
from tests.support.sensor_pictures import Painter, sensors_around, spread_points

CAMERAS = sensors_around()
PAINTER = Painter(CAMERAS)


def acquired(points: np.ndarray, seed: int = 0, painter: Painter = PAINTER):
    return Acquisition(CAMERAS, "sensor1")(painter.frame(1, points, seed))


def nearest(found: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return, of each found point, its distance to the true ones and which is nearest."""
    off = np.linalg.norm(found[:, None] - points, axis=-1)
    return off.min(1)


@pytest.mark.parametrize("seed", range(4))
def test_patches_are_those_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bright = rng.random((61, 47)) < (0.02, 0.2, 0.35, 0.6)[seed]
    patch, count = connected(np.flatnonzero(bright), 47)
    label = np.zeros(bright.shape, np.int32)
    assert ndimage.label(bright, np.ones((3, 3)), output=label) == count  # type: ignore[arg-type]
    pairs = np.unique(np.stack([label[bright], patch]), axis=1)
    assert pairs.shape[1] == count, "one of ours is one of theirs"


def test_a_long_winding_chain_is_one_component() -> None:
    order = np.random.default_rng(0).permutation(500)
    component, count = joined(501, order[:-1], order[1:])
    assert count == 2 and len(np.unique(component[order])) == 1


def test_nothing_is_no_patch() -> None:
    assert connected(np.zeros(0, np.int64), 640) == (pytest.approx([]), 0)


def test_markers_are_found_in_space_within_their_noise() -> None:
    points = spread_points(25)
    errors, squares = [], []
    for seed in range(3):
        seen = acquired(points, seed)
        assert len(seen) == 25 and np.isfinite(seen.depth).all()
        off = seen.points[:, None] - points
        which = np.linalg.norm(off, axis=-1).argmin(1)
        assert len(set(which.tolist())) == 25
        error = off[np.arange(25), which]
        errors.append(error)
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(seen.covariance), error))
    assert 1e3 * np.sqrt((np.concatenate(errors) ** 2).sum(1).mean()) < 2.0
    # A covariance that is too small makes fusion refuse what belongs together, one too large joins strangers.
    assert 0.15 < np.median(np.concatenate(squares)) / 2.366 < 1.5


def test_the_middle_lies_behind_the_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    points = spread_points(20)
    seen = acquired(points)
    monkeypatch.setattr(acquire, "SETTINGS", replace(acquire.SETTINGS, surface_radii=0.0))
    shallow = acquired(points)
    assert 1e3 * np.linalg.norm(seen.points - shallow.points, axis=1) == pytest.approx(14.0 / 3.0, rel=1e-6)
    way = (seen.points - seen.origin) / np.linalg.norm(seen.points - seen.origin, axis=1, keepdims=True)
    which = np.linalg.norm(seen.points[:, None] - points, axis=-1).argmin(1)
    assert abs(1e3 * ((seen.points - points[which]) * way).sum(1).mean()) < 0.5


def test_without_depth_a_marker_is_a_ray() -> None:
    points = spread_points(12)
    frame = replace(PAINTER.frame(1, points), depth=None)
    seen = Acquisition(CAMERAS, "sensor1")(frame)
    assert len(seen) == 12 and not np.isfinite(seen.depth).any()
    way = points - seen.origin
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    angle = np.arccos(np.clip((seen.direction @ way.T).max(1), -1, 1))
    assert angle.max() < 5 * seen.sigma_ray.min()


def test_two_markers_in_one_blob_are_two() -> None:
    # Side by side before the sensor, their discs touching.
    lens = SensorLens(CAMERAS, 1)
    across = lens.R[0]
    middle = np.array([0.0, 0.0, 1.0])
    points = np.stack([middle - 0.012 * across, middle + 0.012 * across, *spread_points(9, 3)])
    keep = np.r_[True, True, np.linalg.norm((points[2:] - middle) @ np.c_[across, lens.R[1]], axis=1) > 0.12]
    points = points[keep]
    seen = acquired(points)
    assert len(seen) == len(points)
    first = nearest(points[:2], seen.points)
    assert 1e3 * first.max() < 8.0
    sigma = np.sqrt(np.trace(seen.covariance, axis1=1, axis2=2))
    of_pair = np.linalg.norm(seen.points - middle, axis=1) < 0.03
    assert sigma[of_pair].mean() > sigma[~of_pair].mean(), "what was split is told to be less sure"


@pytest.mark.parametrize("apart", [7.0, 8.0, 9.0])
def test_three_markers_whose_lower_halves_are_hidden_are_three(apart: float) -> None:
    # Their area is that of one and a half, and halves of such a row are no discs.
    radius, middles = 4.0, 12.0 + apart * np.arange(3)
    y, x = np.mgrid[:24, :48]
    bright = (((x[..., None] - middles) ** 2 + (y[..., None] - 12.0) ** 2).min(-1) <= radius**2) & (y <= 12)
    pixel = np.flatnonzero(bright)
    blobs = Blobs(pixel, np.zeros(len(pixel), int), np.ones(len(pixel)), 1, 48)
    none = Ring(np.zeros(0, int), np.zeros(0, int), np.zeros(0))
    found, _, parts = split_merged(blobs, shapes_of(blobs), none, np.array([radius]))
    assert found.count == 3 and parts.all()
    assert np.sort(shapes_of(found).centre[:, 0]) == pytest.approx(middles, abs=1.0)


def test_lens_table_and_projection_are_each_others_inverse() -> None:
    lens, points = SensorLens(CAMERAS, 2), spread_points(40)
    px = project(CAMERAS, points)[2]
    flat = lens.undistorted(px)
    camera = points @ lens.R.T + lens.t
    true, depth = camera[:, :2] / camera[:, 2:], camera[:, 2]
    assert np.abs(flat - true).max() < 1e-6
    assert np.abs(lens.points(flat, depth) - points).max() < 1e-5
    assert np.isnan(lens.undistorted(np.array([[-40.0, 5.0], [1e9, 0.0], [np.nan, 1.0]]))).all()


def test_the_covariance_is_that_of_draws() -> None:
    lens = SensorLens(CAMERAS, 0)
    rng = np.random.default_rng(1)
    flat, depth = np.array([[0.3, -0.2]]), np.array([2.1])
    told = lens.covariances(flat, depth, np.array([0.4]), np.array([0.006]))[0]
    draws = 200_000
    drawn = flat + rng.normal(size=(draws, 2)) * 0.4 / lens.focal
    points = lens.points(drawn, depth + rng.normal(size=draws) * 0.006)
    assert np.cov(points.T) == pytest.approx(told, abs=0.03 * np.trace(told))


def test_a_ring_on_two_surfaces_has_the_depth_of_most_of_it() -> None:
    rng = np.random.default_rng(0)
    depth = np.concatenate([2.0 + 0.004 * rng.normal(size=26), rng.uniform(1.4, 1.7, 14)])
    ring = Ring(np.arange(40), np.zeros(40, int), depth)
    found = ring_depths(ring, 2)
    assert found.depth[0] == pytest.approx(2.0, abs=0.004)
    assert np.isnan(found.depth[1]) and found.count[1] == 0
    even = Ring(np.arange(40), np.zeros(40, int), np.r_[np.full(20, 2.0), np.linspace(1.4, 1.7, 20)])
    assert np.isnan(ring_depths(even, 1).depth[0]), "half and half agrees on nothing"


@pytest.mark.parametrize(("behind", "known"), [(0, True), (3, True), (6, False), (14, False)])
def test_a_ring_of_which_a_part_lies_behind_is_an_occluders(behind: int, known: bool) -> None:
    depth = 2.0 + 0.004 * np.random.default_rng(0).normal(size=40)
    depth[:behind] += 0.4
    found = ring_depths(Ring(np.arange(40), np.zeros(40, int), depth), 1)
    assert np.isfinite(found.depth[0]) == known
    assert found.rough[0] == pytest.approx(2.0, abs=0.01), "how large its blob should be is told nevertheless"


def test_a_marker_in_a_gap_between_fingers_is_a_ray() -> None:
    points = spread_points(12)
    frame = PAINTER.frame(1, points)
    assert frame.depth is not None
    whole = acquired(points)
    infrared, depth = frame.infrared.copy(), frame.depth.copy()
    x, y = np.round(whole.px[0]).astype(int)
    for hand in (np.s_[y - 9 : y - 1, x - 9 : x + 10], np.s_[y + 2 : y + 10, x - 9 : x + 10]):
        infrared[hand], depth[hand] = 900, round(1e3 * whole.depth[0]) - 150
    seen = Acquisition(CAMERAS, "sensor1")(replace(frame, infrared=infrared, depth=depth))
    of_gap = np.linalg.norm(seen.px - whole.px[0], axis=1).argmin()
    assert len(seen) == 12 and np.isnan(seen.depth[of_gap]), "most of its ring is the hand's"
    assert np.isfinite(np.delete(seen.depth, of_gap)).all()
    assert seen.direction[of_gap] @ whole.direction[0] > 0.99999


def test_a_sliver_that_blinds_no_pixel_is_a_ray() -> None:
    frame = PAINTER.frame(1, spread_points(12))
    infrared = frame.infrared.copy()
    infrared[40:43, 60:63] = 30000
    seen = Acquisition(CAMERAS, "sensor1")(replace(frame, infrared=infrared))
    of_sliver = np.linalg.norm(seen.px - [61, 41], axis=1).argmin()
    assert len(seen) == 13 and seen.px[of_sliver] == pytest.approx([61, 41], abs=0.1)
    assert np.isnan(seen.depth[of_sliver]), "its ring is of the wall that it lies on"
    assert np.isfinite(np.delete(seen.depth, of_sliver)).all()


def test_a_sensor_whose_markers_never_saturate_has_their_depths() -> None:
    frame = PAINTER.frame(1, spread_points(12))
    seen = Acquisition(CAMERAS, "sensor1")(replace(frame, infrared=frame.infrared // 2))
    assert len(seen) == 12 and np.isfinite(seen.depth).all()


def test_lamps_of_the_empty_scene_are_no_markers() -> None:
    lamp = PAINTER.frame(1, np.zeros((0, 3)))
    lit = lamp.infrared.copy()
    lit[100:110, 200:206] = 65535
    points = spread_points(10)
    frame = PAINTER.frame(1, points)
    seen = replace(frame, infrared=np.maximum(frame.infrared, lit))
    mask = learned_mask([lit, lamp.infrared])
    assert 60 < mask.sum() < 400
    assert len(Acquisition(CAMERAS, "sensor1")(seen)) > 10
    assert len(Acquisition(CAMERAS, "sensor1", mask)(seen)) == 10
    assert len(Acquisition(CAMERAS, "sensor1", mask)(replace(lamp, infrared=lit))) == 0


def test_the_threshold_follows_the_room() -> None:
    dark, light = (PAINTER.frame(1, spread_points(5)), Painter(CAMERAS, background=9000.0).frame(1, spread_points(5)))
    assert threshold_of(light.infrared) > 5 * threshold_of(dark.infrared)
    assert len(Acquisition(CAMERAS, "sensor1")(light)) == 5
    eight = replace(dark, infrared=(dark.infrared >> 8).astype(np.uint8))
    assert len(Acquisition(CAMERAS, "sensor1")(eight)) == 5, "8 bits are read as 16 are"


def test_sunlight_is_said_and_not_looked_into(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = PAINTER.frame(1, spread_points(10))
    sunny = frame.infrared.copy()
    sunny[:, :300] = 65535
    seen = Acquisition(CAMERAS, "sensor1")(replace(frame, infrared=sunny))
    assert len(seen) == 0 and seen.finding == SUNLIGHT
    snow = np.where(np.random.default_rng(0).random(sunny.shape) < 0.03, 65535, frame.infrared).astype(np.uint16)
    monkeypatch.setattr(bright, "SETTINGS", replace(bright.SETTINGS, least_pixels=1))
    assert Acquisition(CAMERAS, "sensor1")(replace(frame, infrared=snow)).finding == SUNLIGHT


@pytest.mark.parametrize("value", [0, 255, 65535])
def test_pictures_without_markers_have_none(value: int) -> None:
    frame = PAINTER.frame(1, np.zeros((0, 3)))
    flat = replace(frame, infrared=np.full_like(frame.infrared, value))
    assert len(Acquisition(CAMERAS, "sensor1")(flat)) == 0
    assert len(acquired(np.zeros((0, 3)))) == 0


def test_pictures_of_other_sizes_and_unknown_sensors_are_named() -> None:
    frame = PAINTER.frame(1, spread_points(3))
    acquisition = Acquisition(CAMERAS, "sensor1")
    for wrong in (
        replace(frame, depth=frame.depth[:-1]), replace(frame, infrared=frame.infrared[:, :-2]),
        replace(frame, infrared=frame.infrared.astype(np.float32)),
        replace(frame, depth=frame.depth.astype(np.float32)),
    ):  # fmt: skip
        with pytest.raises(PicturesDiffer, match="sizes|bits"):
            acquisition(wrong)
    with pytest.raises(PicturesDiffer, match="mask"):
        Acquisition(CAMERAS, "sensor1", np.zeros((10, 10), dtype=bool))
    with pytest.raises(SensorUnknown, match="sensor9"):
        Acquisition(CAMERAS, "sensor9")


def test_a_calibration_of_impossible_pictures_is_refused() -> None:
    size = np.tile([400.0, 360_000.0], (len(CAMERAS.names), 1))
    with pytest.raises(CalibrationInvalid, match="400 x 360000 pixels"):
        Acquisition(replace(CAMERAS, image_size=size), "sensor1")
