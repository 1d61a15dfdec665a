from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from research.simulation.filming import around
from solver_backend.agreement.lags import RATE_SIGMA, Signal, signal_lags
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.types import JointSet
from solver_backend.videos.files.video import Sound, VideoWithoutSound
from solver_backend.videos.sync.clocks import (
    Clocks,
    SyncUnknown,
    at_times,
    clocks_of_signals,
    common_times,
    read_clocks,
)
from solver_backend.videos.sync.synchronise import (
    FLOOR_S,
    FilmedTracks,
    by_sound,
    clocks_by_geometry,
    clocks_by_speeds,
    in_step,
    onsets,
    synchronise,
)
from solver_backend.videos.video_detections import VideoDetections
from tests.support.videos import write_timed_video

FPS = 60.0
NAMES = ("a", "b", "c", "d")


def moving_person(times_s: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return (N, 17, 3) metres: keypoints of a person's size that wander smoothly, each in its own way."""
    rng = np.random.default_rng(seed)
    rest = np.stack([rng.uniform(-0.3, 0.3, 17), rng.uniform(-0.3, 0.3, 17), np.linspace(1.7, 0.1, 17)], axis=-1)
    hz, phase = rng.uniform(0.15, 1.4, (6, 17, 3)), rng.uniform(0, 2 * np.pi, (6, 17, 3))
    return rest + 0.09 * np.sin(2 * np.pi * hz * times_s[:, None, None, None] + phase).sum(axis=1)


def filmed(
    offset_s: list[float], rate: list[float], seconds: float = 20.0, noise_px: float = 1.0
) -> tuple[FilmedTracks, Clocks]:
    """Return what four cameras film whose videos begin at other times, and their true clocks."""
    rng = np.random.default_rng(1)
    cameras = around(np.zeros((2, 3)) + [[0.0, 0.0, 1.0]], 4)
    cameras = replace(cameras, names=NAMES)
    middle = 0.5 * seconds
    true = replace(Clocks.alike(NAMES), offset_s=np.array(offset_s), rate=np.array(rate), middle_s=middle)
    tracks, times = [], []
    for c in range(4):
        on_video = np.arange(int(seconds * FPS)) / FPS
        points = moving_person(true.from_video(c, on_video))
        one = cameras.subset([c])
        px = project(one, points)[0]
        px = px + noise_px * rng.normal(size=px.shape)
        px[rng.random(px.shape[:-1]) < 0.03] = np.nan
        tracks.append(px)
        times.append(on_video)
    return FilmedTracks(cameras, tracks, times, JointSet.COCO_17, FPS), true


def errors_frames(told: Clocks, true: Clocks, seconds: float) -> np.ndarray:
    times = np.linspace(0.0, seconds, 9)
    return FPS * np.stack([told.in_video(c, times) - true.in_video(c, times) for c in range(len(told.names))])


@pytest.mark.slow
def test_calibrated_cameras_tell_offset_and_drift_below_a_tenth_of_a_frame() -> None:
    take, true = filmed([0.0, 1.234, -2.9, 0.507], [0.0, 50e-6, -50e-6, 20e-6], seconds=12.0)
    told = clocks_by_geometry(take, 4.5)
    assert np.abs(errors_frames(told, true, 12.0)).max() < 0.05
    assert (np.sqrt(told.covariance[1:, 0, 0]) < 0.05 / FPS).all() and (told.covariance[0] == 0).all()


def test_a_take_may_be_shorter_than_the_largest_offset() -> None:
    take, true = filmed([0.0, 0.0, 0.1, 0.0], [0.0] * 4, seconds=3.0)
    assert np.abs(errors_frames(clocks_by_geometry(take, 6.5), true, 3.0)).max() < 0.5


def test_a_short_take_leaves_the_rates_of_two_clocks_as_uncertain_as_quartz() -> None:
    told = clocks_by_geometry(filmed([0.0] * 4, [0.0] * 4, seconds=4.0)[0], 0.5)
    np.testing.assert_allclose(np.sqrt(told.covariance[1:, 1, 1]), np.sqrt(2.0) * RATE_SIGMA, rtol=0.2)


def test_speeds_tell_the_clocks_without_calibration() -> None:
    take, true = filmed([0.0, 1.234, -2.9, 0.507], [0.0, 50e-6, -50e-6, 20e-6])
    told = clocks_by_speeds(NAMES, take.tracks, take.times_s, take.joint_set, 6.5)
    assert np.abs(errors_frames(told, true, 20.0)).max() < 0.5


@pytest.mark.slow
def test_cameras_in_step_stay_in_step() -> None:
    take, _ = filmed([0.0] * 4, [0.0] * 4, seconds=5.0)
    told = in_step(clocks_by_geometry(take, 2.0), FPS)
    assert (told.offset_s == 0).all() and (told.rate == 0).all() and "in sync" in told.method


def test_nobody_moves() -> None:
    take, _ = filmed([0.0] * 4, [0.0] * 4, seconds=4.0)
    still = [np.broadcast_to(track[:1], track.shape) for track in take.tracks]
    with pytest.raises(SyncUnknown, match="moves too little"):
        clocks_by_geometry(replace(take, tracks=still), 3.0)
    with pytest.raises(SyncUnknown, match="cannot be synchronised"):
        clocks_by_speeds(NAMES, still, take.times_s, take.joint_set, 3.0)


def music(times_s: np.ndarray) -> np.ndarray:
    """Return sound with onsets at uneven times, of other pitches."""
    rng = np.random.default_rng(5)
    out = np.zeros(len(times_s))
    for start, hz in zip(np.cumsum(rng.uniform(0.15, 0.6, 120)), rng.uniform(150, 3000, 120), strict=True):
        since = times_s - start
        out += np.where(since > 0, np.exp(-np.clip(since, 0, 5) / 0.08) * np.sin(2 * np.pi * hz * since), 0.0)
    return out


@pytest.mark.slow
def test_sound_tells_offset_and_drift_through_other_microphones() -> None:
    rng = np.random.default_rng(2)
    at = np.arange(30 * 16_000) / 16_000
    offset, rate = 1.7312, 40e-6
    first = music(at) + 0.02 * rng.normal(size=len(at))
    second = 0.1 * music(at * (1 - rate) - offset) + 0.004 * rng.normal(size=len(at))
    signals = [onsets(Sound(s.astype(np.float32), 0.0)) for s in (first, second)]
    found = signal_lags(signals, reach_s=6.5, floor_s=FLOOR_S)
    expected, sigma = offset + rate * (found.middle_s + offset), np.sqrt(found.covariance[1, (0, 1), (0, 1)])
    assert found.lag_s[1] == pytest.approx(expected, abs=5e-4)
    assert found.rate[1] == pytest.approx(rate, abs=3.5 * sigma[1]) and sigma[0] >= FLOOR_S


def test_other_sounds_do_not_agree() -> None:
    rng = np.random.default_rng(3)
    signals = [Signal(rng.normal(size=(4000, 3)), 200.0) for _ in range(2)]
    assert signal_lags(signals, reach_s=6.5, floor_s=0.001).unknown == (1,)


def seen(path: Path, times_s: np.ndarray) -> VideoDetections:
    shape = (len(times_s), 1, 17)
    return VideoDetections(
        path, "h", "d", JointSet.COCO_17, (64, 48), times_s, np.zeros((*shape, 2)), np.ones(shape), np.zeros(shape[:2])
    )


def test_videos_are_synchronised_by_their_sound(tmp_path: Path) -> None:
    pytest.importorskip("av")
    found = []
    for name, late_s in (("a", 0.0), ("b", 0.85)):
        times = np.arange(12 * 10) / 10.0
        heard = 0.3 * music(np.arange(12 * 16_000) / 16_000 + late_s)
        grey = [np.full((48, 64, 3), 90, np.uint8)] * len(times)
        path = write_timed_video(tmp_path / f"{name}.mp4", grey, times, heard.astype(np.float32))
        found.append(seen(path, times))
    told = by_sound(found)
    assert told.offset_s[1] == pytest.approx(-0.85, abs=2e-3)
    mute = write_timed_video(tmp_path / "c.mp4", [np.zeros((48, 64, 3), np.uint8)] * 9, np.arange(9) / 10.0)
    with pytest.raises(VideoWithoutSound):
        by_sound([found[0], seen(mute, np.arange(9) / 10.0)])


def noises(lags: dict[int, list[tuple[int, float]]], seed: int = 4) -> list[Signal]:
    """Return signals that hear sources, by number, so many samples late and so loud."""
    sources = np.random.default_rng(seed).normal(size=(len(lags), 3000, 2))
    made = [sum(gain * np.roll(sources[n], lag, axis=0) for n, (lag, gain) in enumerate(one)) for one in lags.values()]
    return [Signal(values[300:-300], 100.0) for values in made]


def test_a_pair_that_contradicts_the_others_has_no_effect() -> None:
    """Cameras b and d hear a second source, from which they seem 2 s apart."""
    heard = {0: [(0, 1.0)], 1: [(10, 1.0), (0, 1.5)], 2: [(20, 1.0)], 3: [(30, 1.0), (200, 1.5)]}
    signals = noises({c: [*one, (0, 0.0)][:2] for c, one in heard.items()})
    told = clocks_of_signals(NAMES, signals, "test", reach_s=4.0, floor_s=1e-3)
    np.testing.assert_allclose(told.offset_s, [0.0, 0.1, 0.2, 0.3], atol=2e-3)


@pytest.mark.parametrize(
    ("alone", "message"),
    [((3,), "^d cannot be synchronised with a"), ((0,), "^a cannot be synchronised with b"),
     ((1, 2, 3), "^b, c, d cannot be synchronised with a")],
)  # fmt: skip
def test_a_signal_without_agreement_is_named(alone: tuple[int, ...], message: str) -> None:
    signals = noises({c: [(10 * c, 1.0)] for c in range(4)})
    for c in alone:
        signals[c] = replace(signals[c], values=np.random.default_rng(c).normal(size=signals[c].values.shape))
    with pytest.raises(SyncUnknown, match=message):
        clocks_of_signals(NAMES, signals, "test", reach_s=4.0, floor_s=1e-3)


def test_clocks_turn_back_and_go_through_a_file(tmp_path: Path) -> None:
    clocks = replace(
        Clocks.alike(NAMES),
        offset_s=np.array([0, 1.5, -2, 0.1]),
        rate=np.array([0, 5e-5, -5e-5, 0]),
        middle_s=4.0,
        findings=(diagnostic("clocks_assumed", reason="nobody moves"),),
    )
    times = np.linspace(-3, 90, 11)
    for c in range(4):
        np.testing.assert_allclose(clocks.from_video(c, clocks.in_video(c, times)), times, atol=1e-9)
    (tmp_path / "sync.json").write_text(json.dumps(clocks.as_dict()))
    again = read_clocks(tmp_path / "sync.json")
    np.testing.assert_array_equal(again.offset_s, clocks.offset_s)
    assert again.names == NAMES and again.middle_s == 4.0 and again.findings == clocks.findings


def test_moments_lie_in_all_videos_and_between_pictures_is_linear() -> None:
    clocks = replace(Clocks.alike(("a", "b")), offset_s=np.array([0.0, -0.25]))
    times = common_times([(0.0, 1.0), (0.0, 1.0)], clocks, 10.0)
    assert times[0] == pytest.approx(0.25) and times[-1] <= 1.0 + 1e-9
    at, values = np.array([0.0, 0.1, 0.2, 0.5, 0.6]), np.array([[0.0], [1.0], [np.nan], [5.0], [6.0]])
    wanted = np.array([-0.01, 0.0, 0.025, 0.1, 0.15, 0.4, 0.55, 0.6])
    np.testing.assert_allclose(
        at_times(values, at, wanted)[:, 0], [np.nan, 0.0, 0.25, 1.0, np.nan, np.nan, 5.5, 6.0], atol=1e-9
    )


def test_an_unknown_way_has_a_name() -> None:
    with pytest.raises(CommandLineInvalid, match="not a synchronisation method"):
        synchronise([], None, "smell")


def test_without_anything_to_tell_by_the_clocks_are_taken_to_agree(tmp_path: Path) -> None:
    pytest.importorskip("av")
    found = []
    for name in ("a", "b"):
        times = np.arange(40) / 20.0
        path = write_timed_video(tmp_path / f"{name}.mp4", [np.zeros((48, 64, 3), np.uint8)] * 40, times)
        found.append(seen(path, times))
    told = synchronise(found, None, "auto")
    assert (told.offset_s == 0).all() and [item.code for item in told.findings] == ["clocks_assumed"]


def test_a_camera_that_loses_a_second_leaves_the_others_certain() -> None:
    rng = np.random.default_rng(4)
    sound = np.repeat(rng.normal(size=(3100, 2)), 2, axis=0)
    values = [sound[:6000] + 0.1 * rng.normal(size=(6000, 2)) for _ in range(4)]
    values[3] = np.concatenate([values[3][:2400], sound[2500:6100] + 0.1 * rng.normal(size=(3600, 2))])
    found = signal_lags([Signal(one, 100.0) for one in values], reach_s=2.0, floor_s=0.001)
    assert not found.unknown
    np.testing.assert_allclose(found.lag_s[:3], 0.0, atol=0.002)
    assert (np.sqrt(found.covariance[1:3, 0, 0]) < 0.005).all()
