"""A solver that is told to stop: one error event, exit code 130, nothing on disk."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from solver_backend.cli.main import main
from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import Cancelled

ROOT = Path(__file__).resolve().parents[2]


def start(tmp_path: Path, *options: str) -> subprocess.Popen[str]:
    """Start a solve of a minute and wait until it is under way."""
    module = [sys.executable, "-m", "tests.support.cli_stand_ins"]
    command = [*module, "solve", "take", "--out", str(tmp_path / "m.npz"), "--json"]
    pipe = subprocess.PIPE
    process = subprocess.Popen([*command, *options], cwd=ROOT, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line)["stage"] == "Solving":
            return process
    raise AssertionError(process.stderr.read() if process.stderr else "")


@pytest.mark.skipif(os.name == "nt", reason="Windows ends a process without telling it")
@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_signal_cancels(tmp_path, number):
    process = start(tmp_path)
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert process.returncode == 130, err
    (event,) = [json.loads(line) for line in out.splitlines()]
    assert (event["event"], event["code"]) == ("error", "cancelled")
    assert not list(tmp_path.iterdir())


def test_a_reader_that_goes_away_ends_the_solver(tmp_path):
    process = start(tmp_path)
    assert process.stdout is not None
    process.stdout.close()
    process.send_signal(signal.SIGTERM)
    process.stdout = None
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_a_parent_that_goes_away_ends_the_solver(tmp_path):
    process = start(tmp_path, "--parent-pipe")
    out, err = process.communicate(timeout=20)  # closes the pipe to its standard input
    assert process.returncode == 130, err
    (event,) = [json.loads(line) for line in out.splitlines()]
    assert (event["event"], event["code"]) == ("error", "cancelled")
    assert "Traceback" not in err and not list(tmp_path.iterdir())


def test_without_the_option_standard_input_is_ignored(tmp_path):
    process = start(tmp_path)
    assert process.stdin is not None
    process.stdin.close()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.5)
    process.send_signal(signal.SIGTERM)
    process.stdin = None
    process.communicate(timeout=20)


@pytest.mark.skipif(os.name == "nt", reason="Windows ends a process without telling it")
def test_an_error_that_a_library_makes_of_a_signal_is_the_signals(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A thread that is just started makes a KeyError of whatever comes then."""

    def starting(*_: object) -> Outcome:
        try:
            signal.raise_signal(signal.SIGINT)
        except Cancelled:
            raise KeyError("thread") from None
        raise AssertionError("the signal did not come")

    monkeypatch.setattr("solver_backend.cli.main.function_of", lambda name: starting)
    assert main(["motion bodies"]) == 130
    assert capsys.readouterr().err.startswith("error: The work was cancelled.")
