"""Ctrl-C in every verb: it ends by name within two seconds of CPU time, with nothing left running or half-written."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.exchange.verbs import VERBS
from tests.kills.interrupts import SOLVER, interrupt_verb
from tests.support.interrupted import interrupt
from tests.support.verb_inputs import COMMANDS, write_inputs

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="CPU time is read from /proc"),
]

LIMIT_S = 2.0
LOADING_S, BEGUN_S = 0.1, 1.2
"""CPU seconds after which the program loads its libraries, and after which a verb is at work."""
STUBBORN = """
import signal, subprocess, sys, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
end = time.process_time() + 0.8
while time.process_time() < end: pass
subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
sys.exit(7)
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(folder)
    return folder


@pytest.mark.parametrize("verb", VERBS)
def test_ctrl_c_ends_a_verb(verb: str, inputs: Path, tmp_path: Path) -> None:
    if verb == "train model" and not (inputs / "data").exists():
        pytest.skip("the motions that it trains on are kept beside the repository")
    assert interrupt_verb((SOLVER, *COMMANDS[verb]), inputs, tmp_path / "work", BEGUN_S, LIMIT_S).wrong == []


@pytest.mark.parametrize("program", ["solver_backend", "blender_addon"])
def test_ctrl_c_while_libraries_are_loaded_has_a_name(program: str, tmp_path: Path) -> None:
    root = str(Path(__file__).parents[2])
    found = interrupt(("-m", program, "solve", "none"), tmp_path, LOADING_S, {"PYTHONPATH": root})
    assert found.before_end and found.code == 130 and "The work was cancelled." in found.errors


def test_what_does_not_end_is_seen(tmp_path: Path) -> None:
    found = interrupt(("-c", STUBBORN), tmp_path, 0.1)
    assert found.code == 7 and found.cpu_s > 0.4 and found.left_running
