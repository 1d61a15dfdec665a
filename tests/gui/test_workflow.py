"""The whole workflow at Blender's window: dropped, looked at, cancelled, solved, undone, reviewed, exported."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gui.__main__ import missing, run


@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason=missing())
@pytest.mark.parametrize("suite", ["trixie", "sid"])
@pytest.mark.parametrize("script", ["workflow.py", "markers.py", "rig.py"])
def test_the_workflow_by_clicks(script: str, suite: str, tmp_path: Path) -> None:
    record = run(suite, tmp_path / "run", script)
    assert record["failure"] == "", record
    assert record["console"] == [] and record["left_behind"] == []
