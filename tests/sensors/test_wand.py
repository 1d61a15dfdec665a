"""Sensors by a waved wand, in simulation: poses, scale and clocks against the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CommandLineInvalid, FileDamaged, MocapError
from solver_backend.sensors.chain import triggered
from solver_backend.sensors.wand.evaluation import WandOptions
from solver_backend.sensors.wand.session import calibrate_by_wand, robust_umeyama
from solver_backend.sensors.wand.views import (
    Coverage,
    TimesInvalid,
    Wand,
    WandAmbiguous,
    WandInvalid,
    WandNotSeen,
    distances,
    identified,
    middle_from_lights,
    read_points_folder,
    values_and_velocities,
    with_growing_times,
)
from tests.support.waved_wand import Waving, as_tables, pose_errors, sensors, waved

WAND = Wand(0.13, 0.26)


@pytest.mark.parametrize("count", [2, 3, 6])
@pytest.mark.parametrize("seed", [0, 1])
def test_depth_sensors_stand_within_two_millimetres_and_a_tenth_of_a_degree(count: int, seed: int) -> None:
    cameras = sensors(count)
    found = calibrate_by_wand(waved(cameras, Waving(seed=seed)), WandOptions(clocks=triggered(cameras.names)))
    mm, degrees = pose_errors(found.array.cameras, cameras)
    assert mm.max() < 2.0 and degrees.max() < 0.1
    assert (mm < 3.0 * 1e3 * found.array.centre_sigma_m + 1e-6).all()
    assert 0.05 < found.held_out_px < 0.3
    assert found.array.findings == ()


def test_every_sensor_only_takes_moments_that_all_see() -> None:
    cameras = sensors(3)
    views = waved(cameras, Waving(seed=5, hidden=0.3))
    clocks = triggered(cameras.names)
    some = calibrate_by_wand(views, WandOptions(clocks=clocks))
    every = calibrate_by_wand(views, WandOptions(clocks=clocks, every_sensor=True))
    seen = np.stack([np.isfinite(view.px).all((1, 2)) for view in views])
    assert every.moments == seen.all(0).sum() < some.moments == (seen.sum(0) >= 2).sum()
    assert pose_errors(every.array.cameras, cameras)[0].max() < 2.0


@pytest.mark.parametrize("wand", [None, WAND], ids=["depth", "lights"])
@pytest.mark.parametrize("late", [(0.0, 0.0107, -0.0213), (0.0, 1.2107, -2.0213)], ids=["in a frame", "seconds"])
def test_clocks_are_found_from_how_the_wand_moves(wand: Wand | None, late: tuple[float, ...]) -> None:
    cameras = sensors(3)
    found = calibrate_by_wand(waved(cameras, Waving(seed=3, late_s=late), wand), WandOptions(wand))
    assert np.abs(found.clocks.offset_s - late).max() < 0.0003
    mm, degrees = pose_errors(found.array.cameras, cameras)
    assert mm.max() < 2.0 and degrees.max() < 0.1
    assert [(item.code, item.where.cameras) for item in found.array.findings] == [
        ("sensor_clock_differs", (name, cameras.names[0])) for name in cameras.names[1:]
    ]
    ahead_ms = [item.values["size_ms"] for item in found.array.findings]
    assert np.allclose(ahead_ms, 1e3 * found.clocks.offset_s[1:], rtol=1e-4)


def test_the_interleave_of_a_trigger_counts() -> None:
    cameras = sensors(3)
    # Ten times what is usual, so that leaving it out is seen.
    interleave = 10 * 160e-6
    late = tuple(-interleave * c for c in range(3))
    views = waved(cameras, Waving(seed=8, late_s=late, sigma_px=0.05, depth_bias_m=(0.0,)))
    told = calibrate_by_wand(views, WandOptions(clocks=triggered(cameras.names, interleave)))
    not_told = calibrate_by_wand(views, WandOptions(clocks=triggered(cameras.names)))
    assert told.array.rmse_px < 0.6 * not_told.array.rmse_px
    with pytest.raises(CommandLineInvalid, match="interleave"):
        triggered(cameras.names, 0.5)


def test_three_lights_give_poses_in_metres_and_lengths_that_were_not_seen() -> None:
    cameras = sensors(4)
    found = calibrate_by_wand(waved(cameras, Waving(seed=4), WAND), WandOptions(WAND, triggered(cameras.names)))
    mm, degrees = pose_errors(found.array.cameras, cameras)
    assert mm.max() < 1.0 and degrees.max() < 0.03
    assert found.length_rmse_m.max() < 0.001


def test_lights_are_told_apart_in_any_order_and_left_alone_where_unsure() -> None:
    rng = np.random.default_rng(0)
    base = np.array([-0.05, 0.0])
    line = base + np.array([0.0, 0.13, 0.39])[:, None] * np.array([0.6, 0.8]) / 3.0
    orders = np.array([rng.permutation(3) for _ in range(20)])
    order, sure = identified(WAND, line[orders], 1e-4)
    assert sure.all()
    assert (np.take_along_axis(orders, order, axis=1) == [0, 1, 2]).all()
    even = base + np.array([0.0, 0.19, 0.39])[:, None] * np.array([0.6, 0.8]) / 3.0
    bent = line + np.array([[0, 0], [0.02, -0.02], [0, 0]])
    assert not identified(WAND, np.stack([even, bent, np.full((3, 2), np.nan)]), 1e-4)[1].any()


def test_one_picture_of_three_lights_tells_where_the_wand_is() -> None:
    rng = np.random.default_rng(1)
    first = np.array([0.2, -0.3, 2.5])
    along = rng.normal(size=(30, 3)) * [1, 1, 0.4]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    lights = first + np.array([0.0, 0.13, 0.39])[:, None] * along[:, None]
    assert np.allclose(middle_from_lights(WAND, lights[..., :2] / lights[..., 2:]), lights[:, 1], atol=1e-6)
    assert np.allclose(distances(lights), WAND.distances_m)


def test_pairs_of_points_align_despite_a_third_of_outliers() -> None:
    rng = np.random.default_rng(2)
    from solver_backend.geometry.rotations import exp_so3

    R, t = exp_so3(np.array([0.3, -1.2, 0.5])), np.array([1.0, -2.0, 0.5])
    source = rng.uniform(-1, 1, (90, 3))
    target = source @ R.T + t + rng.normal(0, 0.002, (90, 3))
    target[:30] += rng.uniform(-1, 1, (30, 3))
    (found_R, found_t), agree = robust_umeyama(source, target, np.full(90, 0.003), rng)
    assert np.abs(found_R - R).max() < 0.003 and np.abs(found_t - t).max() < 0.003
    assert agree[30:].all() and agree[:30].sum() <= 2


def test_a_track_between_frames_is_a_cubic_and_missing_frames_stay_missing() -> None:
    times = np.arange(10) / 10.0
    values = (1.0 + 2.0 * times - 3.0 * times**2)[:, None]
    values[6] = np.nan
    wanted = np.array([0.2, 0.25, 0.3, 0.55, 0.6, 1.5])
    found, rate = values_and_velocities(values, times, wanted)
    assert np.allclose(found[:3, 0], 1.0 + 2.0 * wanted[:3] - 3.0 * wanted[:3] ** 2)
    assert np.allclose(rate[[0, 2], 0], 2.0 - 6.0 * wanted[[0, 2]])
    assert np.isnan(found[3:]).all()


def test_coverage_says_where_to_wave_next() -> None:
    cameras = sensors(2)
    views = waved(cameras, Waving(seed=0, seconds=30.0))
    found = calibrate_by_wand(views, WandOptions(clocks=triggered(cameras.names))).coverage
    assert 0.5 < found.volume_m3 < 10.0
    corner = next(c for c in range(2) if cameras.names[c] in found.next_place())
    assert found.shares[corner] == found.shares.min()
    live = Coverage(cameras.names, cameras.image_size)
    for frame in range(len(views[0])):
        live.add(np.stack([view.px[[frame], 0] for view in views]))
    assert (live.pictures >= found.pictures).all() and live.shares.min() >= found.shares.min()
    full = replace(found)
    full.pictures = np.full_like(found.pictures, 9)
    assert full.next_place() == ""


def seen_nothing(view, share: float = 1.0):
    px = view.px.copy()
    px[: int(share * len(px))] = np.nan
    return replace(view, px=px)


def never_together(views):
    half = len(views[0]) // 2
    first, second = views[0].px.copy(), views[1].px.copy()
    first[half:], second[:half] = np.nan, np.nan
    return [replace(views[0], px=first), replace(views[1], px=second)]


BAD = {
    "no marker": (lambda v: [v[0], seen_nothing(v[1])], WandNotSeen, "sensor2"),
    "one sensor only": (lambda v: v[:1], WandNotSeen, "but two are needed"),
    "never together": (never_together, WandNotSeen, "Only 0 frames"),
    "a second wand": (lambda v: [v[0], replace(v[1], crowded=len(v[1]) - 3)], WandAmbiguous, "more than one wand"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_recordings_are_named(case: str) -> None:
    spoil, error, words = BAD[case]
    cameras = sensors(2)
    views = spoil(waved(cameras, Waving(seconds=6.0)))
    with pytest.raises(error, match=words):
        calibrate_by_wand(views, WandOptions(clocks=triggered(tuple(v.name for v in views))))


def test_two_groups_of_sensors_are_named() -> None:
    cameras = sensors(4)
    views = waved(cameras, Waving(seconds=12.0))
    half = len(views[0]) // 2
    for number, view in enumerate(views):
        view.px[half:] = np.nan if number < 2 else view.px[half:]
        view.px[:half] = np.nan if number >= 2 else view.px[:half]
    with pytest.raises(WandNotSeen, match="sensor2 never see the wand at the same time as sensor3"):
        calibrate_by_wand(views, WandOptions(clocks=triggered(cameras.names)))


def test_other_lengths_than_were_told_are_named() -> None:
    cameras = sensors(3)
    views = waved(cameras, Waving(seconds=8.0), WAND)
    with pytest.raises(WandInvalid, match="middle light divides the wand"):
        calibrate_by_wand(views, WandOptions(Wand(0.1, 0.3), triggered(cameras.names)))
    with pytest.raises(WandInvalid, match="too similar"):
        Wand(0.2, 0.21)
    with pytest.raises(WandInvalid, match="metres"):
        Wand(130.0, 260.0)


def test_two_wands_of_lights_are_named() -> None:
    cameras = sensors(2)
    views = waved(cameras, Waving(seconds=6.0), WAND)
    rng = np.random.default_rng(0)
    mixed = views[0].px.copy()
    mixed[:, 1] = rng.uniform(50, 500, mixed[:, 1].shape)
    with pytest.raises(WandAmbiguous, match="do not match a wand"):
        calibrate_by_wand([replace(views[0], px=mixed), views[1]], WandOptions(WAND))


def test_tables_round_trip_and_times_that_jump_are_left_out_or_named(tmp_path: Path) -> None:
    cameras = sensors(2)
    views = waved(cameras, Waving(seconds=4.0))
    lenses = {view.name: view.lens for view in views}
    for name, table in as_tables(views).items():
        (tmp_path / name).write_text(table)
    read = read_points_folder(tmp_path, lenses)
    assert [view.name for view in read] == list(cameras.names)
    assert np.allclose(read[1].px, views[1].px, atol=1e-3, equal_nan=True)
    assert np.allclose(read[1].depth_m, views[1].depth_m, atol=1e-6, equal_nan=True)
    rows = (tmp_path / "sensor1.csv").read_text().splitlines()
    (tmp_path / "sensor1.csv").write_text("\n".join([*rows, *rows[60:64]]))
    again = read_points_folder(tmp_path, lenses)[0]
    assert len(again) == len(views[0])
    assert [(item.code, item.values["lost"]) for item in again.findings] == [("wand_rows_ignored", 4)]
    (tmp_path / "sensor1.csv").write_text("\n".join([*rows, *rows[1:]]))
    with pytest.raises(TimesInvalid, match="sensor1"):
        read_points_folder(tmp_path, lenses)
    for text in ("", "a;b\n1;2", "t_ns;u;v;depth_mm\n1;2;3", "1;2;3;4;5;6;x"):
        (tmp_path / "sensor1.csv").write_text(text)
        with pytest.raises(FileDamaged):
            read_points_folder(tmp_path, lenses)
    (tmp_path / "sensor1.csv").write_text(rows[0] + "\n" + rows[1] + "\n" + rows[1])
    assert read_points_folder(tmp_path, lenses)[0].crowded == 1
    with pytest.raises(MocapError, match="lens of the sensor is unknown"):
        read_points_folder(tmp_path)


@pytest.mark.parametrize("number", [1e300, -1e300, np.inf])
def test_a_depth_or_pixel_that_no_sensor_reaches_is_not_seen(number: float) -> None:
    views = waved(sensors(2), Waving(seconds=1.0))
    assert views[0].depth_m is not None
    px, depth = views[0].px.copy(), views[0].depth_m.copy()
    px[3, 0, 0], depth[4] = number, number
    found = replace(views[0], px=px, depth_m=depth)
    assert found.depth_m is not None and np.isnan(found.depth_m[4]).all() and np.isnan(found.px[3, 0, 0])


@pytest.mark.parametrize("late_s", [1e9, 1e291])
def test_rows_that_span_more_than_a_day_are_named_before_memory_is_taken(late_s: float) -> None:
    views = waved(sensors(2), Waving(seconds=1.0))
    times = views[0].times_s.copy()
    times[-1] += late_s
    with pytest.raises(TimesInvalid, match="The rows span 1e"):
        with_growing_times(replace(views[0], times_s=times))
