"""The live loop rides out what comes, and says what it does."""

from __future__ import annotations

import io
import json
import time
from typing import Any

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.fitters.model.subject import frame_equations
from solver_backend.fitters.recipes.live import LiveFit
from solver_backend.geometry.rotations import exp_so3
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.point_network import CloudReading
from solver_backend.live.frames import PointFrame, from_lines, replayed
from solver_backend.live.session import KEPT, LiveSession, LiveStatistics, PointTracks, unit_of
from solver_backend.types import MarkerCloud

FRAMES, FPS = 60, 120.0


@pytest.fixture(scope="module")
def walk() -> np.ndarray:
    """(F, 53, 3) markers of a body that swings an arm and a leg and walks ahead."""
    body = load_body()
    t = np.arange(FRAMES) / FPS
    local = np.zeros((FRAMES, 21, 3))
    local[:, 16, 1], local[:, 0, 0], local[:, 4, 0] = 0.8 * np.sin(4 * t), -0.6 * np.sin(4 * t), 0.5
    root = np.broadcast_to(exp_so3(np.array([np.pi / 2, 0, 0])), (FRAMES, 3, 3))
    ahead = np.stack([0 * t, -1.2 * t, 0.9 + 0 * t], axis=1)
    return pose_landmarks(body, marker_landmarks(body, MARKERS), np.zeros(10), root, exp_so3(local), ahead).points


class TellsTheTruth:
    """A network that knows the markers, by the nearest one of the frame that it is told of."""

    def __init__(self, walk: np.ndarray) -> None:
        self.markers = walk[0]

    def __call__(self, points: np.ndarray, seen: np.ndarray | None = None) -> CloudReading:
        apart = np.linalg.norm(points[0][:, None] - self.markers, axis=-1)
        scores = np.full((1, len(points[0]), GHOST + 1), -8.0)
        near = apart.min(1) < 0.02
        scores[0, np.arange(len(near)), np.where(near, apart.argmin(1), GHOST)] = 4.0
        positions = np.concatenate([self.markers, np.zeros((24, 3))])[None]
        return CloudReading(scores, np.zeros(GHOST), positions, np.full((1, 77, 6), 1.0))


@pytest.fixture
def session(walk) -> LiveSession:
    network = TellsTheTruth(walk)
    found = LiveSession(network, LiveFit(load_body()), unit="m", up_axis="z")  # type: ignore[arg-type]
    found.truth = network  # type: ignore[attr-defined]
    return found


def frames(points: np.ndarray, session: LiveSession, walk: np.ndarray, start: float = 0.0):
    for number, frame in enumerate(points):
        session.network.markers = walk[min(number, len(walk) - 1)]  # type: ignore[attr-defined]
        yield PointFrame(start + number / FPS, frame, time.perf_counter())


def test_poses_follow_the_markers(session, walk):
    lines = list(session.run(frames(walk, session, walk)))
    poses = [line for line in lines if "pose" in line]
    assert len(poses) == FRAMES and all(line["state"] == "tracking" for line in poses)
    assert np.median([line["off_mm"] for line in poses]) < 3.0
    assert abs(poses[-1]["trans"][1] - poses[0]["trans"][1] + 1.2 * (FRAMES - 1) / FPS) < 0.02
    assert all(line["latency_ms"] >= 0 for line in poses)


def test_an_empty_second_and_single_points_are_waited_out(session, walk):
    nobody = [np.zeros((0, 3))] * 40 + [np.zeros((1, 3))] * 5
    lines = list(session.run(frames(np.array(walk[:20]), session, walk)))
    lines += list(session.run(frames(nobody, session, walk, start=20 / FPS)))
    lines += list(session.run(frames(walk[20:40], session, walk[20:], start=65 / FPS)))
    states = [line.get("state") for line in lines]
    assert states.count("waiting") == 45 and states[-1] == "tracking"


def test_time_that_runs_backwards_starts_anew(session, walk):
    lines = list(session.run(frames(walk[:20], session, walk, start=5.0)))
    lines += list(session.run(frames(walk[:20], session, walk, start=1.0)))
    assert [line["event"] for line in lines if "event" in line].count("time_ran_back") == 1
    assert lines[-1]["state"] == "tracking"


def test_a_frozen_stream_is_named(session, walk):
    still = np.repeat(walk[:1], 100, axis=0)
    lines = list(session.run(frames(still, session, walk[:1])))
    assert lines[10]["state"] == "tracking" and lines[-1]["state"] == "frozen"


def test_markers_on_a_chair_are_no_person(session, walk):
    chair = np.random.default_rng(0).uniform(0, 1, (12, 3)) + (5.0, 5.0, 0.0)
    lines = list(session.run(frames(np.repeat(chair[None], 5, axis=0), session, walk)))[1:]
    assert {line["state"] for line in lines} == {"no_person"}
    assert "look like a person" in lines[0]["why"]


def beside(count: int) -> np.ndarray:
    """Return points of a prop beside a person."""
    return np.random.default_rng(0).uniform(-0.2, 0.2, (count, 3)) + (0.9, 0.0, 1.0)


@pytest.mark.parametrize(("count", "state"), [(9, "tracking"), (10, "unsure")])
def test_ten_points_that_nothing_explains_make_a_pose_unsure_and_are_counted(session, walk, count, state):
    extra = np.tile(beside(count), (len(walk), 1, 1))
    last = list(session.run(frames(np.concatenate([walk, extra], axis=1), session, walk)))[-1]
    assert last["state"] == state and last["off_mm"] < 10
    assert last.get("why", "") == ("10 points do not match the body" if count == 10 else "")


def test_a_leg_that_is_off_makes_a_pose_unsure_and_is_named_with_its_distance(session, walk):
    leg = [i for i, name in enumerate(MARKERS) if name in ("LSHN", "LANK", "LANM", "LHEE", "LMT1", "LMT5", "LTOE")]
    torn = walk.copy()
    torn[:, leg] += (0.0, 0.0, -0.5)
    last = list(session.run(frames(torn, session, torn)))[-1]
    assert last["state"] == "unsure" and last["off_mm"] < 80
    off = float(last["why"].removeprefix("the left leg is ").removesuffix(" mm off"))
    assert 80 < off < 600


def test_many_points_and_two_people_do_not_end_it(session, walk):
    rng = np.random.default_rng(0)
    crowd = [np.concatenate([walk[i], rng.uniform(-4, 4, (347, 3))]) for i in range(15)]
    two = [np.concatenate([walk[i], walk[i] + (2.0, 0, 0)]) for i in range(15, 30)]
    lines = list(session.run(frames(crowd + two, session, walk)))
    assert lines[0]["event"] == "world" and len(lines) == 31
    assert all("state" in line for line in lines[1:])


def test_nonsense_of_the_network_does_not_end_it(session, walk):
    class Breaks:
        def __call__(self, points: np.ndarray) -> CloudReading:
            raise np.linalg.LinAlgError("singular")

    session.network = Breaks()  # type: ignore[assignment]
    lines = list(session.run(iter([PointFrame(i / FPS, walk[i], time.perf_counter()) for i in range(3)])))
    assert [line["event"] for line in lines] == ["world", "restarted", "restarted", "restarted"]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("hello", "could not convert|not in our format"),
        ("1.0 2.0 3.0", "not a time and points"),
        ('{"points": [[1, 2]]}', "not in our format"),
        ('{"t": "soon", "points": []}', "not in our format"),
        ("[" * 100000, "not in our format"),
        ('{"points": 5}', "not in our format"),
        ("nan 1 2 3", "time is not a number"),
        (json.dumps({"points": [[0, 0, 0]] * 500}), "the limit is"),
    ],
)
def test_lines_that_are_no_points_are_named(session, walk, line, said):
    import re

    found = next(iter(from_lines(io.BytesIO((line + "\n").encode()))))
    assert re.search(said, found.fault)
    lines = list(session.run([found]))
    assert lines[0]["event"] == "line_ignored" and lines[0]["t"] is None
    json.dumps(lines)


def test_lines_of_both_kinds_are_read():
    text = '{"t": 0.5, "points": [[1, 2, 3], [4, 5, 6]]}\n\n0.6 1 2 3 4 5 6\n0.7;1;2;3;nan;nan;nan\n'
    read = list(from_lines(io.BytesIO(text.encode())))
    assert [f.time for f in read] == [0.5, 0.6, 0.7] and [len(f.points) for f in read] == [2, 2, 1]


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "m"), (1000.0, "mm"), (100.0, "cm"), (1e-6, None)])
def test_the_unit_is_told_by_a_persons_size(walk, factor, unit):
    assert unit_of(factor * walk[0]) == unit


def test_points_keep_what_was_said_of_them(walk):
    tracks, rng = PointTracks(), np.random.default_rng(0)
    for number in range(10):
        order = rng.permutation(53)
        log = np.full((53, GHOST + 1), -3.0)
        log[np.arange(53), order] = -0.5
        evidence = tracks.update(walk[number, order], log, 1 / FPS)
        assert np.array_equal(evidence.argmax(1), order)
    assert evidence.max() - np.median(evidence) > 15.0  # ten frames say more than one


def test_a_replay_keeps_its_rate_and_its_end():
    cloud = MarkerCloud(np.zeros((12, 3, 3)), 120.0)
    start = time.perf_counter()
    assert len(list(replayed(cloud))) == 12
    assert time.perf_counter() - start >= 11 / 120 - 1e-3


def test_statistics_count_states_and_latency():
    statistics = LiveStatistics()
    for number in range(100):
        statistics.add({"state": "tracking", "pose": [], "latency_ms": float(number)})
    statistics.add({"event": "restarted"})
    found: dict[str, Any] = statistics.summary()
    assert found["frames"] == 100 and found["events"] == {"restarted": 1}
    assert found["latency_ms"] == 49.5 and 98 <= found["latency_p99_ms"] <= 99


def test_warming_up_leaves_nothing_behind(session, walk):
    other = LiveSession(session.network, LiveFit(load_body()), unit="m", up_axis="z")
    session.network.markers = walk[0]
    session.warm_up()
    assert session.fit.pose is None and session.to_metres is None and not len(session.tracks.position)
    said = [
        [
            {k: v for k, v in line.items() if k not in ("latency_ms", "lag_ms")}
            for line in one.run(frames(walk, one, walk))
        ]
        for one in (session, other)
    ]
    assert said[0] == said[1] and len(said[0]) > FRAMES


def test_statistics_of_a_run_of_hours_do_not_grow():
    statistics = LiveStatistics()
    for number in range(3 * KEPT):
        statistics.add({"state": "tracking", "pose": [], "latency_ms": float(number >= 2 * KEPT)})
    assert len(statistics.latency_ms) == KEPT
    assert statistics.summary()["frames"] == 3 * KEPT and statistics.summary()["latency_ms"] == 1.0


def test_no_frame_of_a_start_takes_many_steps_and_a_bad_one_is_given_time(session, walk, monkeypatch):
    counted: list[int] = []

    def counting(*given):
        counted[-1] += 1
        return frame_equations(*given)

    monkeypatch.setattr("solver_backend.fitters.recipes.live.frame_equations", counting)
    for i in range(12):
        session.network.markers = walk[i]
        counted.append(0)
        lines = list(session.step(PointFrame(i / FPS, walk[i], time.perf_counter())))
    assert counted == 8 * [3] + 4 * [1]
    assert lines[-1]["state"] == "tracking" and lines[-1]["off_mm"] < 20
