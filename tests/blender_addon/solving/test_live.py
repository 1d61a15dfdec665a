"""What a live process says is taken for nothing that it is not."""

from __future__ import annotations

import json
import math
import sys

import numpy as np
import pytest

from blender_addon.solving.child import SolverProcess
from blender_addon.solving.live import LiveRun, read_pose_line
from blender_addon.ui.panels.acquire import timing_lines

POSE = {
    "frame": 3, "t": 0.1, "state": "tracking", "root": [0.1, 0.2, 0.3], "pose": [0.0] * 63, "trans": [1, 2, 3],
    "off_mm": 12.5, "cloud": [[0, 0, 1], [0, 1, 1]],
}  # fmt: skip


def run_of(lines: list[str], tmp_path) -> LiveRun:
    """Return the run of a child that says these lines and ends."""
    said = tmp_path / "said.txt"
    said.write_text("\n".join(lines) + "\n", encoding="utf-8")
    program = "import sys; sys.stdout.write(open(sys.argv[1], encoding='utf-8').read())"
    return LiveRun(SolverProcess([sys.executable, "-S", "-c", program, str(said)], {}, tmp_path))


def finished(run: LiveRun) -> list:
    """Return all poses that polls gave."""
    poses = []
    while not run.finished:
        if (pose := run.poll()) is not None:
            poses.append(pose)
    return poses


def test_the_newest_pose_is_shown_and_those_before_it_are_dropped(tmp_path):
    lines = [json.dumps({**POSE, "trans": [i, 0, 0]}) for i in range(500)]
    run = run_of([*lines, '{"event": "result", "verb": "live stream", "recorded": "take.c3d"}'], tmp_path)
    run.process.wait()
    poses = finished(run)
    assert len(poses) == 1 and poses[0].transl.tolist() == [499, 0, 0]
    assert run.shown + run.dropped == 500
    assert run.recorded is not None and run.recorded.name == "take.c3d" and run.failure == ""


@pytest.mark.parametrize(
    "line",
    [
        "{", "{}", "[]", '{"state": 3}', json.dumps({**POSE, "pose": [0.0] * 62}), json.dumps({**POSE, "root": "a"}),
        json.dumps({**POSE, "cloud": [[1, 2]]}), json.dumps({**POSE, "trans": [math.nan, 0, 0]}),
        json.dumps({**POSE, "trans": [1e300, 0, 0]}), '{"state": "tracking", "cloud": ' + "[" * 5000,
        json.dumps({**POSE, "cloud": {"a": 1}}),
    ],
)  # fmt: skip
def test_lines_that_are_no_poses_are_ignored(line, tmp_path):
    assert read_pose_line(line) is None
    run = run_of([json.dumps(POSE), line], tmp_path)
    finished(run)
    assert run.finished and "without a message" in run.failure


def test_a_run_that_was_stopped_before_it_began_has_not_failed(tmp_path):
    said = [sys.executable, "-S", "-c", "import sys; sys.stdin.read(); sys.exit(9)"]
    run = LiveRun(SolverProcess(said, {}, tmp_path))
    run.stop()
    finished(run)
    assert run.finished and run.failure == "" and run.recorded is None


def test_a_line_without_a_pose_says_why():
    pose = read_pose_line('{"state": "frozen", "why": "the same again", "points": 41}')
    assert pose is not None and pose.rotvec is None and pose.why == "the same again" and math.isnan(pose.off_mm)


def test_the_timing_of_a_line_is_kept_and_shown_and_nonsense_is_none():
    timing = {"rate_hz": 58.4, "latency_ms": 7.2, "lag_ms": 12.0, "dropped": 31}
    pose = read_pose_line(json.dumps({**POSE, **timing}))
    assert (pose.rate_hz, pose.latency_ms, pose.lag_ms, pose.dropped) == (58.4, 7.2, 12.0, 31)
    assert timing_lines(pose) == ["58 poses/s, 7 ms each", "12 ms behind", "31 frames dropped"]
    odd = read_pose_line(json.dumps({**POSE, "rate_hz": "fast", "lag_ms": None, "dropped": [math.inf]}))
    assert odd is not None and timing_lines(odd) == []


def test_events_tell_shape_and_faults(tmp_path):
    betas = np.linspace(-1, 1, 10).tolist()
    run = run_of(
        [
            json.dumps({"event": "shape", "message": "known", "betas": betas}),
            json.dumps({"event": "shape", "message": "nonsense", "betas": [1, "x"]}),
            json.dumps({"event": "line_ignored", "message": 7}),
            json.dumps({"event": "error", "code": "x", "message": "It broke.", "where": "", "hint": ""}),
        ],
        tmp_path,
    )
    finished(run)
    assert np.allclose(run.betas, betas) and run.message and "It broke" in run.failure
