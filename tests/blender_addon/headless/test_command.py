"""The command line in a process of its own, and its outputs: all or none."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_addon.__main__ import main
from blender_addon._exchange.errors import OutputExists, OutputNotWritable
from blender_addon._exchange.outputs import atomic_outputs
from blender_addon.headless.verb_table import VERBS, program
from solver_backend.cli.program import parse

ROOT = Path(__file__).resolve().parents[3]


def _run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "blender_addon", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False, encoding="utf-8")


def test_bake_writes_a_blender_file_and_says_how_exact_it_is(files: Any, tmp_path: Path) -> None:
    out = tmp_path / "new folder ü" / "inner"
    done = _run(
        "bake", files.motion_path, "--capture", files.capture_path, "--body", files.body_path, "--out", out,
        "--no-pictures", "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert [event["event"] for event in events[:-1]] == ["progress"] * (len(events) - 1)
    result = events[-1]
    assert result["event"] == "result" and result["outputs"] == [str(out / "walk.blend")]
    assert result["joints_deviation_mm"] <= 0.1 and result["skin_deviation_mm"] <= 0.1
    assert [p.name for p in out.iterdir()] == ["walk.blend"]
    assert (out / "walk.blend").read_bytes()[:4] == b"\x28\xb5\x2f\xfd", "compressed by zstandard"
    again = _run("bake", files.motion_path, "--body", files.body_path, "--out", out, "--no-pictures")
    assert again.returncode == 3
    assert "error: walk.blend already exists. Nothing" in again.stderr and "try:   Choose" in again.stderr


@pytest.mark.slow
def test_bake_writes_video_and_contact_sheet(files: Any, tmp_path: Path) -> None:
    arrays = dict(np.load(files.motion_path))
    cut = {key: value[:8] if value.shape[:1] == (60,) else value for key, value in arrays.items()}
    np.savez(tmp_path / "short.npz", **cut)
    out = tmp_path / "out"
    done = _run(
        "bake", tmp_path / "short.npz", "--capture", files.capture_path, "--body", files.body_path, "--out", out
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [str(out / f"short{end}") for end in (".blend", ".mp4", "_contact.png")]
    assert sorted(p.name for p in out.iterdir()) == ["short.blend", "short.mp4", "short_contact.png"]
    assert "note: The capture has 60 frames and the motion 8. Both start together." in done.stderr
    assert "Blender agrees with the motion to 0.0" in done.stderr
    assert "Saved" not in done.stdout + done.stderr and "EGL" not in done.stderr


def test_errors_are_events_with_a_code_of_their_own(
    files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"PK\x03\x04 nothing")
    body = ("--body", files.body_path)
    cases = [
        ((tmp_path / "gone.npz",), "file_missing"),
        ((broken,), "file_damaged"),
        ((files.capture_path,), "file_damaged"),
        ((files.motion_path, *body, "--capture", tmp_path / "gone.npz"), "file_missing"),
        ((files.motion_path, *body, "--capture", files.motion_path), "file_damaged"),
        ((files.motion_path, "--body", files.motion_path), "file_damaged"),
        ((files.motion_path,), "body_mismatch"),
    ]
    for arguments, code in cases:
        returned = main(["bake", *map(str, arguments), "--out", str(tmp_path / "out"), "--json"])
        event = json.loads(capfd.readouterr().out.splitlines()[-1])
        assert (returned, event["event"], event["code"]) == (3, "error", code)
        assert event["message"] and event["where"]
    assert not (tmp_path / "out").exists()


def test_what_nobody_foresaw_is_an_event_too(
    files: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("blender_addon.headless.bake.read_motion", broken)
    assert main(["bake", str(files.motion_path), "--out", str(tmp_path), "--json"]) == 4
    said = capfd.readouterr()
    assert json.loads(said.out)["code"] == "bake_failed" and "ZeroDivisionError: oh" in json.loads(said.out)["message"]
    assert "Traceback" in said.err


def test_wrong_usage_and_help() -> None:
    assert _run("bake").returncode == 2
    shown = _run("--help")
    assert shown.returncode == 0 and "130  cancelled" in shown.stdout
    assert "\n  batch " in shown.stdout and "\ngroups of verbs:\n  markers " in shown.stdout


@pytest.mark.parametrize("name", list(VERBS))
def test_the_help_of_a_verb_ends_in_an_example_that_it_takes(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        program().parse([name, "--help"])
    example = capsys.readouterr().out.strip().splitlines()[-1].strip()
    assert ended.value.code == 0 and example == f"python -m blender_addon {VERBS[name].example}"
    words = shlex.split(VERBS[name].example)
    assert program().parse(words).verb == name
    if VERBS[name].passes_on and not VERBS[name].rows.keys() - {"python"}:
        parse(words)


def test_outputs_are_all_or_none(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with suppress(KeyError), atomic_outputs(folder, ("x", "y")) as temporary:
        temporary["x"].write_text("half")
        raise KeyError
    assert not (tmp_path / "a").exists(), "new folders go again"
    with atomic_outputs(folder, ("x", "y")) as temporary:
        for name, path in temporary.items():
            path.write_text(name)
    assert {p.name: p.read_text() for p in folder.iterdir()} == {"x": "x", "y": "y"}
    with pytest.raises(OutputExists, match="x, y already exist\\. Nothing"), atomic_outputs(folder, ("x", "y", "z")):
        pass


def test_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(OutputNotWritable, match="cannot be written: Not a directory"),
        atomic_outputs(tmp_path / "file" / "x", ("a",)),
    ):
        pass
    if os.geteuid() != 0:
        (tmp_path / "closed").mkdir(mode=0o500)
        with pytest.raises(OutputNotWritable, match="Permission denied"), atomic_outputs(tmp_path / "closed", ("a",)):
            pass
