"""A take whose solver takes too long or too much memory fails by name, and the others are done."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from blender_addon._exchange.progress import silent
from blender_addon.errors import BatchInvalid
from blender_addon.headless.batch import request
from blender_addon.headless.batch.request import BatchRequest, TakeLimits
from blender_addon.headless.batch.run_batch import run_batch
from blender_addon.solving import child_memory, run

STAND_IN = """
import json, pathlib, sys, time
verb, given = sys.argv[1], sys.argv[2:]
if verb == "convert":
    pathlib.Path(given[2]).write_bytes(pathlib.Path(given[0]).read_bytes())
else:
    job = pathlib.Path(given[1])
    if job.name.startswith("slow"):
        while True:  # deaf: it does not end when its standard input does
            time.sleep(1)
    if job.name.startswith("large"):
        held = [bytearray(b"x" * 2**20) for _ in range(400)]
        time.sleep(600)
    for key in ("out", "report"):
        (job.parent / json.loads(job.read_text())[key]).write_bytes(b"x")
read = {"capture": "c", "name": "c", "fps": 30, "cameras": [], "notes": [], "people": [], "person": ""}
solved = {"motion": "m", "unsure_frames": 0, "unseen_frames": 0}
print(json.dumps({"event": "result", "problems": [], "diagnostics": [], "frames": 3, **read, **solved}))
"""
"""A process in the solver's place: one that never ends, one that grows to 400 MB, and sound ones."""


@pytest.fixture
def captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    program = tmp_path / "stand_in.py"
    program.write_text(STAND_IN)
    monkeypatch.setattr(run, "backend_command", lambda python: [sys.executable, str(program)])
    folder = tmp_path / "captures"
    folder.mkdir()
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bad", "given", "code"),
    [
        ("slow", TakeLimits(seconds=8.0), "take_too_slow"),
        pytest.param(
            "large", TakeLimits(memory_mb=200.0), "take_too_large",
            marks=pytest.mark.skipif(not Path("/proc").is_dir(), reason="memory of processes is asked for in /proc"),
        ),
    ],
)  # fmt: skip
def test_a_take_beyond_its_limit_is_ended_and_the_others_are_done(
    captures: Path, tmp_path: Path, bad: str, given: TakeLimits, code: str
) -> None:
    for name in ("before", bad, "zuletzt"):
        (captures / f"{name}.npz").write_bytes(b"capture")
    start = time.monotonic()
    result = run_batch(BatchRequest(captures, tmp_path / "out", limits=given), silent)
    assert time.monotonic() - start < 300
    assert [(take["take"], take["status"]) for take in result["takes"]] == [
        (bad, "failed"), ("before", "done"), ("zuletzt", "done"),
    ]  # fmt: skip
    assert result["takes"][0]["error"]["code"] == code
    assert result["exit_code"] == 4
    again = run_batch(BatchRequest(captures, tmp_path / "out", limits=given), silent)
    assert sorted(take["status"] for take in again["takes"]) == ["failed", "skipped", "skipped"]


def test_a_limit_that_cannot_be_held_is_named(captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (captures / "a.npz").write_bytes(b"capture")
    monkeypatch.setattr(request, "resident_mb", lambda pid: None)
    with pytest.raises(BatchInvalid, match="does not report a process's memory"):
        run_batch(BatchRequest(captures, tmp_path / "out", limits=TakeLimits(memory_mb=100.0)), silent)
    assert not (tmp_path / "out").exists()


def test_a_memory_limit_is_refused_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request.sys, "platform", "win32")
    monkeypatch.setattr(request, "resident_mb", lambda pid: 1.0)
    with pytest.raises(BatchInvalid, match="does not report a process's memory"):
        TakeLimits(memory_mb=100.0).require_possible()


def test_windows_reports_resident_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    class Kernel:
        OpenProcess = Mock(return_value=1)
        CloseHandle = Mock()

        @staticmethod
        def K32GetProcessMemoryInfo(handle: Any, counters: Any, size: int) -> int:
            counters._obj.working_set, counters._obj.committed = 3 * 2**20, 9 * 2**20
            return 1

    monkeypatch.setattr(child_memory.ctypes, "WinDLL", lambda name: Kernel, raising=False)
    assert child_memory._windows_mb(7) == 3.0
