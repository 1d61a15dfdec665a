"""The solver's process: events and log without waiting, an orderly end, and no orphan."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from blender_addon._exchange.errors import BackendMissing, sentence
from blender_addon.solving.child import SolverProcess, of_base_python
from blender_addon.solving.run import Run

TALKATIVE = """
import json, sys
print("a word on the side", file=sys.stderr, flush=True)
for i in range(5000):
    print(json.dumps({"event": "progress", "stage": "Working", "done": i, "total": 5000, "eta_s": 80.0}), flush=True)
print("no json {", flush=True)
print(json.dumps({"event": "result", "answer": 42}), flush=True)
"""
OBEDIENT = """
import sys
print('{"event": "progress", "stage": "Waiting", "done": 0, "total": 0}', flush=True)
sys.stdin.read()
print('{"event": "error", "code": "cancelled", "message": "ended", "where": "", "hint": ""}', flush=True)
sys.exit(130)
"""
DEAF = """
import time
print('{"event": "progress", "stage": "x", "done": 0, "total": 1}', flush=True)
time.sleep(60)
"""


def run_of(code: str, folder: Path) -> Run:
    return Run("evaluate", SolverProcess([sys.executable, "-c", code], os.environ, folder))


def until(run: Run, condition: Callable[[Run], bool], seconds: float = 20.0) -> float:
    """Poll until the condition holds and return the longest poll in seconds."""
    end, longest = time.monotonic() + seconds, 0.0
    while not condition(run):
        assert time.monotonic() < end, (run.stage, list(run.log)[-3:], run.error)
        start = time.perf_counter()
        run.poll()
        longest = max(longest, time.perf_counter() - start)
        time.sleep(0.002)
    return longest


def test_events_and_log_arrive_in_order_and_nothing_is_lost(tmp_path):
    run = run_of(TALKATIVE, tmp_path)
    until(run, lambda r: r.finished)
    assert run.result == {"event": "result", "answer": 42} and run.error is None
    assert (run.stage, run.done, run.total, run.share) == ("Working", 4999, 5000, 4999 / 5000)
    assert run.headline == "Working, about 80 seconds left"
    assert "a word on the side" in run.log and "no json {" in run.log


def test_one_poll_takes_a_bounded_number_of_events(tmp_path):
    process = SolverProcess([sys.executable, "-c", TALKATIVE], os.environ, tmp_path)
    assert process.wait() == 0
    counts = []
    while items := process.received(200):
        counts.append(len(items))
    assert sum(counts) == 5003 and max(counts) == 200


def test_cancelling_closes_standard_input_and_the_process_ends_itself(tmp_path):
    run = run_of(OBEDIENT, tmp_path)
    until(run, lambda r: r.stage == "Waiting")
    run.cancel()
    assert run.headline == "Cancelling"
    until(run, lambda r: r.finished)
    assert run.process.exit_code == 130 and run.error is not None and run.error["message"] == "ended"


def test_a_process_that_does_not_end_itself_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr("blender_addon.solving.child._GRACE_S", 0.2)
    run = run_of(DEAF, tmp_path)
    until(run, lambda r: r.stage == "x")
    run.cancel()
    until(run, lambda r: r.finished, seconds=10)
    assert run.error is not None and run.error["code"] == "cancelled"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no signals")
def test_a_process_killed_from_outside_is_reported(tmp_path):
    run = run_of(DEAF, tmp_path)
    until(run, lambda r: r.stage == "x")
    os.kill(run.process.pid, 9)
    until(run, lambda r: r.finished)
    assert run.error is not None and run.error["code"] == "solver_died"
    assert "signal 9" in sentence(run.error) and "untouched" in sentence(run.error)


def test_a_program_that_is_not_there_is_named(tmp_path):
    with pytest.raises(BackendMissing, match=r"cannot be started.*no such thing"):
        SolverProcess([str(tmp_path / "no such thing")], os.environ, tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="kills by signal")
def test_a_child_ends_when_the_program_that_started_it_is_killed(tmp_path):
    code = """
import os, sys, time
from pathlib import Path
from blender_addon.solving.child import SolverProcess
child = SolverProcess([sys.executable, "-c", "import sys; sys.stdin.read()"], os.environ, Path.cwd())
print(child.pid, flush=True)
time.sleep(60)
"""
    parent = subprocess.Popen(
        [sys.executable, "-c", code], cwd=Path(__file__).parents[3], stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    os.kill(child, 0)
    parent.kill()
    parent.communicate()
    end = time.monotonic() + 10
    while _alive(child):
        assert time.monotonic() < end
        time.sleep(0.02)


def test_on_windows_no_launcher_stands_between(monkeypatch: pytest.MonkeyPatch) -> None:
    """A launcher that starts Python as its child would be measured and killed in its place."""
    launcher = "C:/env/Scripts/python.exe"
    given = [launcher, "-m", "x"], {"A": "b"}
    monkeypatch.setattr(sys, "executable", launcher)
    monkeypatch.setattr(sys, "_base_executable", "C:/Python313/python.exe")
    assert of_base_python(*given) == given
    monkeypatch.setattr(sys, "platform", "win32")
    expected = ["C:/Python313/python.exe", "-m", "x"], {"A": "b", "__PYVENV_LAUNCHER__": launcher}
    assert of_base_python(*given) == expected
    assert of_base_python(["C:/other/python.exe"], {}) == (["C:/other/python.exe"], {})
    monkeypatch.setattr(sys, "_base_executable", launcher)
    assert of_base_python(*given) == given


def _alive(pid: int) -> bool:
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"
