"""Sensors from disk: what was recorded is read again, up to the last whole frame, whatever ended it."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import threading
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import CalibrationMissing, MocapError, OutputExists
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.png import png_bytes, read_png
from solver_backend.sensors.chain import SensorTask, cloud_of, run_sensor
from solver_backend.sensors.devices.device import Device, NoMarkers, RecordingInvalid, SensorFrame, SensorUnknown
from solver_backend.sensors.devices.recorded import (
    HEADER,
    INDEX,
    Recording,
    SensorFiles,
    SensorRecorder,
    StudioSensor,
    due_frames,
    open_folder,
    read_index,
)
from solver_backend.synthesis.studio.make_shot import make_shot
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import list_shots
from solver_backend.types import Capture
from tests.support.full_disk import full_disk
from tests.support.recorded_markers import CAMERAS, FPS, FRAMES, POINTS, recorded
from tests.support.sensor_pictures import Painter


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("sensors ü") / "take")


@pytest.fixture
def copy(recording: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recording, tmp_path / "copy"))


@pytest.mark.parametrize("kind", ["raw", "png"])
def test_what_was_recorded_is_read_again(kind: str, tmp_path: Path) -> None:
    folder = open_folder(recorded(tmp_path / "take", kind, 3))
    assert folder.fps == FPS and folder.cameras.names == CAMERAS.names
    assert np.allclose(folder.cameras.K, CAMERAS.K) and np.allclose(folder.cameras.t, CAMERAS.t)
    for view, device in enumerate(folder.devices):
        assert device.name == CAMERAS.names[view]
        with device:
            frames = list(device.frames())
        for k, frame in enumerate(frames):
            true = Painter(CAMERAS).frame(view, POINTS + [0, 0, 0.002 * k], k)
            assert (frame.infrared == true.infrared).all() and (frame.depth == true.depth).all()
            assert frame.device_s == pytest.approx(k / FPS, abs=1e-6) and frame.number == k
        assert len(frames) == 3


class Strange(Device):
    """A sensor whose frames are not of the calibration's size; the second one has yet another."""

    name = CAMERAS.names[0]

    def frames(self) -> Iterator[SensorFrame]:
        """Yield two frames."""
        for number, shape in enumerate([(4, 6), (5, 6)]):
            yield SensorFrame(self.name, np.full(shape, 7, np.uint8), None, number / FPS, 0.0, number)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_frames_that_cannot_be_used_are_recorded_all_the_same(tmp_path: Path, count: int) -> None:
    here, there = multiprocessing.Pipe()
    task = SensorTask(Strange(), CAMERAS, record=tmp_path, live=False)
    thread = threading.Thread(target=run_sensor, args=(task, there))
    with mock.patch.object(Strange, "frames", lambda self: islice(_frames(self), count)):
        thread.start()
        assert here.recv() == ("ready",)
        here.send(0.0)
        told = [here.recv()]
        while told[-1][0] != "end":
            told.append(here.recv())
        thread.join()
    assert told[-1][1].written == min(count, 1) and ("trouble" in [item[0] for item in told]) == (count > 0)
    if count:
        assert len(read_index(tmp_path / Strange.name / INDEX)) == 1


_frames = Strange.frames


def test_a_recorder_drops_frames_of_another_size(tmp_path: Path) -> None:
    first, other = Strange().frames()
    recorder = SensorRecorder(tmp_path, SensorFiles.of(first), "raw", patient=True)
    for frame in (first, other, first):
        recorder(frame)
    recorder.close()
    assert (recorder.written, recorder.dropped) == (2, 1)
    assert (tmp_path / Strange.name / "frames.bin").stat().st_size == 2 * 24


def test_a_recording_becomes_a_cloud(recording: Path) -> None:
    take = cloud_of(open_folder(recording))
    assert take.cloud.positions.shape == (FRAMES, 8, 3) and take.frames == dict.fromkeys(CAMERAS.names, FRAMES)
    true = POINTS + np.array([0, 0, 0.002]) * np.arange(FRAMES)[:, None, None]
    off = np.linalg.norm(take.cloud.positions[:, :, None] - true[:, None], axis=-1).min(2)
    assert 1e3 * np.sqrt((off**2).mean()) < 3.0 and not take.findings


def test_a_cut_off_recording_is_whole_up_to_there(copy: Path) -> None:
    frames = copy / "sensor0" / "frames.bin"
    with frames.open("r+b") as stream:
        stream.truncate(frames.stat().st_size - 5)
    index = copy / "sensor1" / INDEX
    index.write_text(index.read_text()[:-9])
    folder = open_folder(copy)
    assert [device.count() for device in folder.devices] == [FRAMES - 1, FRAMES - 1]
    assert len(cloud_of(folder).cloud.positions) == FRAMES - 1


def test_a_sensor_that_was_unplugged_leaves_the_others(copy: Path) -> None:
    index = copy / "sensor1" / INDEX
    index.write_text("".join(index.read_text().splitlines(keepends=True)[:5]))
    take = cloud_of(open_folder(copy))
    assert take.frames == {"sensor0": FRAMES, "sensor1": 4}
    assert np.isfinite(take.cloud.positions).all(-1).sum(1).min() >= 7
    shutil.rmtree(copy / "sensor1")
    about = json.loads((copy / "recording.json").read_text())
    about["sensors"] = about["sensors"][:1]
    (copy / "recording.json").write_text(json.dumps(about))
    alone = cloud_of(open_folder(copy))
    assert [(item.code, item.where.cameras) for item in alone.findings] == [("sensor_failed", ("sensor1",))]


@pytest.mark.parametrize("in_its_place", [None, os.mkfifo, Path.mkdir])
def test_a_sensor_without_its_frames_is_named(copy: Path, in_its_place: Callable[[Path], None] | None) -> None:
    for number, sensor in enumerate(CAMERAS.names):
        (copy / sensor / "frames.bin").unlink()
        if in_its_place is not None:
            in_its_place(copy / sensor / "frames.bin")
        if number == 0:
            take = cloud_of(open_folder(copy))
            assert take.frames == {"sensor1": FRAMES}
            assert [(item.code, item.where.cameras) for item in take.findings] == [("sensor_failed", ("sensor0",))]
    with pytest.raises(NoMarkers) as caught:
        cloud_of(open_folder(copy))
    assert "frames.bin is missing" in caught.value.hint


def test_a_clock_of_its_own_and_one_that_jumps_are_put_right(copy: Path) -> None:
    index = copy / "sensor1" / INDEX
    lines = index.read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    moved = [f"{n},{float(d) + 5e5 + (1e7 if int(n) > 5 else 0)},{h}" for n, d, h in rows]
    index.write_text("\n".join([lines[0], *moved]) + "\n")
    take = cloud_of(open_folder(copy))
    assert take.cloud.positions.shape == (FRAMES, 8, 3)
    [jump] = take.findings
    assert jump.code == "sensor_time_wrong" and jump.where.cameras == ("sensor1",)
    assert "jumped" in sentence(jump) and "(at " in sentence(jump)


def test_a_picture_that_is_damaged_ends_its_sensor_only(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "take", "png", 4)
    (folder / "sensor1" / "depth" / "000002.png").write_bytes(b"no picture")
    take = cloud_of(open_folder(folder))
    assert take.frames == {"sensor0": 4, "sensor1": 2}
    assert [item.code for item in take.findings] == ["sensor_failed"] and "000002.png" in sentence(take.findings[0])


def test_a_sensor_in_the_sun_leaves_the_others_and_is_named(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "take", "png", 4)

    def let_the_sun_onto(sensor: str, frame: int) -> None:
        path = folder / sensor / "infrared" / f"{frame:06d}.png"
        path.write_bytes(png_bytes(np.full_like(read_png(path), 65535)))

    for frame in (1, 2):
        let_the_sun_onto("sensor1", frame)
    take = cloud_of(open_folder(folder))
    assert take.frames == {"sensor0": 4, "sensor1": 4}
    assert (np.isfinite(take.cloud.positions).all(-1).sum(1) == 8).all(), "the other goes on, and it comes back"
    [sun] = take.findings
    assert sun.code == "sensor_sunlight" and sun.where.cameras == ("sensor1",) and sun.values["times"] == 2
    assert "bright" in sentence(sun) and "2 times" in sentence(sun)

    for sensor in CAMERAS.names:
        for frame in range(4):
            let_the_sun_onto(sensor, frame)
    with pytest.raises(NoMarkers) as caught:
        cloud_of(open_folder(folder))
    assert "bright" in caught.value.hint, "the hint is the sun, not the markers"


def test_nobody_and_nothing_are_named(tmp_path: Path) -> None:
    with pytest.raises(NoMarkers, match="No sensor detected a marker"):
        cloud_of(open_folder(recorded(tmp_path / "bare", frames=2, markers=False)))
    with pytest.raises(RecordingInvalid):
        open_folder(tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "manifold_mocap_sensors", "version": 9}', "\x00\x01"])
def test_what_is_no_recording_is_named(copy: Path, text: str) -> None:
    (copy / "recording.json").write_text(text)
    with pytest.raises(MocapError):
        open_folder(copy)


@pytest.mark.parametrize("name", ["../other", "", "a/b", ".hidden"])
def test_a_sensors_name_leads_nowhere_else(copy: Path, name: str) -> None:
    about = json.loads((copy / "recording.json").read_text())
    about["sensors"][0]["name"] = name
    (copy / "recording.json").write_text(json.dumps(about))
    with pytest.raises(RecordingInvalid):
        open_folder(copy)


def test_calibrations_that_do_not_fit_are_named(copy: Path) -> None:
    (copy / "calibration.toml").rename(copy / "other.toml")
    with pytest.raises(CalibrationMissing):
        open_folder(copy)
    assert len(open_folder(copy, copy / "other.toml").devices) == 2
    text = (copy / "other.toml").read_text().replace("sensor0", "left").replace("sensor1", "right")
    (copy / "calibration.toml").write_text(text)
    with pytest.raises(SensorUnknown, match="left, right"):
        open_folder(copy)


def test_a_recording_is_not_overwritten_unasked(recording: Path) -> None:
    with pytest.raises(OutputExists):
        Recording(recording, "raw", FPS, CAMERAS)


def test_a_full_disk_ends_the_recording_and_leaves_it_readable(tmp_path: Path) -> None:
    painter, folder = Painter(CAMERAS), tmp_path / "take"
    frame = painter.frame(0, POINTS, time=1.0)
    like = SensorFiles.of(frame)
    recording = Recording(folder, "raw", FPS, CAMERAS)
    recording.add(like)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("solver_backend.sensors.devices.recorded.SPARE_BYTES", 0)
        with full_disk(int(3.5 * like.frame_bytes)):
            recorder = SensorRecorder(folder, like, "raw", patient=True)
            for k in range(8):
                recorder(painter.frame(0, POINTS, k, time=k / FPS, number=k))
            recorder.close()
    assert recorder.ended and recorder.written == 3
    device = open_folder(folder).devices[0]
    assert len(list(device.frames())) == 3


def test_a_disk_that_is_nearly_full_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = Painter(CAMERAS).frame(0, POINTS)
    Recording(tmp_path, "raw", FPS, CAMERAS).add(SensorFiles.of(frame))
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
    recorder = SensorRecorder(tmp_path, SensorFiles.of(frame), "raw", patient=True)
    recorder(frame)
    recorder.close()
    assert recorder.ended == "the disk is full" and recorder.written == 0


@pytest.mark.slow
def test_a_shot_of_the_studio_is_a_folder_of_sensors(tmp_path: Path) -> None:
    spec = spec_of(
        {"camera_arrays": [{"preset": "azure_kinect_3", "scale": 0.5}], "frames": 2, "film": ["infrared", "depth"]}
    )
    shot = list_shots(spec)[0]
    make_shot(spec, shot, tmp_path / "shots")
    folder = open_folder(tmp_path)
    assert folder.path.name == shot.name and all(isinstance(d, StudioSensor) for d in folder.devices)
    take = cloud_of(folder)
    with np.load(folder.path / "clean.npz") as clean:
        true = clean["marker_positions"]
    off = np.linalg.norm(take.cloud.positions[:, :, None] - true[:, None], axis=-1).min(2)
    assert take.cloud.positions.shape[1] > 40 and 1e3 * np.nanmedian(off) < 3.0
    shutil.rmtree(folder.path / "infrared" / folder.devices[0].name)
    assert open_folder(tmp_path).missing == (folder.devices[0].name,)


def test_a_shot_without_measurements_states_no_rate(tmp_path: Path) -> None:
    write_capture(tmp_path / "clean.npz", Capture("m", cameras=CAMERAS))
    for part in ("infrared", "depth"):
        (tmp_path / part / CAMERAS.names[0]).mkdir(parents=True)
    with pytest.raises(RecordingInvalid, match="has no frame rate"):
        open_folder(tmp_path)


def test_pictures_of_sixteen_bits_are_read_as_written(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 65536, (31, 17)).astype(np.uint16)
    (tmp_path / "a.png").write_bytes(png_bytes(picture, noisy=True))
    assert (read_png(tmp_path / "a.png") == picture).all()


def test_replays_drop_what_nobody_took_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    monkeypatch.setattr("time.sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    taken = []
    for at, lap, device, due in due_frames(np.arange(6) / 10, 10.0, repeat=True):
        taken.append((at, lap, round(device, 6), round(due - 10.0, 6)))
        now[0] += 0.25 if len(taken) == 2 else 0.0
        if lap == 2:
            break
    assert [t[0] for t in taken] == [0, 1, 3, 4, 5, 0, 1, 2, 3, 4, 5, 0]
    assert all(device == due for _, _, device, due in taken)
    assert taken[-1][2] == 1.2


def test_empty_indices_have_no_frames(copy: Path) -> None:
    (copy / "sensor0" / INDEX).write_text("number,device_s,host_s\n")
    assert cloud_of(open_folder(copy)).frames == {"sensor1": FRAMES}
    (copy / "sensor0" / INDEX).write_text("number,device_s,host_s\n1,x,y\n")
    with pytest.raises(RecordingInvalid):
        open_folder(copy)
    os.remove(copy / "sensor0" / INDEX)
    with pytest.raises(RecordingInvalid):
        open_folder(copy)


@pytest.mark.parametrize("value", ["-9e18", "1e300"])
def test_a_number_that_is_no_time_is_named_with_its_line(tmp_path: Path, value: str) -> None:
    path = tmp_path / INDEX
    path.write_text(f"{HEADER}0,0.0,0.0\n1,0.02,{value}\n")
    with pytest.raises(RecordingInvalid, match="line 3 contains"):
        read_index(path)
