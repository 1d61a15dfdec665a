"""The live chain in real processes: from a recording at its own rate to points, recording on the way."""

from __future__ import annotations

import json
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.camera_calibration.formats import write_calibration
from solver_backend.cli.main import main
from solver_backend.exchange.command import cancel_on_signals
from solver_backend.exchange.errors import Cancelled
from solver_backend.io.native.capture_file import read_capture
from solver_backend.live.frames import from_lines
from solver_backend.sensors import chain as chain_module
from solver_backend.sensors.chain import END_S, KEPT, ChainStatistics, LiveMoment, MarkerChain, SensorTask
from solver_backend.sensors.devices.recorded import RecordedSensor, Recording, open_folder
from solver_backend.sensors.fusion.moments import Finding, fuse
from tests.support.recorded_markers import CAMERAS, FRAMES, POINTS, recorded
from tests.support.slow_sensor import Slow
from tests.support.unplugged_sensor import Unplugged


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("chain") / "take")


def test_frames_go_through_and_are_recorded(recording: Path, tmp_path: Path) -> None:
    folder = open_folder(recording)
    copy = Recording(tmp_path / "copy", "raw", folder.fps, folder.cameras)
    tasks = [SensorTask(device, CAMERAS, record=copy.folder, live=False) for device in folder.devices]
    with MarkerChain(tasks, folder.fps, recording=copy) as chain:
        came = list(chain.moments())
    assert chain.statistics.frames == dict.fromkeys(CAMERAS.names, FRAMES)
    assert {name: (end.frames, end.written, end.dropped) for name, end in chain.ends.items()} == dict.fromkeys(
        CAMERAS.names, (FRAMES, FRAMES, 0)
    )
    # Nothing is left out and nobody is called silent, however uneven the processes are.
    assert [m.kind for m in came if isinstance(m, Finding)] == [] and chain.statistics.moments == FRAMES
    last = [m for m in came if isinstance(m, LiveMoment)][-1].tracked
    off = np.linalg.norm(last.points[:, None] - POINTS - [0, 0, 0.002 * (FRAMES - 1)], axis=-1).min(1)
    assert len(last.points) == 8 and off.max() < 0.01
    again = open_folder(copy.folder)
    for one, other in zip(folder.devices, again.devices, strict=True):
        for a, b in zip(one.frames(), other.frames(), strict=True):
            assert (a.infrared == b.infrared).all() and a.device_s == pytest.approx(b.device_s) and a.number == b.number


@pytest.mark.slow
def test_sensors_that_can_wait_wait_for_the_slowest(recording: Path) -> None:
    folder = open_folder(recording)
    fast, slow = folder.devices
    assert isinstance(slow, RecordedSensor)
    tasks = [SensorTask(fast, CAMERAS, live=False), SensorTask(Slow(slow), CAMERAS, live=False)]
    with MarkerChain(tasks, folder.fps) as chain:
        came = list(chain.moments())
    assert all(isinstance(m, LiveMoment) for m in came) and len(came) == FRAMES
    assert chain.statistics.skipped == 0 and not chain.statistics.lost


def test_sensors_that_wait_end_as_soon_as_they_are_told(recording: Path) -> None:
    """Those far ahead are no longer read: at the end they must be, or they are killed after seconds without a word."""
    folder = open_folder(recording)
    tasks = [SensorTask(replace(device, repeat=True), CAMERAS, live=False) for device in folder.devices]
    with MarkerChain(tasks, folder.fps) as chain:
        next(chain.moments())
        deadline = time.monotonic() + 10.0
        while not all(chain._is_ahead(c) for c in chain._open) and time.monotonic() < deadline:
            chain._listen(0.01)
        assert all(chain._is_ahead(c) for c in chain._open)
        spent, begin = time.process_time(), time.monotonic()
        for _ in range(20):
            chain._listen(0.01)
        assert time.monotonic() - begin >= 0.2 and time.process_time() - spent < 0.1
        begin = time.monotonic()
    assert time.monotonic() - begin < END_S
    assert set(chain.ends) == set(CAMERAS.names)


@pytest.mark.slow
def test_a_time_limit_ends_the_wait_for_sensors_that_never_end(recording: Path) -> None:
    folder = open_folder(recording)
    tasks = [SensorTask(replace(device, repeat=True), CAMERAS) for device in folder.devices]
    with MarkerChain(tasks, folder.fps) as chain:
        begin = time.perf_counter()
        list(chain.moments(begin + 0.5))
        assert 0.5 <= time.perf_counter() - begin < 10.0


@pytest.mark.slow
def test_a_chain_that_is_too_slow_leaves_moments_out_and_does_not_lag(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fusing a moment takes three times as long as there is: what waits is left out, or it would wait for seconds."""
    folder = open_folder(recording)
    monkeypatch.setattr(chain_module, "fuse", lambda *given: time.sleep(3.0 / folder.fps) or fuse(*given))
    tasks = [SensorTask(replace(device, repeat=True), CAMERAS) for device in folder.devices]
    waited = []
    with MarkerChain(tasks, folder.fps) as chain:
        for came in chain.moments():
            if isinstance(came, LiveMoment):
                waited.append(time.perf_counter() - came.arrived)
            if len(waited) == 25:
                break
    statistics = chain.statistics
    assert statistics.skipped + sum(statistics.lost.values()) > 0
    # Each moment left out would have waited another 2 / fps: at the end as many as there are moments of the chain.
    assert np.median(waited[-8:]) < 0.5 * 2.0 / folder.fps * len(waited)
    assert statistics.moments == len(waited)


@pytest.mark.slow
def test_a_sensor_that_is_pulled_out_comes_back_and_one_that_is_wrong_is_named(recording: Path) -> None:
    folder = open_folder(recording)
    first, second = (replace(device, repeat=True) for device in folder.devices)
    assert isinstance(second, RecordedSensor)
    wrong = replace(second, name="nobody")
    tasks = [
        SensorTask(Unplugged(first, first.name, 5), CAMERAS), SensorTask(second, CAMERAS),
        SensorTask(wrong, CAMERAS),
    ]  # fmt: skip
    kinds: list[str] = []
    told = {"sensor_failed", "sensor_silent", "sensor_unknown", "sensor_back"}
    with MarkerChain(tasks, folder.fps) as chain:
        for came in chain.moments():
            if isinstance(came, Finding):
                kinds.append(came.kind)
            # On a busy machine a sensor may be late, and back, before the cable comes out.
            if (told <= set(kinds) and chain.statistics.frames["sensor0"] > 5) or chain.statistics.moments > 2000:
                break
    assert told <= set(kinds)
    assert chain.statistics.frames["sensor1"] > 0 and chain.statistics.frames["sensor0"] > 5


def test_the_command_line_goes_from_sensors_to_lines_that_live_reads(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines, take = tmp_path / "lines.jsonl", tmp_path / "take"
    command = ["sensors live", str(recording), "--repeat", "--lines", str(lines), "--record", str(take), "--json"]
    assert main([*command, "--seconds", "1.5"]) == 0
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["event"] == "result" and said["moments"] > 0 and said["latency_ms"] > 0
    with lines.open("rb") as stream:
        frames = list(from_lines(stream))
    assert frames and not any(frame.fault for frame in frames)
    assert max(len(frame.points) for frame in frames) == 8
    assert all(device.count() > 0 for device in open_folder(take).devices)


def test_who_stops_while_the_recording_is_written_keeps_it(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A replay is over and its sensors are ending when Stop is pressed: the recording is there, and named."""
    ending = MarkerChain.__exit__

    def stopped(chain: MarkerChain, *left: Any) -> None:
        signal.raise_signal(signal.SIGTERM)
        ending(chain, *left)

    monkeypatch.setattr(MarkerChain, "__exit__", stopped)
    take = tmp_path / "take"
    command = [
        "sensors live",
        str(recording),
        "--wand",
        "--lines",
        str(tmp_path / "lines.jsonl"),
        "--record",
        str(take),
    ]
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["recorded"] == str(take)
    with cancel_on_signals(), pytest.raises(Cancelled):  # afterwards a signal cancels again
        signal.raise_signal(signal.SIGTERM)


@pytest.mark.slow
def test_a_wand_is_told_where_it_was_and_where_to_go(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Eight markers are no wand: it is said so, and nothing counts as covered."""
    lines = tmp_path / "lines.jsonl"
    command = ["sensors live", str(recording), "--wand", "--repeat", "--seconds", "2", "--lines", str(lines), "--json"]
    assert main(command) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["moments"] > 0
    told = [line for line in map(json.loads, lines.read_text("utf-8").splitlines()) if "coverage" in line]
    assert told and all(line["coverage"] == dict.fromkeys(CAMERAS.names, 0.0) for line in told)
    assert any("More than one light is visible" in line["why"] for line in told)
    assert "Wave in the" in told[-1]["why"] and len(told[-1]["cloud"]) > 0


def test_a_recording_of_sensors_is_converted_as_any_capture(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "capture.npz"
    assert main(["convert", str(recording), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    markers = read_capture(out).markers
    assert said["frames"] == FRAMES and markers is not None and markers.covariance is not None
    assert np.isfinite(markers.covariance[np.isfinite(markers.positions).all(-1)]).all()


@pytest.mark.parametrize("verb", ["info", "solve"])
def test_reading_a_folder_of_sensors_never_finds_its_markers(
    verb: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(*_: Any, **__: Any) -> None:
        pytest.fail("reading started acquisition and fusion")

    monkeypatch.setattr("solver_backend.sensors.chain.cloud_of", started)
    out = ["--out", str(tmp_path / "motion.npz")] if verb == "solve" else []
    assert main([verb, str(recording), *out, "--json"]) == 3
    error = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert error["code"] == "capture_not_recognised" and error["where"] == str(recording)
    assert "sensors" in error["message"] and "sensors markers" in error["hint"]


def test_what_does_not_go_together_is_refused_before_a_sensor_opens(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, code in (
        ([], "command_line_invalid"),
        ([str(recording), "--oak", "1"], "command_line_invalid"),
        ([str(recording), "--wand", "--poses"], "command_line_invalid"),
        ([str(recording), "--solve", str(tmp_path / "m.npz")], "command_line_invalid"),
        ([str(recording), "--subject", "s.npz"], "command_line_invalid"),
        ([str(recording), "--send", "vmc://"], "command_line_invalid"),
        ([str(recording), "--poses", "--send", "127.0.0.1"], "command_line_invalid"),
        ([str(recording), "--poses", "--subject", "none.npz", "--record", str(tmp_path / "r")], "file_missing"),
        (["--oak", "webcam:1"], "sensor_unknown"),
        (["--oak", "1=a", "--oak", "2=a"], "command_line_invalid"),
    ):
        assert main(["sensors live", *arguments, "--json"]) != 0
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["code"] == code, arguments
    assert not list(tmp_path.iterdir())


def test_oaks_without_depthai_are_named_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "depthai", None)  # an import of it fails
    calibration = tmp_path / "rig.toml"
    write_calibration(calibration, CAMERAS)
    told = ["--oak", "1=sensor0", "--calibration", str(calibration), "--json"]
    for command in (
        ["sensors live", *told],
        ["sensors record", str(tmp_path / "take"), *told],
        ["sensors list", "--json"],
    ):
        assert main(command) != 0
        error = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert error["code"] == "backend_missing" and "pip install depthai" in error["hint"]
    assert not (tmp_path / "take").exists()


def test_the_command_line_writes_a_cloud_and_names_its_errors(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cloud.c3d"
    assert main(["sensors markers", str(recording), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["frames"] == FRAMES and said["points"] == 8.0 and 0 < said["sigma_mm"] < 5
    for arguments, code, exit_code in (
        ([str(recording), "--out", str(out)], "output_exists", 3),
        ([str(recording), "--out", "a.xyz"], "command_line_invalid", 2),
        ([str(tmp_path), "--out", str(tmp_path / "b.trc")], "recording_invalid", 3),
    ):
        assert main(["sensors markers", *arguments, "--json"]) == exit_code
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["code"] == code


def test_statistics_do_not_grow() -> None:
    statistics = ChainStatistics()
    for k in range(3 * KEPT):
        statistics.add(0.01, 53, k / 60)
    assert statistics.summary()["fps"] == 60.0 and statistics.summary()["latency_p99_ms"] == 10.0
    assert len(statistics._latency_ms) == KEPT


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Signal masks are read from /proc.")
def test_ctrl_c_cannot_interrupt_a_sensor_that_loads_its_libraries(recording: Path) -> None:
    folder = open_folder(recording)
    tasks = [SensorTask(replace(device, repeat=True), CAMERAS) for device in folder.devices]
    with MarkerChain(tasks, folder.fps) as chain:
        states = [Path(f"/proc/{process.pid}/status").read_text("utf-8") for process in chain._processes]
    blocked = [int(line.split()[1], 16) for state in states for line in state.splitlines() if line.startswith("SigBlk")]
    assert len(blocked) == len(CAMERAS) and all(mask >> (signal.SIGINT - 1) & 1 for mask in blocked)
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
