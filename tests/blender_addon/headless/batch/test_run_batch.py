"""A folder of captures: resumed, sorted by the worst take, and not stopped by one that fails."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from blender_addon._exchange.errors import Cancelled
from blender_addon._exchange.progress import silent
from blender_addon.errors import BatchInvalid, SolverStopped
from blender_addon.headless import bake
from blender_addon.headless.batch import takes
from blender_addon.headless.batch.record import fingerprint
from blender_addon.headless.batch.request import BatchRequest
from blender_addon.headless.batch.run_batch import run_batch
from blender_addon.headless.batch.summary import table, worst_first
from blender_addon.headless.main import main
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture

ROOT = Path(__file__).resolve().parents[4]


class Solver:
    """Stands in for the solver: copies the capture, counts what it was asked for, and fails where it is told to."""

    def __init__(self, residuals: dict[str, float]) -> None:
        self.residuals, self.solved, self.jobs = residuals, [], []

    def __call__(self, verb: str, given: list[str], *_progress: Any, **_: Any) -> dict[str, Any]:
        if verb == "convert":
            self.reading = given[4:]
            Path(given[2]).write_bytes(Path(given[0]).read_bytes() if Path(given[0]).is_file() else b"")
            return {"event": "result"}
        if verb == "markers export":
            Path(given[2]).parent.mkdir(exist_ok=True)
            Path(given[2]).write_bytes(Path(given[0]).read_bytes())
            return {"event": "result"}
        job_file = Path(given[1])
        job = json.loads(job_file.read_text(encoding="utf-8"))
        name = job_file.name.removesuffix(".job.json")
        self.solved.append(name)
        self.jobs.append(job)
        if name not in self.residuals:
            raise SolverStopped({"code": "too_few_views", "message": "One camera.", "where": "", "hint": ""}, 3)
        for key in ("out", "report"):
            (job_file.parent / job[key]).write_bytes(b"x")
        residual = "marker_median_mm" if "markers" in name else "reprojection_median_px"
        figures = {
            "frames": 100,
            residual: self.residuals[name],
            "unsure_frames": 3,
            "unseen_frames": 0,
        }
        return {"event": "result", "motion": job["out"], "diagnostics": [], **figures}


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    folder = tmp_path / "captures ü"
    (folder / "a folder").mkdir(parents=True)
    (folder / "a folder" / "frame.json").write_text("{}")
    for name in ("good.npz", "worst.npz", "broken.npz"):
        (folder / name).write_bytes(name.encode())
    (folder / "readme.txt").write_text("no capture")
    (folder / ".hidden").mkdir()
    return folder


@pytest.fixture
def solver(monkeypatch: pytest.MonkeyPatch) -> Solver:
    solver = Solver({"good": 1.5, "worst": 9.0, "a folder": 3.0})
    monkeypatch.setattr(takes, "run_solver", solver)
    return solver


def test_the_worst_comes_first_and_one_failure_stops_nobody(captures: Path, solver: Solver, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run_batch(BatchRequest(captures, out), silent)
    assert solver.solved == ["a folder", "broken", "good", "worst"]
    assert [(take["take"], take["status"]) for take in result["takes"]] == [
        ("broken", "failed"), ("worst", "done"), ("a folder", "done"), ("good", "done"),
    ]  # fmt: skip
    assert result["exit_code"] == 3 and result["takes"][0]["error"]["code"] == "too_few_views"
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == result["takes"]
    lines = (out / "summary.txt").read_text(encoding="utf-8").splitlines()
    assert [line.split("  ")[0] for line in lines] == ["take", "broken", "worst", "a folder", "good"]
    assert lines[1].endswith("One camera.") and "9.00" in lines[2]
    assert sorted(p.name for p in (out / "good").iterdir()) == [
        "good.html", "good.job.json", "good.npz", "good_capture.npz", "take.json",
    ]  # fmt: skip


def test_a_strict_batch_has_strict_jobs_and_solves_again_what_was_not(
    captures: Path, solver: Solver, tmp_path: Path
) -> None:
    run_batch(BatchRequest(captures, tmp_path / "out"), silent)
    run_batch(BatchRequest(captures, tmp_path / "out", strict=True), silent)
    assert [job.get("strict", False) for job in solver.jobs] == [False] * 4 + [True] * 4


def test_recordings_of_markers_are_captures_and_their_markers_are_exported(
    captures: Path, solver: Solver, tmp_path: Path
) -> None:
    for name in ("markers a.c3d", "markers b.TRC", "markers c.csv"):
        (captures / name).write_bytes(b"x")
    solver.residuals |= {"markers a": 4.25, "markers b": 11.0, "markers c": 2.0}
    out, job = tmp_path / "out", tmp_path / "job.json"
    job.write_text('{"subject_prefix": "Anna"}')
    result = run_batch(BatchRequest(captures, out, job, marker_formats=("c3d", "trc")), silent)
    takes = {take["take"]: take for take in result["takes"]}
    assert solver.reading == ["--subject-prefix=Anna"]
    assert [Path(path).name for path in takes["markers a"]["outputs"][-2:]] == ["markers a.c3d", "markers a.trc"]
    assert not (out / "good" / "export").exists(), "a take of keypoints has no markers"
    rows = {line.split("  ")[0]: line for line in result["table"].splitlines()}
    assert "4.25 mm" in rows["markers a"] and "1.50 px" in rows["good"]
    solver.solved.clear()
    again = run_batch(BatchRequest(captures, out, job, marker_formats=("trc",)), silent)
    assert "markers a" not in solver.solved, "other wanted outputs are made of the same solve"
    outputs = {take["take"]: take.get("outputs") for take in again["takes"]}["markers a"]
    assert [Path(path).name for path in outputs] == [
        "markers a_capture.npz", "markers a.job.json", "markers a.npz", "markers a.html", "markers a.trc",
    ]  # fmt: skip


def test_done_takes_are_skipped_until_something_changes(captures: Path, solver: Solver, tmp_path: Path) -> None:
    job = BatchRequest(captures, tmp_path / "out")
    run_batch(job, silent)
    solver.solved.clear()
    again = run_batch(job, silent)
    assert solver.solved == ["broken"], "what failed is tried again"
    assert {t["take"]: t["status"] for t in again["takes"]} == {
        "broken": "failed", "worst": "skipped", "a folder": "skipped", "good": "skipped",
    }  # fmt: skip
    assert again["takes"][1]["solve"]["reprojection_median_px"] == 9.0, "skipped takes keep their figures"
    (captures / "a folder" / "frame.json").write_text("{ }")
    os.utime(captures / "good.npz", ns=(1, 1))
    (tmp_path / "out" / "worst" / "worst.npz").unlink()
    solver.solved.clear()
    run_batch(job, silent)
    assert solver.solved == ["a folder", "broken", "good", "worst"]
    template = tmp_path / "job.json"
    template.write_text('{"fps": 50, "trim": true, "settings": {"window": 12}}')
    solver.solved.clear()
    run_batch(BatchRequest(captures, tmp_path / "out", template), silent)
    assert len(solver.solved) == 4, "other settings make other takes"
    assert solver.reading == ["--fps=50", "--trim"] and solver.jobs[-1]["settings"] == {"window": 12}


def test_a_new_version_solves_again(captures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = fingerprint(captures / "good.npz", {})
    assert fingerprint(captures / "good.npz", {}) == before
    monkeypatch.setattr("blender_addon.headless.batch.record.VERSION", "99.0")
    assert fingerprint(captures / "good.npz", {}) != before


def test_files_that_are_not_ours_are_left_alone(captures: Path, solver: Solver, tmp_path: Path) -> None:
    mine = tmp_path / "out" / "good" / "good.npz"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    result = run_batch(BatchRequest(captures, tmp_path / "out"), silent)
    assert {t["take"]: t.get("error", {}).get("code") for t in result["takes"]}["good"] == "output_exists"
    assert mine.read_text() == "mine" and [p.name for p in mine.parent.iterdir()] == ["good.npz"]


def test_what_a_killed_batch_left_blocks_no_take(captures: Path, solver: Solver, tmp_path: Path) -> None:
    folder = tmp_path / "out" / "good"
    folder.mkdir(parents=True)
    for name in (".probe-0123456789abcdef", ".part-0123456789abcdef", ".part-0123456789abcdef_take.json"):
        (folder / name).touch()
        os.utime(folder / name, ns=(1, 1))
    result = run_batch(BatchRequest(captures, tmp_path / "out"), silent)
    assert {t["take"]: t["status"] for t in result["takes"]}["good"] == "done"
    assert not [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_cancelling_keeps_what_is_done(captures: Path, solver: Solver, tmp_path: Path) -> None:
    def interrupted(verb: str, given: list[str], **more: Any) -> dict[str, Any]:
        if verb == "solve" and "good" in given[1]:
            raise Cancelled("The work was cancelled.")
        return solver(verb, given, **more)

    takes.run_solver = interrupted  # undone with the fixture
    with pytest.raises(Cancelled):
        run_batch(BatchRequest(captures, tmp_path / "out"), silent)
    takes.run_solver = solver
    solver.solved.clear()
    run_batch(BatchRequest(captures, tmp_path / "out"), silent)
    assert solver.solved == ["broken", "good", "worst"]


def test_what_breaks_unforeseen_is_one_takes_failure(
    captures: Path, solver: Solver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run_batch(BatchRequest(captures, tmp_path / "out", bake=True), silent)
    assert {take["status"] for take in result["takes"]} == {"failed"}, "the stand-in's motions cannot be baked"
    monkeypatch.setattr(bake, "run_bake", lambda *_: 1 / 0)
    result = run_batch(BatchRequest(captures, tmp_path / "out", bake=True), silent)
    assert result["exit_code"] == 4
    assert result["takes"][0]["error"]["message"] == "ZeroDivisionError: division by zero"


def test_of_a_hundred_takes_twenty_bad_ones_stop_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    names = [f"take{number:03}" for number in range(100)]
    for name in names:
        (folder / f"{name}.npz").write_bytes(name.encode())
    solver = Solver({name: 2.0 for number, name in enumerate(names) if number % 5})
    monkeypatch.setattr(takes, "run_solver", solver)
    result = run_batch(BatchRequest(folder, tmp_path / "out"), silent)
    bad = {take["take"] for take in result["takes"] if take["status"] == "failed"}
    assert bad == set(names[::5]) and len(solver.solved) == 100 and result["exit_code"] == 3
    assert {take["error"]["code"] for take in result["takes"] if take["take"] in bad} == {"too_few_views"}
    again = run_batch(BatchRequest(folder, tmp_path / "out"), silent)
    assert sorted(solver.solved[100:]) == sorted(bad)
    assert sum(take["status"] == "skipped" for take in again["takes"]) == 80


def test_permission_that_is_lost_midway_is_one_takes_failure(
    captures: Path, solver: Solver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace, link = os.replace, os.link

    def refuse(keep: Any) -> Any:
        def kept(source: Any, target: Any, **options: Any) -> None:
            if "worst" in str(target) and "worst" in solver.solved:
                raise PermissionError(13, "Permission denied", str(target))
            keep(source, target, **options)

        return kept

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refuse(replace))
        patch.setattr(os, "link", refuse(link))
        result = run_batch(BatchRequest(captures, tmp_path / "out"), silent)
    lost = {take["take"]: take for take in result["takes"]}
    assert lost["worst"]["status"] == "failed" and "Permission denied" in lost["worst"]["error"]["message"]
    assert lost["good"]["status"] == "done"
    again = run_batch(BatchRequest(captures, tmp_path / "out"), silent)
    assert {take["take"]: take["status"] for take in again["takes"]}["worst"] == "done"


def test_wrong_batches_are_named(captures: Path, solver: Solver, tmp_path: Path) -> None:
    with pytest.raises(BatchInvalid, match="There is no such folder"):
        run_batch(BatchRequest(tmp_path / "gone", tmp_path / "out"), silent)
    with pytest.raises(BatchInvalid, match="contains no captures"):
        run_batch(BatchRequest(captures / "a folder", tmp_path / "out"), silent)
    (captures / "good").mkdir()
    with pytest.raises(BatchInvalid, match="Several captures have the same name: good"):
        run_batch(BatchRequest(captures, tmp_path / "out"), silent)
    (tmp_path / "job.json").write_text('{"camera": "hall=cam01"}')
    with pytest.raises(BatchInvalid, match=r"camera is 'hall=cam01', but a list of RECORDED=CALIBRATED is expected"):
        run_batch(BatchRequest(captures, tmp_path / "out", tmp_path / "job.json"), silent)
    (tmp_path / "job.json").write_text('{"capture": "x"}')
    with pytest.raises(BatchInvalid, match="cannot contain capture"):
        run_batch(BatchRequest(captures, tmp_path / "out", tmp_path / "job.json"), silent)
    for wrong, message in (
        ('{"settings": [1]}', "must be an object with settings"), ('{"settings": {"accept": "x"}}', "list of codes"),
        ('{"strict": 5}', "strict must be true or false"),
    ):  # fmt: skip
        (tmp_path / "job.json").write_text(wrong)
        with pytest.raises(BatchInvalid, match=message):
            run_batch(BatchRequest(captures, tmp_path / "out", tmp_path / "job.json"), silent)
    (tmp_path / "job.json").write_text("{")
    with pytest.raises(BatchInvalid, match="cannot be read"):
        run_batch(BatchRequest(captures, tmp_path / "out", tmp_path / "job.json"), silent)


def test_table_of_takes_without_figures() -> None:
    takes = [{"take": "b", "status": "done"}, {"take": "a", "status": "failed", "error": {"message": "oh"}}]
    assert [take["take"] for take in worst_first(takes)] == ["a", "b"]
    assert table(worst_first(takes)).splitlines()[1].endswith("oh")


@pytest.mark.slow
def test_a_real_batch_solves_bakes_and_exports(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    captures, out = tmp_path / "Aufnahmen ü", tmp_path / "out put"
    captures.mkdir()
    write_capture(captures / "ein Gang.npz", demo_capture(24))
    (captures / "damaged.npz").write_bytes(b"PK")
    (tmp_path / "job.json").write_text('{"version": 1, "settings": {"window": 12}}')
    command = ["batch", str(captures), "--out", str(out), "--job", str(tmp_path / "job.json"), "--bake",
               "--export", "bvh", "csv", "--json"]  # fmt: skip
    assert main(command) == 3
    shown = capfd.readouterr().out.splitlines()
    assert all(line.startswith("{") for line in shown), [x for x in shown if x[:1] != "{"]
    lines = [json.loads(line) for line in shown]
    assert {line["event"] for line in lines[:-1]} == {"progress"} and lines[-1]["event"] == "result"
    failed, done = lines[-1]["takes"]
    assert failed["error"]["code"] == "file_damaged" and done["status"] == "done"
    assert sorted(p.relative_to(out / "ein Gang").as_posix() for p in (out / "ein Gang").rglob("*") if p.is_file()) == [
        "ein Gang.blend", "ein Gang.html", "ein Gang.job.json", "ein Gang.npz", "ein Gang_capture.npz",
        "export/ein Gang.bvh", "export/ein Gang.csv", "take.json",
    ]  # fmt: skip
    again = subprocess.run(
        [sys.executable, "-m", "blender_addon", *command[:-1]],
        cwd=ROOT,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert again.returncode == 3
    assert "ein Gang  skipped" in again.stderr and again.stdout.splitlines() == [
        str(out / "summary.json"), str(out / "summary.txt"), str(out / "summary.html"),
    ]  # fmt: skip


@pytest.mark.slow
def test_a_session_of_trials_is_one_batch_of_everybody(shared_data: Path, tmp_path: Path) -> None:
    session = shared_data / "multiview" / "pose2sim_session"
    job = tmp_path / "job.json"
    job.write_text(json.dumps({"person": "all", "settings": {"iterations": 2}}))
    result = run_batch(BatchRequest(session, tmp_path / "out", job), silent)
    assert [take["status"] for take in result["takes"]] == ["done"] * 3
    motions = sorted(Path(p).name for take in result["takes"] for p in take["outputs"] if p.endswith(".npz"))
    assert [name for name in motions if "person" in name] == [
        f"S00_P01_T02_Participants1-2_person_{n}.npz" for n in (1, 2, 3)
    ]
    everybody = [name for take in result["takes"] for name in take["people"]]
    assert sorted(filter(None, everybody)) == ["Person 1", "Person 2", "Person 3"]
