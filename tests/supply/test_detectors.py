from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from supply import detectors


def test_an_environment_that_works_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(detectors, "works", lambda python: True)
    assert detectors.main(tmp_path / "environment") == 0
    assert "ready" in capsys.readouterr().out and not (tmp_path / "environment").exists()


def test_a_package_that_fails_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(detectors, "NEWEST", sys.version_info[:2])
    monkeypatch.setattr(detectors.venv, "create", lambda folder, **options: None)
    monkeypatch.setattr(subprocess, "call", lambda command: asked.append(command) or 1)
    assert detectors.main(tmp_path / "environment") == 1
    assert "call again" in capsys.readouterr().err
    assert len(asked) == 1 and asked[0][-2:] == ["--no-deps", detectors.MEDIAPIPE]


def test_another_python_is_no_environment() -> None:
    assert not detectors.works(Path("nowhere/python"))
    has = subprocess.run([sys.executable, "-c", "import mediapipe"], capture_output=True).returncode == 0
    assert has or not detectors.works(Path(sys.executable))
