"""People of a take who come close: who is solved again, with whom, and what remains if the second solve fails."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from solver_backend.cli import solve_verb
from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.optimise import in_turn
from solver_backend.io.native.motion_file import write_motion
from solver_backend.job import Job
from solver_backend.types import Motion

FRAMES = 20


def standing(person: str, metres: float = 0.0, body: str = "body") -> Motion:
    """Return a motion of a person who stands so far away from the origin."""
    zeros = np.zeros((FRAMES, 72), np.float32)
    joints = zeros.reshape(FRAMES, 24, 3) + np.float32([0.0, metres, 0.0])
    arrays = zeros[0, :10], zeros[:, :3], zeros[:, 3:], joints[:, 0]
    return Motion(*arrays, 30.0, body, joints, provenance={"person": person})


def solved(folder: Path, *takes: tuple[Motion, dict[str, Any]]) -> list[tuple[Job, str, Any]]:
    """Return jobs of one capture that are solved, with their files."""
    folder.mkdir(exist_ok=True)
    ended = []
    for number, (motion, options) in enumerate(takes):
        job, person = Job(folder / "take.npz", folder / f"{number}.npz", **options), motion.provenance["person"]
        write_motion(job.out, motion)
        ended.append((job, person, Outcome("", {"person": person}, ("OK",))))
    return ended


def met(folder: Path, *takes: tuple[Motion, dict[str, Any]]) -> list[tuple[int, list[float]]]:
    """Return who is solved again, and where the others stand."""
    return [
        (index, [float(other.transl[0, 1]) for other in others])
        for index, others in solve_verb._meetings(solved(folder, *takes))
    ]


def test_only_people_of_the_same_take_and_body_meet(tmp_path: Path) -> None:
    one, other = standing("A"), standing("B", 0.25)
    by_name = {"person": "A"}, {"person": "B"}
    both = [(0, [0.25]), (1, [0.0])]
    assert met(tmp_path, (one, by_name[0]), (other, by_name[1])) == both
    assert not met(tmp_path / "1", (one, {"frames": (0, 19)}), (other, {"frames": (100, 119)}))
    assert not met(tmp_path / "2", (one, {}), (other, {"stature": 1.8})), "they are in worlds of different scale"
    assert not met(tmp_path / "3", (one, {}), (replace(other, body="child"), {}))


def test_every_job_of_a_person_is_solved_again(tmp_path: Path) -> None:
    quick = {"settings": SolveSettings(iterations=2)}
    takes = (standing("A"), {}), (standing("A", 0.125), quick), (standing("B", 0.25), {})
    assert met(tmp_path, *takes) == [(0, [0.25]), (1, [0.25]), (2, [0.125])]


def test_the_first_result_stays_if_the_second_solve_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    motions = {"A": standing("A"), "B": standing("B", 0.25)}
    job = Job(tmp_path / "take.npz", tmp_path / "out.npz", person="all")
    parts = [(replace(job, person=name, out=tmp_path / f"{name}.npz"), name) for name in motions]

    def solve_one(own: Job, capture: Any, progress: Any, each: Any, others: Any = ()) -> Outcome:
        if others:
            raise NoDetections("nothing is seen", where="take")
        write_motion(own.out, motions[str(own.person)])
        return Outcome("", {"person": own.person}, ("OK",))

    def load(*args: Any) -> Any:
        return SimpleNamespace(several_views=1)

    named = [(own, SimpleNamespace(name="take", person=name)) for own, name in parts]
    monkeypatch.setattr(solve_verb, "_parts", lambda job, progress: iter(named))
    monkeypatch.setattr(solve_verb, "_solve_one", solve_one)
    monkeypatch.setattr(solve_verb, "load", load)
    outcome = solve_verb._several([job], lambda *args: None, in_turn)
    assert [take["name"] for take in outcome.data["takes"]] == ["take, A", "take, B"] and not outcome.data["failed"]
    assert all("nothing is seen" in line for line in outcome.summary[:2])
    assert outcome.summary[-1] == "Look at take, A, take, B."
