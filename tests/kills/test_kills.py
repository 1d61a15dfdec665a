"""A few of the kills that ``python -m tests.kills`` does by the hundred, and that its look sees what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.kills.operations import OPERATIONS, Operation
from tests.kills.run import kill_once, measure, solved_folder

WRITES_TWO = """
import pathlib, sys, time
from solver_backend.exchange.outputs import write_text
for name in ("a.json", "b.json"):
    time.sleep(0.5)
    write_text(pathlib.Path(name), "[1]", overwrite=True)
"""
WRITES_BADLY = """
import pathlib, time
pathlib.Path("a.json").write_text("[1")
pathlib.Path("mine.txt").write_text("")
pathlib.Path(f"b{time.time_ns()}.json").write_text("[1]")
time.sleep(2)
pathlib.Path("a.json").write_text("[1]")
"""


def stand_in(program: str, *outputs: str) -> Operation:
    def prepare(folder: Path, solved: Path) -> None:
        (folder / "mine.txt").write_text("the user's")

    return Operation("stand-in", prepare, ("-c", program), frozenset(outputs))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8, 1.5])
def test_whole_files_are_kept_and_the_others_made_again(tmp_path: Path, share: float) -> None:
    measured = measure(stand_in(WRITES_TWO, "a.json", "b.json"), tmp_path / "work", tmp_path)
    assert kill_once(measured, tmp_path / "work", tmp_path, share)[1] == []


def test_damage_losses_and_doubles_are_seen(tmp_path: Path) -> None:
    measured = measure(stand_in(WRITES_BADLY, "a.json"), tmp_path / "work", tmp_path)
    _, wrong = kill_once(measured, tmp_path / "work", tmp_path, 0.5)
    said = " ".join(wrong)
    assert "killed: a.json is damaged" in said
    assert "resumed: mine.txt was changed" in said
    assert "lost b" in said and "doubled b" in said


@pytest.mark.slow
def test_a_solve_killed_anywhere_is_resumed(tmp_path: Path) -> None:
    solved = solved_folder(tmp_path / "solved")
    measured = measure(OPERATIONS[0], tmp_path / "work", solved)
    for share in (0.5, 0.9):
        assert kill_once(measured, tmp_path / "work", solved, share)[1] == []
