"""People in a crowd are told apart, and nothing in the files of their cameras is changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.io.load import load_capture
from tests.benchmarks.bench_good_captures import film_crowd
from tests.benchmarks.spoiled_views.motion_takes import cameras_of
from tests.support.trial_files import write_trial


@pytest.mark.slow
def test_a_crowd_keeps_the_names_of_its_cameras(tmp_path: Path, shared_data: Path) -> None:
    """The largest person differs between the views, and five exchanged cameras agree better on them by chance."""
    take, _, people = film_crowd(3, "ring 8")
    cameras, config = cameras_of(take.layout), "[project]\nframe_rate = 25\n"
    names = cameras.names
    write_trial(tmp_path, cameras=cameras, people=people, names=names, calibrated=names, config=config)
    capture = load_capture(tmp_path)
    assert "camera_names_exchanged" not in [item.code for item in capture.problems]
    assert len(capture.people) == len(people)
