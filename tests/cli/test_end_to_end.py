"""The real verbs in a row: a capture is written, described, solved, reported on and compared with its truth."""

from __future__ import annotations

import json

from solver_backend.cli.main import main
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.report import page
from solver_backend.synthesis.embedded.demo import demo_capture

FRAMES = 30


def result_of(argv: list[str], capsys) -> dict:
    assert main([*argv, "--json"]) == 0
    *progress, result = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {event["event"] for event in progress} <= {"progress"}
    assert result["event"] == "result"
    return result


def test_a_capture_becomes_a_motion_and_a_report(tmp_path, capsys):
    capture, copy = tmp_path / "take.npz", tmp_path / "copy.npz"
    motion, report = tmp_path / "motion.npz", tmp_path / "report.html"
    write_capture(capture, demo_capture(FRAMES))

    described = result_of(["info", str(capture)], capsys)
    assert (described["frames"], described["joint_set"], len(described["cameras"])) == (FRAMES, "BODY_25", 4)

    assert result_of(["convert", str(capture), "--out", str(copy)], capsys) == described | {"capture": str(copy)}

    solved = result_of(["solve", str(copy), "--out", str(motion), "--report", str(report)], capsys)
    assert (solved["frames"], solved["unseen_frames"]) == (FRAMES, 0)
    assert read_motion(motion).provenance["settings"]["method"] == "global"
    page = report.read_text(encoding="utf-8")
    assert "Against the truth" in page
    assert page.endswith("</html>\n")

    compared = result_of(["evaluate", str(copy), str(motion)], capsys)
    assert compared["joints_mpjpe_mm"] < 25.0
    assert compared["mpjpe_ratio"] < 1.0
    assert compared["accel_ratio"] < 1.0
    again = tmp_path / "again.npz"
    stretch = ["--resolve", str(motion), "--frames", "8", "20", "--out", str(again)]
    assert result_of(["solve", str(copy), *stretch], capsys)["frames"] == FRAMES
    assert read_motion(again).provenance["resolved"] == [{"first": 8, "last": 20, "pins": []}]
    again.unlink()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["copy.npz", "motion.npz", "report.html", "take.npz"]


def test_a_report_that_breaks_leaves_the_motion_whole_and_no_page(tmp_path, monkeypatch, capsys):
    def broken(*_: object) -> str:
        raise MotionInvalid("no page of this motion")

    monkeypatch.setattr(page, "report_html", broken)
    motion, report = tmp_path / "motion.npz", tmp_path / "report.html"
    write_capture(tmp_path / "take.npz", demo_capture(8))
    argv = ["solve", str(tmp_path / "take.npz"), "--out", str(motion), "--report", str(report), "--method", "frame"]
    assert main(argv) != 0
    assert "no page of this motion" in capsys.readouterr().err
    assert len(read_motion(motion).transl) == 8
    assert sorted(p.name for p in tmp_path.iterdir()) == ["motion.npz", "take.npz"]
