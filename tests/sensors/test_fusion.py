"""Sightings of several sensors as one cloud: what belongs together, what goes on, and what is a ghost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from solver_backend.sensors.devices.device import RecordingInvalid
from solver_backend.sensors.fusion.moments import (
    FusedPoints,
    Gatherer,
    MarkerTracks,
    build_cloud,
    fuse,
    matched,
)
from tests.support.sensor_pictures import sensors_around, spread_points
from tests.support.sightings import sighted

CAMERAS = sensors_around()
POINTS = spread_points(30)


def off_mm(found: np.ndarray, points: np.ndarray) -> np.ndarray:
    return 1e3 * np.linalg.norm(found[:, None] - points, axis=-1).min(1)


@pytest.mark.parametrize("seed", range(5))
def test_pairs_are_of_least_cost_as_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = rng.uniform(0, 10, (12, 15))
    near = rng.random(table.shape) < (0.1, 0.2, 0.4, 0.8, 1.0)[seed]
    a, b = np.nonzero(near)
    i, j = matched(a, b, table[a, b])
    rows, columns = linear_sum_assignment(np.where(near, table, 1e6))
    theirs = near[rows, columns]
    assert len(i) == theirs.sum() and len(set(i.tolist())) == len(i) == len(set(j.tolist()))
    assert table[i, j].sum() == pytest.approx(table[rows, columns][theirs].sum())


def test_three_sensors_make_one_point_of_a_marker_and_are_surer_than_each() -> None:
    alone, together, squares = [], [], []
    for seed in range(8):
        seen = [sighted(CAMERAS, k, POINTS, seed=seed) for k in range(3)]
        found = fuse(seen)
        assert len(found.points) == 30 and (found.depths == 3).all()
        alone.append(off_mm(seen[0].points, POINTS))
        together.append(off_mm(found.points, POINTS))
        error = found.points - POINTS[np.linalg.norm(found.points[:, None] - POINTS, axis=-1).argmin(1)]
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error))
    assert np.mean(together) < 0.6 * np.mean(alone)
    assert np.mean(squares) == pytest.approx(3.0, rel=0.15), "the covariance is the error's"


def test_the_published_radius_averages_and_takes_apart_what_the_test_joins() -> None:
    moved = POINTS.copy()
    moved[0] += [0.0, 0.0, 0.011]
    seen = [sighted(CAMERAS, 0, POINTS), sighted(CAMERAS, 1, moved)]
    radius = fuse(seen, "radius")
    assert len(radius.points) in (30, 31) and np.median(off_mm(radius.points, POINTS)) < 2.0
    far = POINTS.copy()
    far[0] += [0.0, 0.0, 0.03]
    for kind in ("radius", "test"):
        apart = fuse([sighted(CAMERAS, 0, POINTS), sighted(CAMERAS, 1, far)], kind)
        assert len(apart.points) == 31, "three centimetres are two markers"


def test_two_close_markers_of_one_sensor_are_not_joined_by_the_test() -> None:
    pair = np.array([[0.0, 0.0, 1.0], [0.0, 0.032, 1.0]])
    found = fuse([sighted(CAMERAS, k, pair) for k in range(3)])
    assert len(found.points) == 2 and off_mm(found.points, pair).max() < 3.0


def test_rays_sharpen_points_and_meet_where_there_is_no_depth() -> None:
    seen = [sighted(CAMERAS, 0, POINTS[:10], rays=(0, 1)), sighted(CAMERAS, 1, POINTS[:10], rays=(0, 2))]
    found = fuse(seen)
    assert len(found.points) == 10 and off_mm(found.points, POINTS[:10]).max() < 8.0
    assert sorted(zip(found.depths.tolist(), found.rays.tolist(), strict=True))[:3] == [(0, 2), (1, 1), (1, 1)]
    met = found.points[found.depths == 0]
    assert off_mm(met, POINTS[:1]).max() < 4.0


def test_rays_that_may_meet_twice_give_no_ghosts() -> None:
    # In one plane with both sensors every ray of one meets every ray of the other.
    a, b = CAMERAS.centres[:2]
    middle = np.array([0.0, 0.0, 1.1])
    plane = np.array([middle + 0.1 * k * (a + b - 2 * middle) for k in (-1, 0, 1)])
    plane[:, 2] = 1.1
    found = fuse([sighted(CAMERAS, k, plane, rays=(0, 1, 2)) for k in (0, 1)])
    assert len(found.points) == 0 or off_mm(found.points, plane).max() < 10.0


def test_nobody_sees_anything() -> None:
    assert len(fuse([]).points) == 0
    assert len(fuse([sighted(CAMERAS, 0, np.zeros((0, 3)))]).points) == 0
    assert len(MarkerTracks().update(fuse([])).points) == 0


def moment(time: float, points: np.ndarray, depths: int = 2) -> FusedPoints:
    count = len(points)
    return FusedPoints(
        time, points, np.tile(1e-6 * np.eye(3), (count, 1, 1)), np.full(count, depths), np.zeros(count, int)
    )


def test_tracks_follow_swinging_markers_past_one_another() -> None:
    tracks, rng = MarkerTracks(), np.random.default_rng(0)
    names = []
    for frame in range(120):
        t = frame / 60
        points = np.array([[0.3 * np.sin(6 * t), 0.0, 1.0], [-0.3 * np.sin(6 * t), 0.03, 1.0], [0.0, 0.5, 1.5]])
        told = tracks.update(moment(t, points + rng.normal(0, 1e-3, (3, 3))))
        names.append(told.track)
    assert (np.array(names) == names[0]).all(), "they pass at 3 cm and 3.6 m/s"
    assert (told.score > 0).all()


def test_a_marker_that_was_hidden_shortly_goes_on_and_later_is_another() -> None:
    tracks, still = MarkerTracks(), np.array([[0.0, 0.0, 1.0]])
    first = tracks.update(moment(0.0, still)).track[0]
    nothing = np.zeros((0, 3))
    for frame in range(1, 5):
        tracks.update(moment(frame / 60, nothing))
    assert tracks.update(moment(5 / 60, still)).track[0] == first
    for frame in range(6, 20):
        tracks.update(moment(frame / 60, nothing))
    assert tracks.update(moment(20 / 60, still)).track[0] != first


def test_ghosts_are_those_that_nobody_confirms() -> None:
    tracks, tracked, rng = MarkerTracks(), [], np.random.default_rng(1)
    for frame in range(100):
        ghosts = rng.uniform(-1, 1, (1, 3)) if frame % 5 == 0 else np.zeros((0, 3))
        points = np.vstack([POINTS, ghosts])
        found = moment(frame / 60, points)
        found.depths[len(POINTS) :] = 1
        tracked.append(tracks.update(found))
    cloud = build_cloud(tracked, 60.0)
    assert cloud.positions.shape == (100, 30, 3)
    assert cloud.covariance is not None and cloud.covariance.shape == (100, 30, 3, 3)
    assert cloud.residual is not None and cloud.residual == pytest.approx(1e-3)


def test_time_that_stands_still_begins_anew() -> None:
    tracks = MarkerTracks()
    first = tracks.update(moment(1.0, POINTS)).track
    assert not set(tracks.update(moment(1.0, POINTS)).track) & set(first)
    assert np.isfinite(tracks.update(moment(0.2, POINTS)).points).all()


def gathered(times: list[list[float]], hosts: list[list[float]] | None = None) -> tuple[list[list[int]], list[str]]:
    """Return which sensors each moment holds, and kinds of findings, of frames by sensor."""
    gatherer = Gatherer(CAMERAS.names, 1 / 60, wait_s=0.05)
    order = sorted(
        (host, k, t)
        for k, sensor in enumerate(times)
        for t, host in zip(sensor, (hosts or times)[k], strict=True)
    )  # fmt: skip
    found = []
    for host, sensor, t in order:
        gatherer.push(sighted(CAMERAS, sensor, POINTS[:1], time=t, host_s=host))
        found += gatherer.moments(host)
    for sensor in range(3):
        gatherer.ended(sensor)
    found += gatherer.moments()
    return [sorted(s.sensor for s in m) for m in found], [f.kind for f in gatherer.findings]


STEADY = [k / 60 for k in range(12)]


def test_interleaved_sensors_are_of_one_moment() -> None:
    moments, findings = gathered([STEADY, [t + 160e-6 for t in STEADY], [t + 320e-6 for t in STEADY]])
    assert moments == [[0, 1, 2]] * 12 and not findings


def test_a_frame_that_is_lost_leaves_the_others_together() -> None:
    moments, _ = gathered([STEADY, STEADY[:5] + STEADY[6:], STEADY])
    assert moments.count([0, 1, 2]) == 11 and moments.count([0, 2]) == 1


def test_a_sensor_that_is_away_for_a_while_is_told() -> None:
    long = [k / 60 for k in range(90)]
    moments, findings = gathered([long, long[:10] + long[60:], long])
    assert findings == ["sensor_silent", "sensor_back"]
    assert moments.count([0, 1, 2]) == 40 and moments.count([0, 2]) == 50


@pytest.mark.parametrize("jump", [-1000.0, -0.2, 0.9, 1e6, 1e9])
def test_a_clock_that_jumps_is_put_right_by_the_hosts(jump: float) -> None:
    jumped = STEADY[:6] + [t + jump for t in STEADY[6:]]
    moments, findings = gathered([jumped, STEADY, STEADY], [STEADY] * 3)
    assert findings == ["time_jumped"]
    assert moments == [[0, 1, 2]] * 12


def test_late_sensors_are_not_waited_for() -> None:
    gatherer = Gatherer(CAMERAS.names, 1 / 60, wait_s=0.01)
    for sensor in (0, 1):
        gatherer.push(sighted(CAMERAS, sensor, POINTS[:1], time=5.0, host_s=100.0))
    assert not gatherer.moments(100.005)
    assert len(gatherer.moments(100.011)) == 1
    gatherer.push(sighted(CAMERAS, 2, POINTS[:1], time=5.0, host_s=100.02))
    assert not gatherer.moments(200.0), "what comes after its moment is dropped"


@pytest.mark.parametrize("host", [-9e18, 9e18, 1e300, np.nan, np.inf])
def test_times_of_the_end_of_the_world_end_nothing(host: float) -> None:
    """Half a period more than such a time is that time: every moment holds its first frame all the same."""
    gatherer = Gatherer(("a", "b"), 1 / 60.0)
    for number in range(20):
        for sensor in (0, 1):
            seen = sighted(CAMERAS, sensor, POINTS, time=number / 60.0)
            gatherer.push(replace(seen, host_s=host if (number, sensor) == (7, 1) else number / 60.0))
            for moment in gatherer.moments():
                assert moment
    for sensor in (0, 1):
        gatherer.ended(sensor)
    assert all(gatherer.moments())


def test_moments_that_are_hours_apart_are_named_before_memory_is_taken() -> None:
    """An index in milliseconds spread three moments over six million frames."""
    tracks, tracked = MarkerTracks(), []
    for time in (100.0, 100.02, 100_000.0):
        tracked.append(tracks.update(moment(time, POINTS)))
    with pytest.raises(RecordingInvalid, match=r"3 frames with markers span 99900 s, which is impossible at 60"):
        build_cloud(tracked, 60.0)
