"""The verb studio: from a description to pictures, a card and an evaluated solve, in one command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from blender_addon.headless.main import main
from blender_addon.studio import colour_film

SPEC: dict[str, Any] = {
    "film": ["rgb", "masks"], "camera_arrays": [{"preset": "webcam_ring_4", "scale": 0.2}], "frames": 2, "fps": 4,
    "looks": ["everyday"], "write": ["video"],
}  # fmt: skip


def said(capfd: pytest.CaptureFixture[str]) -> dict[str, Any]:
    return json.loads(capfd.readouterr().out.splitlines()[-1])


@pytest.mark.slow
def test_one_command_makes_colour_video_card_and_table(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    spec, out = tmp_path / "spec ü.json", tmp_path / "set"
    spec.write_text(json.dumps(SPEC))
    given = ["dataset make", str(spec), "--out", str(out), "--json"]
    assert main([*given, "--benchmark", "triangulation"]) == 0
    result = said(capfd)
    assert result["event"] == "result" and result["frames"] == 2 and len(result["shots"]) == 1
    assert "triangulation" in result["table"] and all(Path(path).exists() for path in result["outputs"])
    shot = out / "shots" / result["shots"][0]
    assert len(list((shot / "rgb").rglob("*.png"))) == 8
    assert all(path.stat().st_size > 1000 for path in (shot / "videos").glob("*.mp4"))
    assert len(list((shot / "videos").glob("*.mp4"))) == 4
    before = {path: path.stat().st_mtime_ns for path in (shot / "rgb").rglob("*.png")}
    assert main(given) == 0, "a second run finds everything there"
    assert {path: path.stat().st_mtime_ns for path in (shot / "rgb").rglob("*.png")} == before


def test_an_engine_that_this_blender_lacks_is_named_before_anything_is_made(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = tmp_path / "spec.json"
    spec.write_text(json.dumps(SPEC | {"rgb": {"engine": "eevee"}}))
    monkeypatch.setitem(colour_film._IDS, "eevee", ("NOBODY_BUILT_IT",))
    assert main(["dataset make", str(spec), "--out", str(tmp_path / "set"), "--json"]) != 0
    event = said(capfd)
    assert event["code"] == "render_failed" and "'eevee'" in event["message"] and "workbench" in event["hint"]
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("change", "code", "name"),
    [({"camera_arrays": ["nobody_has_it"]}, 2, "studio_invalid"), ({"motions": ["gone.bvh"]}, 3, "file_missing")],
)
def test_errors_come_before_anything_is_made(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], change: dict[str, Any], code: int, name: str
) -> None:
    spec = tmp_path / "spec.json"
    spec.write_text(json.dumps(SPEC | change))
    assert main(["dataset make", str(spec), "--out", str(tmp_path / "set"), "--json"]) == code
    assert said(capfd)["code"] == name
    assert not (tmp_path / "set").exists()
