"""Commands of the tutorials run one after the other as they are printed, in a folder with what the page asks for."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from solver_backend.cli.main import main
from tests.support.page_commands import commands

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
DEMO_MARKERS = ROOT / "solver_backend" / "assets" / "demo_markers.c3d"
SPECS = [ROOT / "docs" / name for name in ("how-to/make-data-sets.md", "tutorials/from-sensors.md")]


def specification(page: Path) -> dict:
    """Return the description of shots that a page shows."""
    [text] = [
        block for block in re.findall(r"```json\n(.*?)```", page.read_text("utf-8"), re.DOTALL) if '"film"' in block
    ]
    return json.loads(text)


def run_all(lines: list[tuple[str, list[str]]]) -> None:
    for program, words in lines:
        if program == "solver_backend":
            assert main(words) == 0, words
        else:
            assert subprocess.run([sys.executable, "-m", program, *words], check=False).returncode == 0, words


@pytest.mark.parametrize("page", SPECS, ids=lambda page: page.stem)
def test_a_description_of_shots_is_one_that_the_studio_films(page: Path, tmp_path: Path, capsys) -> None:
    spec = tmp_path / "spec.json"
    spec.write_text(json.dumps(specification(page)), encoding="utf-8")
    assert main(["dataset make", str(spec), "--out", str(tmp_path / "set"), "--plan"]) == 0
    assert "would make" in capsys.readouterr().out


@pytest.mark.slow
def test_from_sensors_without_cameras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    page = TUTORIALS / "from-sensors.md"
    (tmp_path / "spec.json").write_text(json.dumps(specification(page)), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text("utf-8").split("## With cameras")[0], re.DOTALL)
    lines = list(commands("\n".join(blocks)))
    assert [" ".join(words[:2]) for _, words in lines[:2]] == ["dataset make", "sensors markers"]
    run_all(lines)
    shown = capsys.readouterr()
    assert "52.0 points per frame" in shown.out
    assert float(re.search(r"residual +([\d.]+) mm", shown.out + shown.err)[1]) < 0.7


@pytest.mark.slow
def test_from_markers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    pytest.importorskip("bpy")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    for name in ("take.c3d", "range_of_motion.c3d"):
        (tmp_path / name).write_bytes(DEMO_MARKERS.read_bytes())
    blocks = re.findall(r"```sh\n(.*?)```", (TUTORIALS / "from-markers.md").read_text("utf-8"), re.DOTALL)
    run_all(list(commands("\n".join(blocks))))
    assert "OK" in capsys.readouterr().err
    assert {"motion.blend", "motion.mp4", "motion_contact.png"} <= {
        path.name for path in (tmp_path / "baked").iterdir()
    }
    assert all((tmp_path / name).is_file() for name in ("motion.npz", "report.html", "anna.npz", "cleaned.c3d"))
