"""Nothing that happens to a live run takes what it recorded before."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import OutputExists, OutputNotWritable
from solver_backend.io.markers.read import read_markers
from solver_backend.live.frames import PointFrame
from solver_backend.live.recordings import (
    PointRecorder,
    PointsRecording,
    Recorder,
    record_points,
    recording_of,
    recover,
)
from tests.support.full_disk import full_disk

ROOT = Path(__file__).parents[2]
FRAMES = 30


def frames(count: int = FRAMES, points: int = 20) -> list[PointFrame]:
    """Points of a body's size in millimetres."""
    rng = np.random.default_rng(3)
    return [PointFrame(k / 60.0, rng.uniform(0.0, 1700.0, (points, 3)), 0.0) for k in range(count)]


@pytest.mark.parametrize("first_s", [86_399.8, 3.0e9], ids=["over midnight", "since 1970 and more"])
def test_times_of_day_cost_no_frame(first_s: float, tmp_path: Path) -> None:
    day = 86_400.0 if first_s < 1e5 else np.inf
    of_day = [PointFrame((first_s + frame.time) % day, frame.points, 0.0) for frame in frames()]
    assert day > 1e9 or of_day[-1].time < 1.0
    with recorder(tmp_path / "a.c3d", None) as record:
        list(record_points(iter(of_day), record))
    cloud = read_markers(tmp_path / "a.c3d").cloud
    assert cloud.fps == pytest.approx(60.0, rel=0.01)
    assert len(cloud.positions) == FRAMES


def recorder(path: Path, fps: float | None = 60.0, *, overwrite: bool = False) -> PointRecorder:
    return Recorder(path, PointsRecording(fps, lambda: 1e-3 * np.eye(3)), overwrite=overwrite)


def test_what_was_recorded_becomes_a_c3d_and_nothing_else_stays(tmp_path: Path) -> None:
    path, came = tmp_path / "walk.c3d", frames()
    with recorder(path) as record:
        assert list(record_points(came, record)) == came
        assert recording_of(path).stat().st_size > 0
    take = read_markers(path)
    assert np.allclose(take.cloud.positions, [1e-3 * frame.points for frame in came], atol=1e-6)
    assert take.cloud.fps == 60.0 and os.listdir(tmp_path) == ["walk.c3d"]


def test_an_error_on_the_way_keeps_what_came_before(tmp_path: Path) -> None:
    def breaks() -> Iterator[PointFrame]:
        yield from frames(9)
        raise MemoryError

    with pytest.raises(MemoryError), recorder(tmp_path / "walk.c3d") as record:
        list(record_points(breaks(), record))
    assert len(read_markers(tmp_path / "walk.c3d").cloud.positions) == 9


def test_a_run_without_points_leaves_no_file(tmp_path: Path) -> None:
    with recorder(tmp_path / "walk.c3d") as record:
        came = [PointFrame(0.0, np.zeros((0, 3)), 0.0), PointFrame(0.0, np.ones((9, 3)), 0.0, "no")]
        list(record_points(came, record))
    assert os.listdir(tmp_path) == []


def test_a_full_disk_costs_the_frames_that_do_not_fit(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d"
    record = recorder(path)
    with full_disk(5000):
        list(record_points(frames(), record))
    assert 0 < record.count < FRAMES
    with pytest.raises(OutputNotWritable, match=r"frames could not be written"):
        record.finish()
    assert len(read_markers(path).cloud.positions) == record.count


def test_what_cannot_be_finished_stays_and_is_named(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d"
    record = recorder(path)
    list(record_points(frames(), record))
    with full_disk(2000), pytest.raises(OutputNotWritable) as caught:
        record.finish()
    assert "walk.c3d.recording" in caught.value.hint
    assert len(read_markers(recording_of(path)).cloud.positions) == FRAMES
    assert PointsRecording().finish(recording_of(path), path) and os.listdir(tmp_path) == ["walk.c3d"]


def test_frames_that_a_full_disk_cost_are_counted_where_finishing_fails_too(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d"
    record = recorder(path)
    with full_disk(5000):
        list(record_points(frames(), record))
        with pytest.raises(OutputNotWritable) as caught:
            record.finish()
    assert f"{record.count} of {FRAMES} frames are in walk.c3d.recording" in caught.value.hint


def test_the_next_run_finishes_what_a_killed_one_left(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d"
    killed = recorder(path)
    list(record_points(frames(7), killed))
    with pytest.raises(OutputNotWritable, match="Another process is recording"):
        recorder(path)
    os.close(killed._file.handle)  # as the system does
    with recorder(path) as record:
        assert record.recovered == tmp_path / "walk_recovered_1.c3d"
        list(record_points(frames(3), record))
    assert len(read_markers(tmp_path / "walk_recovered_1.c3d").cloud.positions) == 7
    assert len(read_markers(path).cloud.positions) == 3
    assert sorted(os.listdir(tmp_path)) == ["walk.c3d", "walk_recovered_1.c3d"]
    with pytest.raises(OutputExists):
        recorder(path)
    assert recover(path, PointsRecording().finish) is None


def test_what_was_killed_between_its_file_and_its_end_is_kept_though_the_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d"
    killed = recorder(path)
    list(record_points(frames(7), killed))
    os.close(killed._file.handle)
    path.write_bytes(b"finished")
    with pytest.raises(OutputExists):
        recorder(path)
    assert sorted(os.listdir(tmp_path)) == ["walk.c3d", "walk_recovered_1.c3d"]
    assert len(read_markers(tmp_path / "walk_recovered_1.c3d").cloud.positions) == 7


def test_memory_does_not_grow_with_the_recording(tmp_path: Path) -> None:
    def peak(count: int) -> int:
        path = tmp_path / f"{count}.c3d"
        frame = frames(1, 40)[0]
        tracemalloc.start()
        with recorder(path) as record:
            for _ in record_points((PointFrame(k / 120.0, frame.points, 0.0) for k in range(count)), record):
                pass
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    assert peak(6000) < 1.3 * peak(1500)


COMMAND = [sys.executable, "-m", "solver_backend", "live stream", "-"]


def lines(count: int) -> bytes:
    return b"".join(
        json.dumps({"t": frame.time, "points": frame.points.tolist()}).encode() + b"\n" for frame in frames(count)
    )


def run(tmp_path: Path, data: bytes, *options: str) -> subprocess.CompletedProcess[bytes]:
    command = [*COMMAND, "--record", str(tmp_path / "walk.c3d"), *options]
    return subprocess.run(command, input=data, capture_output=True, check=False, cwd=ROOT)


@pytest.mark.parametrize(
    "spoiled",
    [
        pytest.param(b"\xff\xfe 1 2 3\n", marks=pytest.mark.slow),
        b'{"t": 1, "points": [[1e300, 0, 0], [1, -1e300, 2]]}\n',
        pytest.param(b"\x00" * 300_000, marks=pytest.mark.slow),
    ],
)
def test_whatever_comes_on_standard_input_the_recording_is_written(tmp_path: Path, spoiled: bytes) -> None:
    done = run(tmp_path, lines(20) + spoiled + b"\n" + lines(5), "--lines", str(tmp_path / "poses.jsonl"))
    assert done.returncode == 0, done.stderr
    take = read_markers(tmp_path / "walk.c3d")
    assert len(take.cloud.positions) >= 25 and np.nanmax(np.abs(take.cloud.positions)) < 10.0


@pytest.mark.slow
def test_a_killed_run_loses_nothing(tmp_path: Path) -> None:
    command = [*COMMAND, "--record", str(tmp_path / "walk.c3d")]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT)
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(lines(25))
    process.stdin.flush()
    told = [json.loads(process.stdout.readline()) for _ in range(4)]  # later frames may be dropped, to be in time
    time.sleep(0.5)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdin.close()
    process.stdout.close()
    assert len(read_markers(tmp_path / "walk.c3d.recording").cloud.positions) >= sum("frame" in line for line in told)
    done = run(tmp_path, lines(4), "--json")
    assert json.loads(done.stdout.splitlines()[-1])["recovered"].endswith("walk_recovered_1.c3d")
    assert len(read_markers(tmp_path / "walk_recovered_1.c3d").cloud.positions) == 25


def test_a_full_disk_of_the_lines_leaves_the_recording_alone(tmp_path: Path) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no device that is always full")
    command = [*COMMAND, "--record", str(tmp_path / "walk.c3d"), "--json"]
    with full.open("wb") as stream:
        done = subprocess.run(command, input=lines(20), stdout=stream, stderr=subprocess.PIPE, check=False, cwd=ROOT)
    assert len(read_markers(tmp_path / "walk.c3d").cloud.positions) == 20
    assert done.returncode != 0
