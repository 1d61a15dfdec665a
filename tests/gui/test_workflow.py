"""What users do at Blender's window, by clicks: a script a subject, each in both Blenders."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gui.__main__ import missing, run

SUBJECTS = (
    "first_animation", "nothing_lost", "workflow", "markers", "rig", "project", "characters", "cameras", "people",
    "clean_up", "panels", "sensors", "studio", "retarget_speed", "accidents", "videos",
    "second_blender", "relink", "ghost",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason=missing())
@pytest.mark.parametrize("suite", ["trixie", "sid"])
@pytest.mark.parametrize("subject", SUBJECTS)
def test_the_workflow_by_clicks(subject: str, suite: str, tmp_path: Path) -> None:
    record = run(suite, tmp_path / "run", f"{subject}.py")
    assert record["failure"] == "", record
    assert record["console"] == [] and record["left_behind"] == []
