"""A few of the kills that ``python -m tests.kills`` does by the hundred, and that its look sees what is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.kills.__main__ import Kills
from tests.kills.moments import Moment, drawn
from tests.kills.operations import OPERATIONS, Operation
from tests.kills.run import kill_once, measure, solved_folder

EARLY, MIDDLE = Moment("early", 0.1), Moment("working", 0.5)
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


@pytest.mark.parametrize("moment", [EARLY, MIDDLE, Moment("writing", change=2, delay_s=0.01), Moment("ending", 1.5)])
def test_whole_files_are_kept_and_the_others_made_again(tmp_path: Path, moment: Moment) -> None:
    measured = measure(stand_in(WRITES_TWO, "a.json", "b.json"), tmp_path / "work", tmp_path)
    assert measured.changes >= 2
    assert kill_once(measured, tmp_path / "work", tmp_path, moment)[1] == []


def test_damage_losses_and_doubles_are_seen(tmp_path: Path) -> None:
    measured = measure(stand_in(WRITES_BADLY, "a.json"), tmp_path / "work", tmp_path)
    _, wrong = kill_once(measured, tmp_path / "work", tmp_path, MIDDLE)
    said = " ".join(wrong)
    assert "killed: a.json is damaged" in said
    assert "resumed: mine.txt was changed" in said
    assert "lost b" in said and "doubled b" in said


RECORDS_TWO = """
import pathlib, sys, time
if pathlib.Path("a.json").exists():
    print("there already", file=sys.stderr)
    sys.exit(3)
for name in ("a.json", "b.json"):
    pathlib.Path(name).write_text("[1]")
    time.sleep(0.6)
"""


@pytest.mark.parametrize("apart", [True, False])
def test_what_had_not_begun_is_lost_only_where_outputs_begin_together(apart: bool, tmp_path: Path) -> None:
    operation = replace(stand_in(RECORDS_TWO, "a.json", "b.json"), begins_apart=apart)
    measured = measure(operation, tmp_path / "work", tmp_path)
    _, wrong = kill_once(measured, tmp_path / "work", tmp_path, Moment("writing", change=1))
    assert wrong == ([] if apart else ["lost b.json"])


@pytest.mark.slow
def test_a_solve_killed_anywhere_is_resumed(tmp_path: Path) -> None:
    solved = solved_folder(tmp_path / "solved")
    measured = measure(OPERATIONS[0], tmp_path / "work", solved)
    for moment in (MIDDLE, drawn(np.random.default_rng(0), 1, measured.changes)):
        assert kill_once(measured, tmp_path / "work", solved, moment)[1] == []


def test_kills_are_counted_over_several_runs(tmp_path: Path) -> None:
    kills = Kills.load(tmp_path / "state.json")
    kills.count("solve", Moment("early", 0.1), [])
    kills.count("solve", Moment("writing", change=1), ["lost take.npz"])
    kills.save(tmp_path / "state.json")
    again = Kills.load(tmp_path / "state.json")
    assert (again.total, again.of("solve"), again.wrong) == (2, 2, ["solve (writing, change 1): lost take.npz"])
    assert "2 kills, 1 resumed with every file whole" in again.table()
