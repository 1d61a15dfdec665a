"""``python -m supply.checks test`` runs all checks and tests, ``lint`` only the checks. ``dev.py`` calls it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO

from supply.exchange_stubs import write_stubs

ROOT = Path(__file__).resolve().parents[1]
VENV = Path(sys.prefix)
COMPILED = VENV / "compiled"
COMPILED_BEFORE = COMPILED.exists()
"""True if tests ran here before. Otherwise, one worker first imports and compiles all modules for the other one."""
LINTERS_PYTHON = (3, 11)  # Python of the linters' environment. Other versions only run the tests.
WORKERS = 2  # Processes that run tests, one per core of the reference machine.


def main(argv: list[str]) -> int:
    """Run the verb ``test`` or ``lint``, print the failed steps, and return the exit code."""
    verb, *rest = argv
    pytest = [sys.executable, "-m", "pytest", "-q", "-n", str(WORKERS), "--dist", "worksteal", *rest]
    linters = lint_steps(fix="--fix" in rest) if sys.version_info[:2] == LINTERS_PYTHON else []
    try:
        failed = run_beside(linters, [pytest]) if verb == "test" else run_steps(linters)
    except KeyboardInterrupt:
        return 130
    if failed:
        sys.stderr.write(f"\n✗ Failed: {'; '.join(failed)}\n")
    return int(bool(failed))


def lint_steps(fix: bool) -> list[list[str]]:
    """Write stubs for the type checker, and return the linter commands, the slowest last."""
    write_stubs()
    python = [sys.executable, "-m"]
    check = [*python, "ruff", "check", *(["--fix"] if fix else []), "."]
    layout = [*python, "ruff", "format", *([] if fix else ["--check"]), "--quiet", "."]
    contracts = str(Path(sys.executable).with_name("lint-imports"))
    return [check, layout, [contracts], [*python, "pyrefly", "check", "--output-format", "min-text"]]


def run_beside(linters: list[list[str]], tests: list[list[str]]) -> list[str]:
    """Run linters and tests at the same time. Print the linters' output last, and return the failed steps."""
    failed: list[str] = []
    with tempfile.TemporaryFile("w+", encoding="utf-8") as shown:
        # A daemon, so that cancelled tests do not wait for the linters.
        beside = threading.Thread(target=lambda: failed.extend(run_steps(linters, shown)), daemon=True)
        beside.start()
        failed_tests = run_steps(tests)
        beside.join()
        shown.seek(0)
        sys.stdout.write(shown.read())
        sys.stdout.flush()
    return failed + failed_tests


def run_steps(steps: list[list[str]], out: IO[str] | None = None) -> list[str]:
    """Run commands one by one, print their output to ``out`` if given, and return the failed steps."""
    failed = []
    for step in steps:
        name = " ".join(part for part in step[1:] if part not in ("-m", "--quiet")) or "lint-imports"
        print(f"── {name}", file=out, flush=True)
        if call(step, out) != 0:
            failed.append(name)
    return failed


def call(command: list[str], out: IO[str] | None) -> int:
    """Run a command in the repository's root and return its exit code."""
    stderr = subprocess.STDOUT if out else None
    return subprocess.run(command, cwd=ROOT, env=compile_once(), stdout=out, stderr=stderr).returncode


def compile_once() -> dict[str, str]:
    """Return environment variables that make Python store compiled modules in the virtual environment.

    Compiling takes more than half of the test collection time, and the tests start many programs that import the
    modules again.
    """
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    in_turn = {} if COMPILED_BEFORE else {"MOCAP_COLLECT_IN_TURN": "1"}
    return {"PYTHONPYCACHEPREFIX": str(COMPILED), **in_turn, **env}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
