"""Cameras to poses: as near the truth as a solve nearly, recorded, and a solve starts from it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.cli.live_verb import recorded
from solver_backend.cli.main import main
from solver_backend.exchange.errors import FileDamaged, OutputNotWritable
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.live.frames import ViewMoment
from solver_backend.live.recordings import Recorder, recording_of
from solver_backend.live.views_session import ViewsSession
from solver_backend.videos.streaming.moments import LiveMoments
from solver_backend.videos.streaming.recording import ViewsRecording, motion_of, run_recorded
from tests.support.filmed_moments import FakeCamera, FakeDetector, demo_views, seen_by
from tests.support.full_disk import full_disk

ROOT = Path(__file__).parents[3]
FPS = 60.0


@pytest.fixture(scope="module")
def filmed():
    return demo_views([0, 1])


def session_of(filmed, **values) -> ViewsSession:
    return ViewsSession(filmed.cameras, filmed.keypoints.joint_set, **values)


def moments_of(filmed, every: int = 3, frames: int = 360) -> list[ViewMoment]:
    views = [seen_by(filmed, view)[:, None] for view in range(len(filmed.cameras))]
    return [
        ViewMoment(k / FPS, 0.0, tuple(view[k] for view in views), (k / FPS,) * len(views))
        for k in range(0, frames, every)
    ]


def joints_of(line: dict, betas: np.ndarray) -> np.ndarray:
    turns = np.array([*line["root"], *line["pose"]]).reshape(1, -1, 3)
    posed = forward_kinematics(
        load_body(), betas, exp_so3(turns[:, 0]), exp_so3(turns[:, 1:]), np.array([line["trans"]])
    )  # fmt: skip
    return posed.joints[0, :22]


def off_mm(filmed, lines: list[dict], betas: np.ndarray) -> float:
    """Return the mean distance of the joints from the truth."""
    posed = [line for line in lines if "pose" in line]
    true = filmed.truth["joints"][[round(line["t"] * FPS) for line in posed], :22]
    return float(
        1e3
        * np.linalg.norm(np.stack([joints_of(line, line.get("betas", betas)) for line in posed]) - true, axis=-1).mean()
    )


@cache
def _solved() -> np.ndarray:
    return solve(demo_views([0, 1])).motion.joints[:, :22]


def solved_mm(filmed) -> float:
    """Return the mean distance of the joints of a solve."""
    return float(1e3 * np.linalg.norm(_solved() - filmed.truth["joints"][:, :22], axis=-1).mean())


def followed(filmed) -> tuple[ViewsSession, float, list[dict]]:
    """Return a run of two cameras whose detectors take 25 ms a picture, as a pose model does on a core of its own."""
    cameras = [FakeCamera(name, FPS, 360) for name in filmed.cameras.names]
    detectors = iter([FakeDetector(seen_by(filmed, view), 0.025) for view in range(2)])
    session, lines = session_of(filmed), []
    session.warm_up()
    begun = time.process_time()
    with LiveMoments(cameras, lambda: next(detectors)) as live:
        for line in session.run(live.moments()):
            lines.append({**line, "betas": session.fit.subject.betas})
    return session, time.process_time() - begun, lines


@pytest.mark.slow
def test_a_core_makes_twelve_poses_of_two_cameras_for_a_second_of_its_time(filmed):
    """A second of processor time beside the detectors; an overloaded machine gives it less, and fewer poses come."""
    _, cpu_s, lines = followed(filmed)
    poses = sum("pose" in line for line in lines)
    assert poses >= 12 and poses > 12 * cpu_s


@pytest.mark.slow
def test_ten_poses_a_second_are_within_half_as_much_again_of_a_solve(filmed):
    session = session_of(filmed)
    lines = list(session.run(moments_of(filmed, every=6)))
    assert sum("pose" in line for line in lines) >= 9 * 5  # of 6 s, the world takes the first
    assert off_mm(filmed, lines, session.fit.subject.betas) < 1.5 * solved_mm(filmed)


def test_a_start_that_leaves_an_arm_elsewhere_begins_once_more(filmed):
    moments = moments_of(filmed, every=5)[:24]
    off = []
    for may_start_anew in (True, False):
        session = session_of(filmed)
        session._may_start_anew = may_start_anew
        lines = list(session.run(moments))
        assert sum("pose" in line for line in lines) == 24 - 11 - may_start_anew
        off.append(off_mm(filmed, lines, session.fit.subject.betas))
    assert off[0] < 0.6 * off[1]


def test_a_person_who_is_lost_leaves_the_next_start_its_second_try(filmed, monkeypatch):
    moments, session = moments_of(filmed), session_of(filmed)
    list(session.run(moments[:40]))
    assert not session.fit.is_starting
    monkeypatch.setattr("solver_backend.live.views_session.BAD_M", 0.0)
    monkeypatch.setattr("solver_backend.live.views_session.LOST_S", 0.0)
    monkeypatch.setattr("solver_backend.live.views_session.doubts_of", lambda *_: "the left arm is 900 mm off")
    line: Any
    [line] = session.run(moments[40:41])
    assert "pose" in line and session.fit.pose is None
    [line] = session.run(moments[41:42])
    assert line["state"] == "waiting" and "starting again" in line["why"]


@pytest.mark.slow
def test_the_world_is_made_to_fit_and_named_once(filmed):
    c = filmed.cameras
    lower = replace(filmed, cameras=replace(c, t=c.t + 0.5 * c.R[..., 2]))
    lines: list[Any] = list(session_of(lower).run(moments_of(lower, 6)))
    [event] = [line for line in lines if line.get("event") == "world"]
    assert "floor" in event["message"]
    posed = [line for line in lines if "pose" in line]
    assert min(joints_of(line, np.zeros(10))[:, 2].min() for line in posed) == pytest.approx(0.08, abs=0.1)


@pytest.mark.slow
def test_bystanders_empty_pictures_and_nonsense_do_not_end_it(filmed):
    lines, session = [], session_of(filmed)
    rng = np.random.default_rng(0)
    for number, moment in enumerate(moments_of(filmed)):
        first, second = moment.people
        assert first is not None and second is not None
        other = np.concatenate([first + (400.0, 0.0, 0.0), first])  # somebody else is listed first
        if number % 10 == 3:
            people = (np.zeros((0, 25, 3)), second)
        elif number % 10 == 6:
            people = (np.full((1, 25, 3), np.nan), rng.uniform(-1e9, 1e9, (2, 25, 3)))
        elif number % 10 == 8:
            people = (None, second)
        else:
            people = (first if number < 20 else other, second)
        lines += session.run([ViewMoment(moment.time, moment.arrived, people, moment.times)])
    posed = [line for line in lines if "pose" in line and line["t"] > 1.5]
    assert len(posed) > 55
    assert off_mm(filmed, posed, session.fit.subject.betas) < 30.0
    assert {line["state"] for line in lines if "frame" in line} <= {"tracking", "unsure", "no_person", "waiting"}


@pytest.mark.slow
def test_arms_that_a_detector_exchanges_in_one_view_stay_where_they_are(filmed, monkeypatch):
    names = filmed.keypoints.joint_set.keypoints
    pairs = [[names.index(f"{side}_{part}") for side in ("left", "right")] for part in ("shoulder", "elbow", "wrist")]
    moments = moments_of(filmed)
    for moment in moments[40:70]:
        view = moment.people[1]
        assert view is not None
        for pair in pairs:
            view[0, pair] = view[0, pair[::-1]]
    with_it, without = session_of(filmed), session_of(filmed)
    monkeypatch.setattr(without._sides, "put_back", lambda seen, expected: (seen, 0))
    off = []
    for session in (with_it, without):
        lines = [line for line in session.run(moments) if "pose" in line and 2.0 <= line["t"] < 3.5]
        off.append(off_mm(filmed, lines, session.fit.subject.betas))
    assert with_it.sides_put_back >= 10
    assert off[0] < 4.0 * solved_mm(filmed) and off[0] < 0.8 * off[1]


@pytest.mark.slow
def test_a_start_with_exchanged_sides_is_mended_when_the_detector_is(filmed):
    names = filmed.keypoints.joint_set.keypoints
    left, right = ([row for row, name in enumerate(names) if name.startswith(side)] for side in ("left_", "right_"))
    moments = moments_of(filmed)
    for moment in moments[:30]:
        view = moment.people[1]
        assert view is not None
        view[0, [*left, *right]] = view[0, [*right, *left]]
    session = session_of(filmed)
    lines = [line for line in session.run(moments) if "pose" in line and line["t"] > 2.5]
    assert len(lines) > 60
    assert off_mm(filmed, lines, session.fit.subject.betas) < 3.0 * solved_mm(filmed)


@pytest.mark.slow
def test_time_that_runs_back_and_silences_start_anew(filmed):
    session, moments = session_of(filmed), moments_of(filmed)
    lines = list(session.run([*moments, *moments[:30]]))
    assert [line["event"] for line in lines if "event" in line].count("time_ran_back") == 1
    after = [line for line in lines[-20:] if "pose" in line]
    assert off_mm(filmed, after, session.fit.subject.betas) < 40.0


@pytest.mark.slow
def test_joints_that_no_view_shows_are_less_sure(filmed):
    arm = [i for i, name in enumerate(filmed.keypoints.joint_set.keypoints) if name in ("left_elbow", "left_wrist")]
    session = session_of(filmed)
    before = after = None
    for number, moment in enumerate(moments_of(filmed)):
        people = tuple(view.copy() for view in moment.people)
        for view in people:
            view[:, arm] = np.nan if number > 60 else view[:, arm]
        list(session.run([ViewMoment(moment.time, moment.arrived, people, moment.times)]))
        before = session.fit.deviations() if number == 60 else before
        after = session.fit.deviations()
    assert before is not None and after is not None
    wrist, other = 20, 21
    assert after[wrist] > 3.0 * before[wrist] and after[other] < 2.0 * before[other]


@pytest.fixture
def recorded_take(filmed, tmp_path) -> Path:
    session, path = session_of(filmed), tmp_path / "take.npz"
    with recorder_of(path, session) as recorder:
        record_into(session, recorder, moments_of(filmed))
    return path


def recorder_of(path: Path, session: ViewsSession) -> Recorder[...]:
    return Recorder(path, ViewsRecording(session, "fake"), overwrite=False)


def record_into(session: ViewsSession, recorder: Recorder[...], moments: list[ViewMoment]) -> list[Any]:
    return [line for moment in moments for line in run_recorded(session, moment, recorder)]


@pytest.mark.slow
def test_keypoints_times_and_poses_are_recorded_and_a_solve_starts_from_them(filmed, recorded_take):
    capture, live = read_capture(recorded_take), read_motion(motion_of(recorded_take))
    assert capture.keypoints is not None and capture.keypoints.fps == live.fps == 20.0
    assert capture.keypoints.num_frames == live.num_frames == 120
    true = filmed.keypoints.xy[:, ::3]
    np.testing.assert_allclose(capture.keypoints.xy, true, atol=1e-3)
    start = solve(capture, start=live).motion
    joints = filmed.truth["joints"][::3, :22]
    assert 1e3 * np.linalg.norm(start.joints[:, :22] - joints, axis=-1).mean() < 1.2 * solved_mm(filmed)
    assert not recording_of(recorded_take).exists()


@pytest.mark.slow
def test_a_view_that_was_left_out_is_filled_from_its_neighbours_and_not_over_long_gaps(filmed, tmp_path):
    session, path = session_of(filmed), tmp_path / "take.npz"
    moments = moments_of(filmed)
    for k in (40, 60, 61, 62, 63):
        seen = moments[k]
        moments[k] = ViewMoment(seen.time, 0.0, (None, seen.people[1]), (np.nan, seen.times[1]))
    with recorder_of(path, session) as recorder:
        record_into(session, recorder, moments)
    keypoints = read_capture(path).keypoints
    assert keypoints is not None
    seen = (keypoints.confidence[0] > 0).any(-1)
    assert seen[40] and not seen[61:63].any() and seen[70]


@pytest.mark.slow
def test_what_a_killed_run_left_is_finished_by_the_next(filmed, tmp_path):
    path = tmp_path / "take.npz"
    program = (
        "import os, signal\nfrom pathlib import Path\n"
        "from tests.videos.streaming.test_camera_live import *\n"
        "f = demo_views([0, 1]); s = session_of(f)\n"
        f"r = recorder_of(Path({str(path)!r}), s)\n"
        "record_into(s, r, moments_of(f)[:60])\nos.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, env={**os.environ}, check=False)
    assert ended.returncode == -signal.SIGKILL and recording_of(path).exists() and not path.exists()
    recorder = recorder_of(path, session_of(filmed))
    recorder.finish()
    assert recorder.recovered == tmp_path / "take_recovered_1.npz"
    assert read_motion(motion_of(recorder.recovered)).num_frames == 60


@pytest.mark.slow
def test_a_full_disk_costs_the_moments_that_do_not_fit(filmed, tmp_path):
    session, path = session_of(filmed), tmp_path / "take.npz"
    recorder = recorder_of(path, session)
    moments = moments_of(filmed)
    record_into(session, recorder, moments[:80])
    with full_disk(recorder.unfinished.stat().st_size + 100):
        record_into(session, recorder, moments[80:85])
    with pytest.raises(OutputNotWritable, match="moments"):
        recorder.finish()
    assert read_capture(path).keypoints is not None


def unlike(moments: list[ViewMoment]) -> list[ViewMoment]:
    """Return moments whose views disagree: the second view is shifted by far more than the person's size."""
    return [replace(m, people=(m.people[0], m.people[1] + np.array([0.0, 900.0, 0.0]))) for m in moments]


@pytest.mark.parametrize(
    ("state", "moments"),
    [
        ("no_person", lambda filmed: unlike(moments_of(filmed)[:15])),
        ("waiting", lambda filmed: moments_of(filmed)[:3]),
        ("tracking", lambda filmed: moments_of(filmed)[:15]),
        ("unsure", lambda filmed: moments_of(filmed)[:15]),
    ],
)
def test_a_recording_holds_every_moment_in_whichever_state_the_session_ends(
    filmed, tmp_path, monkeypatch, state, moments
):
    if state == "unsure":
        monkeypatch.setattr("solver_backend.live.views_session.BAD_M", 0.0)
    session, path, came = session_of(filmed), tmp_path / "take.npz", moments(filmed)
    lines: list[Any] = []
    with recorder_of(path, session) as recorder:
        for moment in came:
            lines += record_into(session, recorder, [moment])
    assert lines[-1]["state"] == state and recorder.count == len(came)
    keypoints = read_capture(path).keypoints
    assert keypoints is not None and keypoints.num_frames == len(came)
    assert (keypoints.confidence > 0).any(axis=(0, 2)).all()
    assert motion_of(path).exists() == (state in ("tracking", "unsure"))
    assert "take.npz.recording" not in os.listdir(tmp_path)


def test_a_moment_that_cannot_be_fitted_is_recorded_too(filmed, tmp_path, monkeypatch):
    session, path, moments = session_of(filmed), tmp_path / "take.npz", moments_of(filmed)[:4]

    def broken(*_: object) -> None:
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(session.fit, "locate", broken)
    with recorder_of(path, session) as recorder:
        lines = record_into(session, recorder, moments)
    assert {line.get("event") for line in lines} == {"restarted"}
    capture = read_capture(path)
    assert capture.keypoints is not None and capture.keypoints.num_frames == 4


def test_a_session_without_a_moment_or_a_person_is_named(filmed, tmp_path):
    nobody = [replace(m, people=(np.zeros((0, 25, 3)),) * 2) for m in moments_of(filmed)[:4]]
    for moments in ([], nobody):
        session, path = session_of(filmed), tmp_path / f"{len(moments)}.npz"
        with recorder_of(path, session) as recorder:
            record_into(session, recorder, moments)
        assert recorded(recorder) == {"not_recorded": str(path)} and not path.exists()


@pytest.mark.parametrize("content", [b"", b"\0" * 50, b'{"format": 1}\n', b"[]\n" + bytes(100)])
def test_a_recording_that_is_none_is_refused_and_kept(tmp_path, content):
    path = tmp_path / "take.npz.recording"
    path.write_bytes(content)
    if not content or b"\n" not in content:
        assert not ViewsRecording(None, "").finish(path, tmp_path / "take.npz")
        return
    with pytest.raises(FileDamaged):
        ViewsRecording(None, "").finish(path, tmp_path / "take.npz")
    assert path.exists()


def test_the_command_line_refuses_what_does_not_go_together(tmp_path, capsys):
    calibration = tmp_path / "calibration.toml"
    for options in (["a.mp4"], ["a.mp4", "b/a.mp4"], ["webcam:x", "webcam:1"], ["a.mp4", "b.mp4", "--rate", "0"]):
        assert main(["live cameras", *options, "--calibration", str(calibration), "--json"]) == 2
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["code"] == "command_line_invalid"
