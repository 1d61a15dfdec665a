"""What another program says in the solver's place becomes an error sentence, never a traceback."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from blender_addon._exchange.events import what_is_wrong
from blender_addon._exchange.progress import silent
from blender_addon.errors import SolverStopped
from blender_addon.headless.children import run_solver
from blender_addon.solving import run

NONSENSE: list[Any] = [
    {"event": "progress"},
    {"event": "progress", "stage": ["a"], "done": 1, "total": 2},
    {"event": "progress", "stage": "a", "done": "1", "total": 2},
    {"event": "progress", "stage": "a", "done": 1, "total": 10**400},
    {"event": "progress", "stage": "a", "done": 1, "total": 2, "eta_s": "soon"},
    {"event": "error", "message": 3},
    {"event": ["result"]},
    {"event": "dance"},
    {"event": "result"},
    {"event": "result", "capture": "c.npz", "name": "x", "frames": 3, "fps": 30, "cameras": [{}], "notes": [],
     "problems": []},
    {"event": "result", "capture": "c.npz", "name": "x", "frames": None, "fps": 30, "cameras": [], "notes": [1],
     "problems": "none"},
]  # fmt: skip


@pytest.mark.parametrize("line", NONSENSE, ids=lambda line: json.dumps(line)[:50])
def test_nonsense_is_an_error_sentence(line: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lines").write_text(json.dumps(line) + "\n")
    program = "import pathlib, sys; print(pathlib.Path('lines').read_text())"
    monkeypatch.setattr(run, "backend_command", lambda python: [sys.executable, "-c", program])
    with pytest.raises(SolverStopped, match="sent an unknown message") as caught:
        run_solver("convert", [], silent)
    assert caught.value.code == "solver_not_understood"


def test_what_the_solver_says_is_understood() -> None:
    assert what_is_wrong({"event": "progress", "stage": "a", "done": 0, "total": 0, "eta_s": None}, "solve") == ""
    solved = {"motion": "m", "diagnostics": [], "frames": 3, "reprojection_median_px": 1.5, "unsure_frames": 0}
    assert what_is_wrong({"event": "result", **solved, "unseen_frames": 1}, "solve") == ""
    read = {"capture": "c", "name": "x", "frames": 3, "fps": 30, "joint_set": None, "markers": None, "cameras": [],
            "people": [], "person": "", "notes": [], "problems": []}  # fmt: skip
    found = [{"code": "clocks_assumed", "severity": "warning", "where": {"cameras": ["1"]}, "values": {}}]
    for verb, result in (
        ("convert", read),
        ("from-videos", {"takes": {"x": {"folder": "f", "source": "s", "read": read}}}),
        ("cameras check", {"verdict": "v", "findings": [], "stature_m": 1.7, "tilt_deg": 0.1, "tilt_sigma_deg": 1.0}),
        ("cameras fit", {"calibration": "c", "format": "f", "cameras": [], "residual_px": None, "stature_m": None,
                         "notes": [], "problems": []}),
    ):  # fmt: skip
        within = read if verb == "from-videos" else result
        assert what_is_wrong({"event": "result", **result}, verb), verb
        within["diagnostics"] = found
        assert what_is_wrong({"event": "result", **result}, verb) == ""
        for nonsense in ("late", ["late"], [{"code": 1}], [{**found[0], "where": "left"}]):
            within["diagnostics"] = nonsense
            assert what_is_wrong({"event": "result", **result}, verb), (verb, nonsense)
    assert what_is_wrong({"event": "error", "code": "a", "message": "b", "where": "", "hint": ""}, "solve") == ""
