"""The command line: results, errors, exit codes, the protocol, and that nothing is left half-written."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.cli.program import parse
from solver_backend.exchange.diagnostics import read_diagnostics
from solver_backend.exchange.errors import Cancelled, NoDetections
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.io.motions.motion_checks import check_motion
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.types import JointSet
from tests.support import cli_stand_ins
from tests.support.cli_stand_ins import FRAMES, StandIns
from tests.support.scenes import small_motion


@pytest.fixture
def stand_ins(monkeypatch) -> StandIns:
    made = StandIns()
    for name, module in made.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    return made


def events(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def test_solve_writes_a_motion_and_says_so(stand_ins, tmp_path, capsys):
    out = tmp_path / "new" / "motion.npz"
    assert main(["solve", "take", "--out", str(out)]) == 0
    motion = read_motion(out)
    assert motion.num_frames == FRAMES
    assert motion.provenance["solve_s"] >= 0
    shown = capsys.readouterr()
    assert "Solved 7 frames, 0.1 s at 59.94 frames per second, in " in shown.out
    assert str(out) in shown.out
    assert "a library that prints" in shown.err
    assert "a library" not in shown.out


def test_a_solve_ends_with_every_warning_and_where_to_look(stand_ins, tmp_path, capsys):
    assert main(["solve", "take", "--out", str(tmp_path / "m.npz")]) == 0
    *warnings, last = capsys.readouterr().err.split("a library that prints\n")[1].splitlines()
    warnings = [line for line in warnings if line.startswith("warning: ")]
    assert warnings[:2] == ["warning: One camera is dark.", "warning: Ünicode."]
    assert any("The body moves at up to " in line and "in frames 0-6" in line for line in warnings)
    assert last.startswith("Look at ") and "frames 0-6" in last and last.endswith("warnings above).")


@pytest.mark.parametrize("by_job", [True, False])
def test_a_strict_solve_with_warnings_is_refused_and_writes_nothing(stand_ins, tmp_path, capsys, by_job):
    argv = ["solve", "take", "--out", str(tmp_path / "m.npz"), "--report", str(tmp_path / "r.html"), "--strict"]
    if by_job:
        job = {"version": 1, "capture": "take", "out": "m.npz", "report": "r.html", "strict": True}
        (tmp_path / "job.json").write_text(json.dumps(job), encoding="utf-8")
        argv = ["solve", "--job", str(tmp_path / "job.json")]
    assert main([*argv, "--json"]) == 3
    last = events(capsys.readouterr().out)[-1]
    assert last["code"] == "warnings_refused" and "One camera is dark. Ünicode." in last["message"]
    assert not {"m.npz", "r.html"} & {path.name for path in tmp_path.iterdir()}


def test_a_useless_result_is_refused_and_writes_nothing_unless_it_is_accepted(stand_ins, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(cli_stand_ins, "with_legs", lambda motion: replace(motion, joints=9.0 * motion.joints))
    argv = ["solve", "take", "--out", str(tmp_path / "m.npz"), "--report", str(tmp_path / "r.html"), "--json"]
    assert main(argv) == 3
    last = events(capsys.readouterr().out)[-1]
    assert last["code"] == "result_refused" and "--accept stature_odd" in last["hint"]
    assert not {"m.npz", "r.html"} & {path.name for path in tmp_path.iterdir()}
    assert main([*argv, "--accept", "stature_odd"]) == 0
    found = {item["code"]: item["severity"] for item in events(capsys.readouterr().out)[-1]["diagnostics"]}
    assert found["stature_odd"] == "warning"


def test_the_options_reach_reader_and_solver(stand_ins, tmp_path):
    argv = ["solve", "take", "--out", str(tmp_path / "m.npz"), "--fps", "50", "--trim", "--joint-set", "COCO_17"]
    argv += ["--unit", "mm", "--up-axis", "y", "--subject-prefix", "Anna"]
    argv += ["--camera", "hall=cam2", "--sync", "off", "--offset", "cam2=60", "--by-order", "--frames", "10", "20"]
    assert (
        main([*argv, "--method", "frame", "--backend", "torch", "--body", "anny", "--report", str(tmp_path / "r.html")])
        == 0
    )
    calls = dict(stand_ins.calls)
    reading = {"fps": 50.0, "trim": True, "joint_set": JointSet.COCO_17, "unit": "mm", "up_axis": "y"}
    reading |= {"as_calibrated": False, "stature": 0.0, "scale": 1.0, "level": "auto", "camera_path": ""}
    reading |= {
        "subject_prefix": "Anna",
        "person": None,
        "camera": ("hall=cam2",),
        "offset": ("cam2=60",),
        "by_order": True,
        "sync": "off",
    }
    reading |= {"frames": (10, 20)}
    assert calls["load"] | {"path": None, "progress": None} == {"path": None, "progress": None, **reading}
    assert calls["solve"]["settings"] == SolveSettings(method="frame", backend="torch", body="anny", sync="off")
    assert set(calls["report"]) == {"capture", "motion"}
    assert (tmp_path / "r.html").read_text(encoding="utf-8") == "<html>a page</html>"


def test_json_ends_in_exactly_one_result(stand_ins, tmp_path, capsys):
    out = tmp_path / "motion.npz"
    assert main(["solve", "take", "--out", str(out), "--json"]) == 0
    *progress, last = events(capsys.readouterr().out)
    assert {event["event"] for event in progress} == {"progress"}
    assert ("Solving", 2, 2) in [(event["stage"], event["done"], event["total"]) for event in progress]
    assert last["event"] == "result"
    assert last["motion"] == str(out)
    assert last["frames"] == FRAMES
    odd = check_motion(small_motion(FRAMES))
    found = read_diagnostics(last["diagnostics"])
    said = [item.values["text"] for item in found if item.severity == "warning" and item.code == "scene_message"]
    assert odd and all(item in found for item in odd)
    assert said == ["One camera is dark.", "Ünicode."]


def test_a_job_file_says_the_same_as_the_options(stand_ins, tmp_path, capsys):
    job = {"version": 1, "capture": "take", "out": "m.npz", "report": "r.html", "settings": {"method": "frame"}}
    (tmp_path / "job.json").write_text(json.dumps(job), encoding="utf-8")
    assert main(["solve", "--job", str(tmp_path / "job.json"), "--json"]) == 0
    assert dict(stand_ins.calls)["load"]["path"] == tmp_path / "take"
    assert events(capsys.readouterr().out)[-1]["report"] == str(tmp_path / "r.html")


@pytest.mark.parametrize(
    ("error", "code", "name"),
    [
        (NoDetections("Nobody.", where="take", hint="Look again."), 3, "no_detections"),
        (Cancelled("Enough."), 130, "cancelled"),
        (np.linalg.LinAlgError("Singular matrix"), 4, "solver_failed"),
        (MemoryError("full"), 4, "solver_failed"),
    ],
)
@pytest.mark.parametrize("at", ["load_error", "solve_error"])
def test_an_error_is_told_once_and_leaves_nothing(stand_ins, tmp_path, capsys, at, error, code, name):
    setattr(stand_ins, at, error)
    assert main(["solve", "take", "--out", str(tmp_path / "m.npz"), "--json"]) == code
    shown = capsys.readouterr()
    *progress, last = events(shown.out)
    assert {event["event"] for event in progress} <= {"progress"}
    assert (last["event"], last["code"]) == ("error", name)
    assert set(last) == {"event", "code", "message", "where", "hint"}
    assert not list(tmp_path.iterdir())
    if code == 4:
        assert type(error).__name__ in last["message"]
        assert "Traceback" in shown.err


def test_people_read_what_where_and_what_to_try(stand_ins, tmp_path, capsys):
    stand_ins.load_error = NoDetections("No person was detected.", where="take", hint="Look again.")
    assert main(["info", "take"]) == 3
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "error: No person was detected.\n  where: take\n  try:   Look again.\n" in shown.err


@pytest.mark.parametrize("option", ["--out", "--report"])
def test_an_output_that_exists_is_refused_before_the_solve(stand_ins, tmp_path, capsys, option):
    places = {"--out": tmp_path / "m.npz", "--report": tmp_path / "r.html"}
    places[option].write_bytes(b"mine")
    argv = ["solve", "take", *(str(part) for pair in places.items() for part in pair)]
    assert main(argv) == 3
    assert "already exist" in capsys.readouterr().err
    assert stand_ins.calls == []
    assert places[option].read_bytes() == b"mine"
    assert main([*argv, "--overwrite"]) == 0
    assert places[option].read_bytes() != b"mine"


def test_a_folder_that_cannot_be_written_is_refused_before_the_solve(stand_ins, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["solve", "take", "--out", str(tmp_path / "file" / "m.npz")]) == 3
    assert "cannot be written" in capsys.readouterr().err
    assert stand_ins.calls == []


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ([], "VERB is missing."),
        (["slove"], "There is no verb 'slove'."),
        (["solve"], "solve needs a capture and --out, or --job."),
        (["solve", "take"], "solve needs a capture and --out, or --job."),
        (["solve", "take", "--out", "m.npz", "--fps", "fast"], "--fps: 'fast' is not a number."),
        (["solve", "take", "--out", "m.npz", "--fps", "-5"], "The frame rate must be a positive number"),
        (
            ["solve", "take", "--out", "m.npz", "--method", "magic"],
            "method = 'magic' is not valid. It must be one of global, bundlemocap++, sliding, frame",
        ),
        (["solve", "take", "--out", "m.npz", "--joint-set", "X"], "There is no joint set 'X'."),
        (["solve", "take", "--out", "m.bvh"], "A motion file must end in .npz."),
        (["solve", "take", "--job", "j.json", "--trim"], "--job cannot be combined with capture, trim."),
        (["info", "take", "--colour"], "Unrecognized arguments: --colour."),
        (["convert", "take"], "-o/--out is missing."),
    ],
)
@pytest.mark.parametrize("as_json", [True, False])
def test_a_wrong_command_line_is_exit_code_2(stand_ins, capsys, argv, message, as_json):
    assert main([*argv, "--json"] if as_json else argv) == 2
    shown = capsys.readouterr()
    if as_json:
        (event,) = events(shown.out)
        assert event["event"] == "error"
        assert message in event["message"]
    else:
        assert shown.out == ""
        assert message in shown.err
    assert stand_ins.calls == []


@pytest.mark.parametrize("argv", [["--help"], ["solve", "--help"], ["--version"]])
def test_help_and_version_are_results(argv, capsys):
    assert main(argv) == 0
    assert capsys.readouterr().out


def test_info_tells_people_and_programs_the_same(stand_ins, capsys):
    assert main(["info", "take", "--fps", "30"]) == 0
    text = capsys.readouterr().out
    assert dict(stand_ins.calls)["load"]["fps"] == 30.0
    assert main(["info", "take", "--json"]) == 0
    data = events(capsys.readouterr().out)[-1]
    assert data["name"] in text
    assert f"{data['frames']} at {data['fps']:g} fps" in text
    assert all(problem in text for problem in data["problems"])
    assert all(camera["name"] in text for camera in data["cameras"])


def test_convert_writes_the_capture_it_read(stand_ins, tmp_path, capsys):
    out = tmp_path / "capture.npz"
    assert main(["convert", "take", "--out", str(out), "--json"]) == 0
    assert read_capture(out).num_frames == FRAMES
    assert events(capsys.readouterr().out)[-1]["capture"] == str(out)
    assert main(["convert", "take", "--out", str(out)]) == 3
    assert "already exist" in capsys.readouterr().err


def test_bodies_lists_what_can_be_chosen(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("MANIFOLD_MOCAP_BODIES", str(tmp_path))
    (tmp_path / "tall.npz").write_bytes(b"")
    assert main(["motion bodies", "--json"]) == 0
    result = events(capsys.readouterr().out)[-1]
    assert list(result["bodies"]) == ["neutral", "tall"] and result["folder"] == str(tmp_path)
    assert main(["motion bodies"]) == 0
    assert str(tmp_path / "tall.npz") in capsys.readouterr().out


def test_training_names_what_is_wrong(tmp_path, capsys):
    assert main(["train model", "poser", "--data", str(tmp_path)]) == 2
    assert "no prior 'poser' (known: " in capsys.readouterr().err
    assert main(["train model", "sposer", "--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 3
    assert "No training clips" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_axis_with_a_sign_is_no_option() -> None:
    assert parse(["info", "capture", "--up-axis", "-y"]).up_axis == "-y"
    assert parse(["info", "capture", "--up-axis", "x"]).up_axis == "x"


@pytest.mark.parametrize("key", ["out", "report"])
def test_a_job_file_writes_outside_its_folder_only_if_that_is_allowed(stand_ins, tmp_path, capsys, key):
    """A job file of somebody else must not replace files elsewhere."""
    folder = tmp_path / "theirs" / "job"
    folder.mkdir(parents=True)
    mine = tmp_path / ("mine.npz" if key == "out" else "index.html")
    mine.write_text("mine", encoding="utf-8")
    job = {"version": 1, "capture": "take", "out": "m.npz", "overwrite": True, key: f"../../{mine.name}"}
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    assert main(["solve", "--job", str(folder / "job.json")]) == 2
    assert "writes outside its own folder" in capsys.readouterr().err and mine.read_text(encoding="utf-8") == "mine"
    assert main(["solve", "--job", str(folder / "job.json"), "--allow-outside"]) == 0
    assert mine.read_bytes() != b"mine"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="The system has no full device.")
@pytest.mark.parametrize(
    ("redirection", "code"),
    [
        pytest.param("2>&-", 0, marks=pytest.mark.slow),
        ("2>/dev/full", 0),
        pytest.param(">/dev/full", 3, marks=pytest.mark.slow),
        ("--json >/dev/full", 3),
        (">&- 2>&-", 0),
    ],
)
def test_a_closed_or_full_stream_does_not_cost_the_result(tmp_path: Path, redirection: str, code: int) -> None:
    out = tmp_path / "demo.npz"
    command = f'"{sys.executable}" -m solver_backend dataset demo --markers --out "{out}" {redirection}'
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == code and out.is_file() and "Traceback" not in done.stderr
    assert ("Files were written" in done.stderr) is (code == 3)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="The system has no full device.")
def test_an_error_that_finds_no_room_as_json_is_told_as_text(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(["explain", "no_such_code", "--json"]) == 2
    assert "There is no code" in capsys.readouterr().err


def test_help_starts_without_what_only_work_needs() -> None:
    """``--help`` must take less than 0.1 s of CPU time, so it loads none of these."""
    code = (
        "import sys; from solver_backend.cli.main import main; main(['--help']); print(*sys.modules, file=sys.stderr)"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr.split()
    late = {
        "numpy",
        "logging",
        "secrets",
        "difflib",
        "solver_backend.exchange.diagnostics",
        "solver_backend.cli.outcome",
    }
    assert "solver_backend.exchange.verbs" in loaded
    assert not late.intersection(loaded)
