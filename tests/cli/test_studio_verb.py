"""The verb ``dataset make`` says what it made, not what was asked for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from solver_backend.cli.main import main


def test_a_motion_that_ends_before_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    description = {
        "fps": 2,
        "frames": 100,
        "motions": ["choreography"],
        "camera_arrays": [{"count": 2, "size": [64, 48]}],
    }
    path = tmp_path / "studio.json"
    path.write_text(json.dumps({"version": 1, "name": "short", "film": ["masks"], **description}), encoding="utf-8")
    assert main(["dataset make", str(path), "--out", str(tmp_path / "set")]) == 0
    said = capsys.readouterr().out
    assert "made 1 of 1 shots, 12 frames of 100 requested" in said
    assert main(["dataset make", str(path), "--out", str(tmp_path / "set"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["frames"] == 12
