"""The Sensor Array panel: real children replay sensors, report the coverage of a wand, calibrate and record."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_addon.solving.live import LivePose
from blender_addon.ui.operators.base import current
from blender_addon.ui.operators.live import live
from solver_backend.camera_calibration.formats import write_calibration
from solver_backend.sensors.devices.recorded import open_folder
from tests.support.narrow_layout import draw_panel
from tests.support.recorded_markers import recorded
from tests.support.waved_wand import Waving, as_tables, sensors, waved

_LONGEST_S = 300.0
PANEL = "VIEW3D_PT_mocap_sensor_array"


def until(done: Callable[[], bool]) -> None:
    """Tick as Blender's timer would, until something is so."""
    end = time.monotonic() + _LONGEST_S
    while not done():
        assert time.monotonic() < end, (live.failure, live.run and list(live.run.log))
        live.tick()
        time.sleep(0.02)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of two sensors before eight markers."""
    return recorded(tmp_path_factory.mktemp("rig ü") / "sensors")


@pytest.fixture
def rig(mocap, recording):
    """Return the settings of a scene whose rig is a recording."""
    mocap.sensors.kind, mocap.sensors.source = "FOLDER", str(recording)
    yield mocap.sensors
    live.abandon()


@pytest.mark.slow
def test_a_recording_is_shown_recorded_and_imported(rig, mocap):
    assert bpy.ops.mocap.start_sensors(part="TAKE") == {"FINISHED"}
    run = live.run
    assert run is not None
    with pytest.raises(RuntimeError, match="Stop it first"):
        bpy.ops.mocap.start_sensors(part="WAND")
    assert not draw_panel(getattr(bpy.types, PANEL), 200).cut
    until(lambda: not live.busy)
    assert live.failure == "" and live.recorded == "" and run.shown > 0
    taken = Path(bpy.path.abspath(rig.take))
    assert taken.name == "take_01" and all(device.count() > 0 for device in open_folder(taken).devices)
    assert bpy.ops.mocap.import_capture(filepath=rig.take) == {"FINISHED"}
    assert mocap.capture.file and Path(bpy.path.abspath(mocap.capture.source)) == taken


def test_a_missing_pose_has_a_reason(rig, monkeypatch):
    pose = LivePose(None, None, np.zeros((2, 3)), "no_person", "only 2 points look like a person's markers", math.nan)
    run = SimpleNamespace(latest=pose, message="", process=SimpleNamespace(cancelling=False))
    monkeypatch.setattr(live, "run", run)
    monkeypatch.setattr(live, "of_sensors", True)
    assert "Only 2 points look like a person's markers" in draw_panel(getattr(bpy.types, PANEL), 600).drawn
    monkeypatch.undo()


@pytest.mark.slow
def test_a_wand_says_where_to_wave_next_and_stopping_keeps_it(rig):
    assert bpy.ops.mocap.start_sensors(part="WAND") == {"FINISHED"}
    run, figure = live.run, live.figure
    assert run is not None and figure is not None
    assert bpy.data.objects[figure.armature].hide_viewport
    until(lambda: run.shown > 0 or not live.busy)
    assert run.latest is not None and run.latest.state == "waving"
    assert set(run.latest.coverage) == {"sensor0", "sensor1"} and run.latest.rotvec is None
    assert "More than one light" in run.latest.why or "Wave" in run.latest.why
    if live.busy:
        drawn = draw_panel(getattr(bpy.types, PANEL), 200)
        assert not drawn.cut and any("sensor0" in text for text in drawn.drawn)
        assert bpy.ops.mocap.live_stop() == {"FINISHED"}
    until(lambda: not live.busy)
    assert live.failure == "" and Path(bpy.path.abspath(rig.wand)).name == "wand_01"


def test_a_wand_that_is_none_is_a_sentence_and_changes_nothing(rig, recording):
    rig.wand = str(recording)  # eight markers: no wand
    with pytest.raises(RuntimeError, match="another light was visible"):
        bpy.ops.mocap.calibrate_sensors()
    assert rig.calibration == "" and not current.busy
    assert not draw_panel(getattr(bpy.types, PANEL), 200).cut


@pytest.mark.slow
def test_a_waved_wand_calibrates(rig, tmp_path):
    cameras = sensors(2)
    views = waved(cameras, Waving(seconds=20.0))
    (tmp_path / "wand").mkdir()
    for name, table in as_tables(views).items():
        (tmp_path / "wand" / name).write_text(table)
    for c, name in enumerate(cameras.names):
        write_calibration(tmp_path / "wand" / f"{name}.toml", cameras.subset([c]))
    rig.wand = str(tmp_path / "wand")
    assert bpy.ops.mocap.calibrate_sensors() == {"FINISHED"}
    assert rig.findings.startswith("The marker was visible"), rig.findings
    first = Path(bpy.path.abspath(rig.calibration))
    assert first.name == "sensor_array_01.toml" and first.is_file()
    assert bpy.ops.mocap.calibrate_sensors() == {"FINISHED"}
    assert Path(bpy.path.abspath(rig.calibration)).name == "sensor_array_02.toml" and first.is_file()
    assert not draw_panel(getattr(bpy.types, PANEL), 200).cut


def test_what_is_not_there_is_named(rig, mocap, tmp_path):
    rig.source = str(tmp_path / "nowhere")
    with pytest.raises(RuntimeError, match="does not exist"):
        bpy.ops.mocap.start_sensors(part="TAKE")
    assert not live.busy and not bpy.data.collections
    rig.source = str(tmp_path)
    assert bpy.ops.mocap.start_sensors(part="TAKE") == {"FINISHED"}
    until(lambda: not live.busy)
    assert "not a sensor recording" in live.failure and rig.take == ""
    drawn = draw_panel(getattr(bpy.types, PANEL), 200)
    assert not drawn.cut and "not a sensor recording" in " ".join(drawn.drawn)
    beside = draw_panel(bpy.types.VIEW3D_PT_mocap_live, 200)  # another panel's failure is not its own
    assert "sensor recording" not in " ".join(beside.drawn)


def test_cameras_without_a_name_or_a_kind_are_refused(rig):
    rig.kind, rig.oaks = "OAK", ""
    with pytest.raises(RuntimeError, match="find cameras"):
        bpy.ops.mocap.start_sensors(part="TAKE")
    rig.oaks = "webcam:0=front"
    assert bpy.ops.mocap.start_sensors(part="TAKE") == {"FINISHED"}
    until(lambda: not live.busy)
    assert "no kind of sensor 'webcam'" in live.failure


@pytest.mark.parametrize("kind", ["FOLDER", "OAK"])
def test_nothing_is_cut_off_in_a_narrow_sidebar(rig, kind):
    rig.kind, rig.gamma = kind, "//gamma_01"
    rig.findings = (
        "left has an error of 1.4 px relative to the wand. "
        "Calibrate this camera again with the zoom and video mode of the takes."
    )
    assert not draw_panel(getattr(bpy.types, PANEL), 200).cut
