"""Solve, render and export on the command line."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.diagnostics import diagnostic
from blender_addon._exchange.errors import JobInvalid
from blender_addon._exchange.motion_file import write_motion
from blender_addon._exchange.progress import Progress, silent
from blender_addon.errors import SolverStopped
from blender_addon.headless import certificates
from blender_addon.headless.blender_command import Command, run
from blender_addon.headless.children import run_solver
from blender_addon.headless.main import main
from blender_addon.headless.result import CommandResult
from blender_addon.solving.child import SolverProcess
from blender_addon.solving.run import Run
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.full_disk import full_disk

ROOT = Path(__file__).resolve().parents[3]


def said(capfd: pytest.CaptureFixture[str]) -> dict[str, Any]:
    return json.loads(capfd.readouterr().out.splitlines()[-1])


def test_solve_is_the_solvers_own(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    capture, motion = tmp_path / "Aufnahme ü.npz", tmp_path / "motion.npz"
    write_capture(capture, demo_capture(24))
    job = tmp_path / "job.json"
    job.write_text(json.dumps({"version": 1, "capture": capture.name, "out": motion.name, "settings": {"window": 12}}))
    assert main(["solve", "--job", str(job), "--json"]) == 0
    result = said(capfd)
    assert result["event"] == "result" and result["outputs"] == [str(motion)] and result["frames"] == 24
    assert read_motion(motion).provenance["settings"]["window"] == 12
    assert main(["solve", "--job", str(job), "--json"]) == 3
    assert said(capfd)["code"] == "output_exists"


def test_the_solvers_errors_and_exit_codes_come_through(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    cases = [
        ([str(tmp_path / "gone.npz"), "--out", str(tmp_path / "m.npz")], 3, "file_missing"),
        (["--no-such-option"], 2, "command_line_invalid"),
        ([str(tmp_path), "--out", str(tmp_path / "m.npz"), "--python", str(tmp_path / "python")], 4, "backend_missing"),
    ]
    for given, code, name in cases:
        assert main(["solve", *given, "--json"]) == code
        assert said(capfd)["code"] == name


def test_a_wrong_setting_is_a_wrong_command_line() -> None:
    assert JobInvalid("Unknown setting colour.").exit_code == 2


@pytest.mark.skipif(os.name == "nt", reason="processes are killed differently there")
def test_a_killed_solver_is_an_error_with_a_hint(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    child = [sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"]
    killed = Run("solve", SolverProcess(child, dict(os.environ), tmp_path))
    monkeypatch.setattr("blender_addon.headless.children.start", lambda *_: killed)
    with pytest.raises(
        SolverStopped, match=r"stopped without a result.*signal 9.*Your scene and earlier takes"
    ) as caught:
        run_solver("solve", [], silent)
    assert (caught.value.code, caught.value.exit_code) == ("solver_died", 4)


def test_folders_that_cannot_be_written_are_named(
    files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures" / "take.npz").write_bytes(b"x")
    out = ["--out", str(tmp_path / "file" / "out"), "--json"]
    motion = [str(files.motion_path), "--body", str(files.body_path)]
    for command in (["bake", *motion, "--no-pictures"], ["render", *motion], ["export", *motion, "--format", "csv"],
                    ["batch", str(tmp_path / "captures")]):  # fmt: skip
        assert main([*command, *out]) == 3
        event = said(capfd)
        assert event["code"] == "output_not_writable" and "Choose a writable folder" in event["hint"]


def test_a_capture_that_moved_is_named(files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    job = tmp_path / "job.json"
    job.write_text(json.dumps({"version": 1, "capture": "moved.npz", "out": "motion.npz"}))
    assert main(["solve", "--job", str(job), "--json"]) == 3
    assert said(capfd)["where"] == str(tmp_path / "moved.npz")
    bake = ["bake", str(files.motion_path), "--body", str(files.body_path), "--out", str(tmp_path), "--json"]
    assert main([*bake, "--capture", str(tmp_path / "moved.npz")]) == 3
    assert said(capfd)["code"] == "file_missing"


@pytest.mark.slow
def test_a_handler_that_python_does_not_know_is_no_obstacle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blender installs its own for Ctrl-C, in C."""
    real = signal.signal
    monkeypatch.setattr(signal, "signal", lambda number, handler: real(number, handler) and None)
    assert main(["export", str(tmp_path / "gone.npz"), "--out", str(tmp_path), "--format", "csv"]) == 3


def test_a_signal_that_blender_swallows_ends_the_work_at_the_next_progress(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def swallowing(_: object, progress: Progress) -> CommandResult:
        with suppress(BaseException):
            signal.raise_signal(signal.SIGINT)
        progress("retargeting", 1, 2)
        return {"event": "result", "outputs": [], "notes": []}

    monkeypatch.setattr(certificates, "run_certificates", swallowing)
    assert main(["certificates", "--out", str(tmp_path), "--json"]) == 130
    assert said(capfd)["code"] == "cancelled"


def test_a_pipe_that_is_closed_already_still_cancels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blender handles no signal in Python, and a signal without a handler is lost."""
    handlers: list[object] = []
    monkeypatch.setattr(certificates, "run_certificates", lambda *_: {"event": "result", "outputs": [], "notes": []})
    monkeypatch.setattr(
        "blender_addon.headless.main.cancel_at_end_of", lambda *_: handlers.append(signal.getsignal(signal.SIGTERM))
    )
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: 0))
    assert main(["certificates", "--out", str(tmp_path), "--json", "--parent-pipe"]) == 0
    assert len(handlers) == 1 and callable(handlers[0])


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are sent differently there")
def test_terminating_the_command_ends_the_solver_too(tmp_path: Path) -> None:
    capture, motion = tmp_path / "capture.npz", tmp_path / "motion.npz"
    write_capture(capture, demo_capture(240))
    command = [sys.executable, "-m", "blender_addon", "solve", str(capture), "--out", str(motion), "--json"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["event"] == "progress"
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    pids = [int(pid) for pid in children.read_text().split()] if children.is_file() else []
    process.send_signal(signal.SIGTERM)
    last = process.stdout.read().splitlines()[-1]
    assert process.wait(timeout=30) == 130 and json.loads(last)["code"] == "cancelled"
    process.stdout.close()
    time.sleep(0.1)
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    assert [p.name for p in tmp_path.iterdir()] == ["capture.npz"]


def test_export_of_a_motion(files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "aus gabe ü"
    given = ["export", str(files.motion_path), "--body", str(files.body_path), "--out", str(out), "--json"]
    assert main([*given, "--format", "bvh", "csv", "amass"]) == 0
    result = said(capfd)
    assert (result["frames"], result["fps"]) == (60, 30.0)
    assert sorted(p.name for p in out.iterdir()) == ["walk.bvh", "walk.csv", "walk.npz"]
    joints = np.genfromtxt(out / "walk.csv", delimiter=",", skip_header=1)[:, 2:].reshape(60, 24, 3)
    np.testing.assert_allclose(joints, files.motion.joints, atol=1e-4)
    assert main([*given, "--format", "bvh"]) == 3
    assert said(capfd)["code"] == "output_exists"
    assert main([*given, "--format", "bvh", "--overwrite"]) == 0
    same = ["export", str(files.motion_path), "--body", str(files.body_path), "--out", str(files.folder), "--json"]
    capfd.readouterr()
    assert main([*same, "--format", "amass", "--overwrite"]) == 3, "a source is never overwritten"
    refused = said(capfd)
    assert (refused["code"], refused["hint"]) == ("output_exists", "Choose another folder.")


def test_whatever_is_exported_repeats_what_one_camera_left_open(
    files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    found = diagnostic("one_camera", size=21.0, share=4.0, source="the specified height")
    record = json.dumps({"diagnostics": [found.as_dict()]})
    motion = write_motion(tmp_path / "walk.npz", replace(files.motion, provenance=record))
    given = ["--body", str(files.body_path), "--out", str(tmp_path / "out")]
    assert main(["export", str(motion), *given, "--format", "bvh", "--json"]) == 0
    result = said(capfd)
    assert [item["code"] for item in result["diagnostics"]] == ["one_camera"]
    assert len(result["notes"]) == 1 and "± 21 cm along the viewing direction" in result["notes"][0]
    assert main(["bake", str(motion), *given, "--no-pictures"]) == 0
    capfd.readouterr()
    assert main(["export", str(tmp_path / "out" / "walk.blend"), *given[2:], "--format", "csv"]) == 0
    assert "note: With one camera, depth is estimated" in capfd.readouterr().err


def test_export_of_a_blender_file_leaves_it_alone(
    files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    body = ["--body", str(files.body_path), "--out", str(tmp_path)]
    assert main(["bake", str(files.motion_path), *body, "--no-pictures"]) == 0
    blend = tmp_path / "walk.blend"
    before = blend.read_bytes()
    assert main(["export", str(blend), "--out", str(tmp_path), "--format", "trc", "fbx", "--json"]) == 0
    assert blend.read_bytes() == before and (tmp_path / "walk.trc").is_file() and (tmp_path / "walk.fbx").is_file()
    capfd.readouterr()
    assert main(["export", str(blend), "--out", str(tmp_path), "--format", "csv", "--armature", "x", "--json"]) == 3
    event = said(capfd)
    assert event["code"] == "nothing_to_export" and "--armature: walk" in event["hint"]
    (tmp_path / "no.blend").write_bytes(b"nothing")
    assert main(["export", str(tmp_path / "no.blend"), "--out", str(tmp_path), "--format", "csv", "--json"]) == 3
    assert said(capfd)["code"] == "file_damaged"


@pytest.mark.slow
def test_a_shots_frame_rate_is_kept_and_the_export_lasts_as_long(
    files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """60 frames at 30 a second, in a scene of 24: two seconds, in the file and out of it."""
    command = ["bake", str(files.motion_path), "--body", str(files.body_path), "--out", str(tmp_path), "--no-pictures"]
    assert main([*command, "--fps", "24"]) == 0
    blend = tmp_path / "walk.blend"
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    assert bpy.context.scene.render.fps == 24 and bpy.context.scene.frame_end == 49
    export = ["export", str(blend), "--out", str(tmp_path), "--format", "csv", "--overwrite", "--json"]
    capfd.readouterr()
    assert main(export) == 0
    result = said(capfd)
    assert (result["frames"], result["fps"]) == (60, 30.0)
    assert main([*export, "--fps", "15"]) == 0
    result = said(capfd)
    assert (result["frames"], result["fps"]) == (30, 15.0)


@pytest.mark.slow
def test_a_full_disk_leaves_no_half_blender_file(files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    command = ["bake", str(files.motion_path), "--body", str(files.body_path), "--out", str(tmp_path), "--no-pictures"]
    assert main(command) == 0
    before = (tmp_path / "walk.blend").read_bytes()
    with full_disk(20_000):
        assert main([*command, "--overwrite", "--json"]) == 3
    event = said(capfd)
    assert event["code"] == "output_not_writable" and "free space" in event["hint"]
    assert re.search(r"cannot save the file: (File too large|.*disk may be full)\.$", event["message"])
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("walk.blend", before)]


@pytest.mark.slow
def test_render_writes_pictures_alone(files: Any, tmp_path: Path) -> None:
    arrays = dict(np.load(files.motion_path))
    cut = {key: value[:4] if value.shape[:1] == (60,) else value for key, value in arrays.items()}
    np.savez(tmp_path / "short.npz", **cut)
    command = ["render", str(tmp_path / "short.npz"), "--body", str(files.body_path), "--out", str(tmp_path / "out")]
    assert main(command) == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["short.mp4", "short_contact.png"]


@pytest.mark.slow
def test_bake_with_few_keys_says_how_far_it_is_off(
    files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    command = ["bake", str(files.motion_path), "--body", str(files.body_path), "--out", str(tmp_path), "--no-pictures"]
    assert main([*command, "--keys-per-second", "2", "--asset", "--json"]) == 0
    result = said(capfd)
    assert any("keys remain. Joints are up to" in note for note in result["notes"])
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "walk.blend"))
    [action] = bpy.data.actions
    assert action.asset_data is not None and action["keys_deviation_mm"] > 0
    assert main([*command, "--keys-per-second", "2", "--json"]) == 3
    assert said(capfd)["code"] == "output_exists"
    assert main([*command, "--keys-per-second", "-1"]) == 2


def test_blenders_command_is_the_same_and_can_be_taken_back(capfd: pytest.CaptureFixture[str]) -> None:
    command = Command()
    for _ in range(2):
        command.register()
        command.unregister()
    assert run(["--help"]) == 0
    assert "usage: blender --command manifold_mocap" in capfd.readouterr().out
    assert run(["bake"]) == 2
