"""Test that the hard passage has the methods' largest errors, and that plots and video show it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.io.native.motion_file import write_motion
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.benchmarks.comparison import passage as passages
from tests.benchmarks.comparison.methods import Method
from tests.benchmarks.comparison.passage import SHOWN, Passage, hardest, true_motion
from tests.benchmarks.comparison.plots import error_against_time, knee_flexion
from tests.benchmarks.comparison.runs import Outcome, Run
from tests.benchmarks.comparison.sections import Section

FRAMES = 150


@pytest.fixture(scope="module")
def passage(tmp_path_factory: pytest.TempPathFactory) -> Passage:
    folder, capture = tmp_path_factory.mktemp("motions"), demo_capture(num_frames=FRAMES)
    rows, found = {}, {}
    for number, label in enumerate(SHOWN):
        truth = true_motion(capture)
        joints = truth.joints.copy()
        joints[30:] += 0.01 * (3 - number)
        joints[100:120] += 0.2
        path = write_motion(folder / f"{number}.npz", replace(truth, joints=joints))
        run = Run(Method(label), "a")
        rows[label], found[run] = [run], Outcome({}, [], [], path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(passages, "filmed", lambda *_: capture)
        return hardest(Section("t", rows, ()), found)


def test_the_passage_holds_the_worst_frames_of_every_motion(passage: Passage) -> None:
    assert passage.first == FRAMES - 120
    assert list(passage.motions) == ["truth", *SHOWN]
    assert {motion.num_frames for motion in passage.motions.values()} == {120}
    errors = passage.errors_mm()
    assert errors["truth"] < 1e-3 < errors[SHOWN[2]] < errors[SHOWN[1]] < errors[SHOWN[0]]


def test_plots_stand_on_their_own(passage: Passage, tmp_path: Path) -> None:
    knee_flexion(tmp_path / "knee.svg", passage)
    error_against_time(
        tmp_path / "time.svg",
        {"a": {"mpjpe_mm": 20.0, "cpu_s": 3.0}, "ours": {"mpjpe_mm": 8.0, "cpu_s": 40.0},
         "filter": {"mpjpe_mm": np.nan, "cpu_s": 1.0}},
    )  # fmt: skip
    for name, words in (("knee_left.svg", SHOWN), ("knee_right.svg", SHOWN), ("time.svg", ("a", "ours"))):
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert text.startswith("<svg xmlns=") and "<style>" in text
        assert all(f">{word}</text>" in text for word in words)
    assert "filter" not in (tmp_path / "time.svg").read_text(encoding="utf-8")
