"""Steps of a simulated walk with known times, motions without steps, and walks over force plates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.biomechanics.gait import find_gait, mean_cycles
from solver_backend.biomechanics.joint_angles import isb_angles
from solver_backend.biomechanics.open_sim import virtual_markers
from solver_backend.biomechanics.segments import PosedSegments, posed_segments
from solver_backend.body.body import load_body
from solver_backend.cli.main import main
from solver_backend.cli.motion_export import gait_lines, gait_text
from solver_backend.fitters.pipeline import solve
from solver_backend.io.load import load_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.report.biomechanics import _gait_table
from solver_backend.types import FLAG_UNSEEN, MarkerCloud
from tests.biomechanics.agreement import NEAR_S, STEPS, step_errors, steps
from tests.support.still_pose import still

FPS, PERIOD, STANCE, SPEED = 100.0, 1.1, 0.6, 1.3
LABELS = ("RCAL", "RTOE", "RMT5", "LCAL", "LTOE", "LMT5")


def foot_places(times: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
    """Return places of a heel and of toes along and up: on the floor in a stance, along a half sine in a swing."""
    phase = (times - delay) / PERIOD
    number, share = np.floor(phase), phase % 1.0
    swing = np.clip((share - STANCE) / (1.0 - STANCE), 0.0, 1.0)
    along = SPEED * PERIOD * (number + 0.5 - 0.5 * np.cos(np.pi * swing))
    heel = 0.1 * np.sin(np.pi * swing)
    return np.stack([along, heel], axis=-1), np.stack([along + 0.15, 0.5 * heel], axis=-1)


def walked(seconds: float = 6.0) -> tuple[PosedSegments, MarkerCloud]:
    times = np.arange(round(seconds * FPS)) / FPS
    posed = posed_segments(still(len(times)), load_body())
    points = np.zeros((len(times), 6, 3))
    for k, delay in enumerate((0.0, PERIOD / 2)):
        heel, toes = foot_places(times, delay)
        for j, place in enumerate((heel, toes, toes)):
            points[:, 3 * k + j, 0], points[:, 3 * k + j, 2] = place.T
    pelvis = np.column_stack([SPEED * times + 0.5, np.zeros(len(times)), np.full(len(times), 0.9)])
    forward = np.broadcast_to(np.eye(3), (len(times), 3, 3))
    posed = replace(
        posed,
        rotations={**posed.rotations, "pelvis": forward},
        joints={**posed.joints, "pelvis": pelvis},
        ground=np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    )
    return posed, MarkerCloud(points, FPS, LABELS)


def test_a_simulated_walk_has_its_times_and_lengths():
    gait = find_gait(*walked())
    for side, delay in (("right", 0.0), ("left", PERIOD / 2)):
        strikes, offs = (delay + PERIOD * (np.arange(-1, 8) + share) for share in (0.0, STANCE))
        # The simulated toes leave with speed 0 and pass the pelvis' speed 36 ms later.
        for found, true, most in ((gait.strikes[side], strikes, 0.015), (gait.offs[side], offs, 0.04)):
            assert len(found) >= 4
            assert max(np.abs(true - t).min() for t in found) < most
    assert len(gait.strides) >= 7
    for stride in gait.strides:
        assert stride.time_s == pytest.approx(PERIOD, abs=0.01) and stride.speed_m_s == pytest.approx(SPEED, rel=0.02)
        assert stride.stance_percent == pytest.approx(100 * STANCE, abs=4)
        assert stride.length_m == pytest.approx(SPEED * PERIOD, rel=0.02)


@pytest.mark.parametrize(("raised", "count"), [(0.0, 4), (0.2, 0)])
def test_a_heel_that_glides_over_the_floor_strikes_where_it_stops(raised, count):
    posed, cloud = walked()
    points = cloud.positions.copy()
    points[..., 2] = 0.0  # A shuffle: the feet do not leave the floor.
    if raised:  # The same swing ends in the air, and the foot stays there.
        points[:, (0, 3), 2] = raised * (np.arange(600) > 150)[:, None]
    gait = find_gait(posed, replace(cloud, positions=points))
    for side, delay in (("right", 0.0), ("left", PERIOD / 2)):
        found = gait.strikes[side][gait.strikes[side] > 1.5]
        assert len(found) >= count and (count or not len(found[found < 2.5]))
        assert max((np.abs(delay + PERIOD * np.arange(8) - t).min() for t in found if count), default=0.0) < 0.04


def test_steps_in_interpolated_frames_are_left_out():
    posed, cloud = walked()
    flags = np.zeros(600, np.uint8)
    flags[150:300] = FLAG_UNSEEN
    whole, seen = find_gait(posed, cloud).events(), find_gait(posed, cloud, flags).events()
    assert seen == [event for event in whole if not 1.5 <= round(event[0], 2) < 3.0]
    assert all(not 1.5 < s.strike_s < 3.0 and s.time_s < 1.5 for s in find_gait(posed, cloud, flags).strides)


@pytest.mark.parametrize("end", [272, 285, 300])
def test_a_gap_makes_no_long_stride(end):
    posed, cloud = walked()
    flags = np.zeros(600, np.uint8)
    flags[212:end] = FLAG_UNSEEN
    strides = find_gait(posed, cloud, flags).strides
    assert len(strides) >= 3
    for stride in strides:
        assert stride.time_s == pytest.approx(PERIOD, abs=0.01) and stride.stance_percent == pytest.approx(60, abs=4)
        assert stride.next_s < 2.13 or stride.strike_s > 0.01 * end - 0.02


def test_a_pause_is_no_stride():
    posed, cloud = walked()
    frames = np.r_[0:290, np.full(1000, 290), 290:600]  # The walker freezes with one foot in front of the other.
    posed = replace(
        posed,
        joints={name: points[frames] for name, points in posed.joints.items()},
        rotations={name: turns[frames] for name, turns in posed.rotations.items()},
    )
    strides = find_gait(posed, replace(cloud, positions=cloud.positions[frames])).strides
    assert len(strides) >= 4 and max(stride.time_s for stride in strides) < 1.2


def test_a_treadmill_has_no_length_and_speed():
    posed, cloud = walked()
    belt = SPEED * np.arange(600)[:, None] / FPS * [1.0, 0.0, 0.0]
    posed = replace(posed, joints={**posed.joints, "pelvis": posed.joints["pelvis"] - belt})
    gait = find_gait(posed, replace(cloud, positions=cloud.positions - belt[:, None]))
    assert len(gait.strides) >= 7 and all(np.isnan(stride.length_m) for stride in gait.strides)
    assert "nan" not in gait_text(gait) and len({line.count(",") for line in gait_text(gait).splitlines()}) == 1
    assert all("treadmill" in line and "nan" not in line and "stride length" not in line for line in gait_lines(gait))
    assert "nan" not in _gait_table(gait)


def test_squats_and_short_takes_have_no_steps():
    bend = (1 - np.cos(np.linspace(0, 8 * np.pi, 400)))[:, None] * [1.0, 0.0, 0.0]
    squat = still(400, left_knee=bend, right_knee=bend, left_hip=-bend, right_hip=-bend)
    feet = posed_segments(squat, load_body()).joints["left_ankle"]
    squat = replace(squat, transl=feet[0] - feet)  # The feet stay, the pelvis moves.
    for motion in (squat, still(1), still(2)):
        posed = posed_segments(motion, load_body())
        assert find_gait(posed, virtual_markers(motion, load_body(), posed)).events() == []


def test_mean_curves_are_means_over_the_cycles():
    posed, cloud = walked()
    gait, angles = find_gait(posed, cloud), isb_angles(posed)
    ramp = np.linspace(0.0, 59.9, len(angles.degrees))
    angles = replace(angles, names=("right_knee_flexion",), degrees=ramp[:, None])
    strides = [s for s in gait.strides if s.side == "right"]
    curve = mean_cycles(angles, gait, FPS)["right_knee_flexion"]
    rate = ramp[1] * FPS
    assert curve[0, 0] == pytest.approx(rate * np.mean([s.strike_s for s in strides]), abs=1e-6)
    assert curve[100, 0] == pytest.approx(rate * np.mean([s.next_s for s in strides]), abs=1e-6)
    assert curve[0, 1] == pytest.approx(rate * np.std([s.strike_s for s in strides], ddof=1), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("take", "median_s"), [("PiG_Motion-FlatFoot-Full", 0.010), ("FunctionalWalk", 0.010), ("PlugInC3D", 0.018)]
)
def test_steps_agree_with_force_plates(shared_data, take, median_s):
    """Takes on which no constant was chosen."""
    pytest.importorskip("ezc3d")
    errors = step_errors(steps(solve(load_capture(shared_data / STEPS[take])).motion), shared_data / STEPS[take])
    offs = [abs(seconds) for _, seconds, _ in errors]
    assert len(offs) >= 4 and np.median(offs) < median_s and sum(off > NEAR_S for off in offs) <= (take == "PlugInC3D")


def test_steps_are_events_of_the_c3d_file_and_rows_of_the_tables(tmp_path, monkeypatch, capsys):
    ezc3d = pytest.importorskip("ezc3d")
    posed, cloud = walked(3.5)
    monkeypatch.setattr("solver_backend.cli.motion_export.find_gait", lambda *_: find_gait(posed, cloud))
    write_motion(tmp_path / "walk.npz", still(350))
    recordings = [tmp_path / "out" / f"walk{ending}" for ending in (".c3d", ".trc")]
    recordings[0].parent.mkdir()
    for recording in recordings:
        recording.write_text("recorded")
    command = ["motion export", str(tmp_path / "walk.npz"), "--out", str(tmp_path / "out")]
    assert main(command) == 0 and all(recording.read_text() == "recorded" for recording in recordings)
    events = find_gait(posed, cloud).events()
    group = ezc3d.c3d(str(tmp_path / "out" / "walk_events.c3d"))["parameters"]["EVENT"]
    assert group["USED"]["value"][0] == len(events)
    assert group["CONTEXTS"]["value"] == [side for _, side, _ in events]
    assert group["LABELS"]["value"] == [name for _, _, name in events]
    times = 60 * group["TIMES"]["value"][0] + group["TIMES"]["value"][1]
    assert np.abs(times - [time for time, _, _ in events]).max() < 1e-5
    lines = (tmp_path / "out" / "walk_gait.csv").read_text().splitlines()
    assert sum(line.startswith("event,") for line in lines) == len(events)
    assert len({line.count(",") for line in lines}) == 1
    assert len((tmp_path / "out" / "walk_cycles.csv").read_text().splitlines()) == 102
    monkeypatch.undo()
    assert main([*command, "--overwrite"]) == 0  # The still motion itself has no steps.
    assert "walk_events.c3d, walk_gait.csv, walk_cycles.csv in the folder" in capsys.readouterr().out
