"""Linters and tests run side by side; every one of them runs, and the last line names what failed."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from supply import checks


@pytest.fixture
def ran(monkeypatch) -> list[list[str]]:
    """Record every command instead of running it."""
    commands: list[list[str]] = []
    monkeypatch.setattr(checks, "LINTERS_PYTHON", sys.version_info[:2])
    monkeypatch.setattr(checks, "call", lambda command, out: commands.append(command) or 0)
    return commands


def tools(commands: list[list[str]]) -> list[str]:
    return sorted(Path(command[0]).name if len(command) == 1 else command[2] for command in commands)


def test_every_check_and_every_test_runs_though_some_fail(ran, monkeypatch, capsys):
    def fail(command, out):
        ran.append(command)
        print(f"from {command[-1]}", file=out)
        return int("pytest" in command or command[2:4] == ["ruff", "check"])

    monkeypatch.setattr(checks, "call", fail)
    assert checks.main(["test", "-k", "name"]) == 1
    assert tools(ran) == ["lint-imports", "pyrefly", "pytest", "ruff", "ruff"]
    (tests,) = (command for command in ran if "pytest" in command)
    assert tests[-2:] == ["-k", "name"]
    shown = capsys.readouterr()
    assert shown.err.splitlines()[-1].startswith("✗ Failed: ruff check .; pytest -q -n 2")
    assert shown.out.index("── pytest") < shown.out.index("from name") < shown.out.index("── ruff check")
    assert shown.out.index("── ruff check") < shown.out.index("── pyrefly") < shown.out.index("from min-text")


def test_the_linters_do_not_wait_for_the_tests(ran, monkeypatch):
    linted = threading.Event()

    def wait(command, out):
        ran.append(command)
        if "pyrefly" in command:
            linted.set()
        return 0 if "pytest" not in command or linted.wait(timeout=20) else 1

    monkeypatch.setattr(checks, "call", wait)
    assert checks.main(["test"]) == 0


def test_lint_runs_no_test_and_fixes_if_asked(ran):
    assert checks.main(["lint", "--fix"]) == 0
    assert tools(ran) == ["lint-imports", "pyrefly", "ruff", "ruff"]
    assert "--fix" in ran[0] and not any("--check" in command for command in ran)
    ran.clear()
    assert checks.main(["lint"]) == 0
    assert "--fix" not in ran[0] and "--check" in ran[1]


def test_another_python_runs_the_tests_alone(ran, monkeypatch):
    monkeypatch.setattr(checks, "LINTERS_PYTHON", (3, 99))
    assert checks.main(["test", "tests/io"]) == 0
    assert tools(ran) == ["pytest"] and ran[0][-1] == "tests/io"


def test_modules_are_compiled_once_and_beside_no_source(monkeypatch, tmp_path):
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setattr(checks, "COMPILED", tmp_path / "compiled")
    monkeypatch.setattr(checks, "ROOT", tmp_path)
    monkeypatch.delenv("PYTHONPYCACHEPREFIX", raising=False)
    (tmp_path / "some_module.py").write_text("x = 1\n")
    assert checks.call([sys.executable, "-c", "import some_module"], None) == 0
    assert len(list((tmp_path / "compiled").rglob("some_module*.pyc"))) == 1
    assert not (tmp_path / "__pycache__").exists()


@pytest.mark.skipif(os.name == "nt", reason="workers collect at once there")
def test_in_a_new_environment_one_worker_collects_after_the_other(monkeypatch, tmp_path):
    monkeypatch.setattr(checks, "COMPILED", tmp_path / "compiled")
    for name in ("PYTHONPYCACHEPREFIX", "MOCAP_COLLECT_IN_TURN"):
        monkeypatch.delenv(name, raising=False)
    code = (
        "import os, time; from tests.support.collecting import in_turn\n"
        "with in_turn(): print(os.getpid(), flush=True); time.sleep(0.3); print(os.getpid(), flush=True)"
    )
    for before in (False, True):
        monkeypatch.setattr(checks, "COMPILED_BEFORE", before)
        command, env = [sys.executable, "-c", code], checks.compile_once()
        with (tmp_path / "shown").open("w+") as shown:
            workers = [subprocess.Popen(command, cwd=checks.ROOT, env=env, stdout=shown) for _ in range(2)]
            assert [worker.wait(timeout=60) for worker in workers] == [0, 0]
        first, second, third, fourth = (tmp_path / "shown").read_text().split()
        assert before or (first == second and third == fourth)
        assert env.get("MOCAP_COLLECT_IN_TURN") == (None if before else "1")


def test_what_a_linter_prints_goes_to_the_file_that_is_given(tmp_path):
    with (tmp_path / "shown").open("w+", encoding="utf-8") as shown:
        code = "import sys; print('one'); print('two', file=sys.stderr); sys.exit(3)"
        assert checks.run_steps([[sys.executable, "-c", code]], shown) == [f"-c {code}"]
    assert {"one", "two"} < set((tmp_path / "shown").read_text(encoding="utf-8").splitlines())


@pytest.mark.skipif(os.name == "nt", reason="sends the signal of Ctrl-C")
def test_whoever_cancels_the_tests_does_not_wait_for_the_linters(tmp_path):
    code = (
        "import os, signal, time; from supply import checks\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it\n"
        "def call(command, out):\n"
        "    if 'pytest' in command: os.kill(os.getpid(), signal.SIGINT)\n"
        "    time.sleep(60)\n"
        "checks.LINTERS_PYTHON = __import__('sys').version_info[:2]; checks.call = call\n"
        "raise SystemExit(checks.main(['test']))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=checks.ROOT, timeout=30).returncode == 130
