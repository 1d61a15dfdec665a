"""Clocks by hand claps: somebody stands still and claps, a detector errs, cameras were started by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from research.simulation.filming import FilmSettings, around, film
from solver_backend.exchange.diagnostics import sentence
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.faults import MEASURED_DETECTOR
from solver_backend.synthesis.simulation.cast import Take, cast_person
from solver_backend.types import JointSet
from solver_backend.videos.sync.clap import RATE_HZ, claps, clocks_by_claps
from solver_backend.videos.sync.clocks import Signal, SyncUnknown
from solver_backend.videos.sync.synchronise import synchronise
from solver_backend.videos.video_detections import VideoDetections
from tests.support.clapping import clapping

FPS, FRAMES, MARGIN = 60.0, 480, 100
JOINT_SET = JointSet.BODY_25
CLAPS_S = (3.4, 3.9, 4.7)
NAMES = ("a", "b", "c", "d")


def standing() -> Take:
    """Return somebody who stands with arms hanging and sways a little, Y up."""
    rotations = np.tile(np.eye(3), (FRAMES, 22, 1, 1))
    sway = 0.02 * np.sin(np.arange(FRAMES) / 40.0)[:, None] * np.array([0.0, 0.0, 1.0])
    rotations[:, 0] = exp_so3(sway)
    for joint, sign in ((16, -1.0), (17, 1.0)):
        rotations[:, joint] = exp_so3(np.array([0.0, 0.0, sign * 1.2]))
    return Take("standing", rotations, np.tile([0.0, 0.95, 0.0], (FRAMES, 1)), FPS)


def filmed(take: Take, seed: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Return four views' tracks and their clocks' offsets in seconds; the detector guesses hands that are hidden."""
    rng = np.random.default_rng(seed)
    person = cast_person(take, rng)
    cameras = around(person.landmarks(JOINT_SET).skeleton.joints[:, 0], 4)
    late_s = np.r_[0.0, rng.uniform(-1.5, 1.5, 3)]
    cut = np.floor(late_s * FPS).astype(int)
    delays = np.tile((cut - late_s * FPS)[:, None], (1, FRAMES))
    model = replace(MEASURED_DETECTOR, occluded_missing=0.0)
    found = film(person, cameras, FilmSettings(JOINT_SET, FPS, model, None, delays), rng)
    return [found.xy[c, MARGIN + cut[c] : FRAMES - MARGIN + cut[c]] for c in range(4)], -late_s


def detections(tracks: list[np.ndarray], joint_set: JointSet = JOINT_SET) -> list[VideoDetections]:
    return [
        VideoDetections(
            Path(f"{name}.mp4"), "h", "d", joint_set, (1920, 1080), np.arange(len(track)) / FPS, track[:, None],
            np.isfinite(track[..., 0])[:, None].astype(float), np.zeros((len(track), 1), int),
        )
        for name, track in zip(NAMES, tracks, strict=False)
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_uneven_claps_of_somebody_who_stands_tell_the_clocks_to_a_frame(seed: int) -> None:
    tracks, offset_s = filmed(clapping(standing(), CLAPS_S), seed)
    told = synchronise(detections(tracks), None, "clap")
    assert np.abs(told.offset_s - offset_s).max() * FPS < 1.0
    assert told.method == "claps"


def test_an_exchange_of_left_and_right_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    track = rng.normal(500.0, 100.0, (120, 25, 2))
    mirrored = track[:, list(JOINT_SET.mirrored())]
    times = np.arange(120) / FPS
    np.testing.assert_allclose(claps(track, times, JOINT_SET).values, claps(mirrored, times, JOINT_SET).values)


def peaks(at_s: tuple[float, ...], seconds: float = 6.0) -> Signal:
    times = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    values = sum((np.exp(-0.5 * ((times - t) / 0.03) ** 2) for t in at_s), np.zeros(len(times)))
    return Signal((values / max(float(np.sqrt((values**2).sum())), 1e-9))[:, None], RATE_HZ)


def test_the_views_decide_together_and_what_fits_twice_is_named() -> None:
    one, late = peaks((1.0, 1.5, 2.6)), peaks((2.0, 2.5, 3.6))
    told = clocks_by_claps(NAMES[:3], [one, late, peaks((0.4, 0.9, 2.0))], 4.0)
    np.testing.assert_allclose(told.offset_s, [0.0, 1.0, -0.6], atol=1e-3)
    assert told.findings == () and (told.covariance[1:, 0, 0] > 0).all()
    told = clocks_by_claps(NAMES[:3], [one, late, peaks((3.0,))], 4.0)
    np.testing.assert_allclose(told.offset_s[1], 1.0, atol=1e-3)
    assert told.findings[-1].code == "claps_ambiguous" and told.findings[-1].where.cameras == ("c",)
    assert "unequal intervals" in sentence(told.findings[-1])


def test_where_nobody_claps_or_no_hands_are_seen_is_named() -> None:
    still = np.broadcast_to(np.linspace(100.0, 800.0, 50).reshape(1, 25, 2), (120, 25, 2))
    with pytest.raises(SyncUnknown, match="cannot be synchronised"):
        synchronise(detections([still, still]), None, "clap")
    with pytest.raises(SyncUnknown, match="single picture"):
        synchronise(detections([still, still[:1]]), None, "clap")

    with pytest.raises(SyncUnknown):
        clocks_by_claps(NAMES[:2], [peaks((1.0,)), peaks(())], 4.0)
