"""What goes wrong around a solve: one sentence, nothing half-written, no lost work."""

from __future__ import annotations

import errno
import os
import shutil
import signal
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from blender_addon.solving.child import SolverProcess
from blender_addon.solving.run import Run, start
from blender_addon.ui import project_files
from blender_addon.ui.operators import review
from blender_addon.ui.operators.base import current
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.full_disk import full_disk
from tests.support.solved_capture import SolvedCapture


def written(folder: Path) -> dict[str, int]:
    """Return the files below a folder, hidden ones included, with their sizes."""
    return {p.relative_to(folder).as_posix(): p.stat().st_size for p in folder.rglob("*") if p.is_file()}


@pytest.mark.slow
def test_a_full_disk_keeps_the_capture_that_was_read_before(mocap, solved: SolvedCapture, tmp_path: Path) -> None:
    assert bpy.ops.mocap.import_capture(filepath=str(solved.folder / "source.npz")) == {"FINISHED"}
    before, objects = written(tmp_path), len(bpy.data.objects)
    with full_disk(10_000), pytest.raises(RuntimeError, match=r"output cannot be written: File too large.*free space"):
        bpy.ops.mocap.import_capture(filepath=str(solved.folder / "source.npz"))
    assert written(tmp_path) == before and len(bpy.data.objects) == objects
    assert Path(mocap.capture.file).is_file() and not current.busy


@pytest.mark.slow
def test_a_full_disk_during_a_solve_leaves_earlier_takes_and_no_half_motion(
    mocap, solved_take, solved: SolvedCapture
) -> None:
    before, actions = written(solved.folder), [action.name for action in bpy.data.actions]
    with full_disk(12_000), pytest.raises(RuntimeError, match=r"output cannot be written: File too large.*free space"):
        bpy.ops.mocap.solve()
    new = written(solved.folder).keys() - before.keys()
    assert {Path(name).suffixes[-1] for name in new} == {".json"}, "the job alone, to be solved again"
    assert [action.name for action in bpy.data.actions] == actions
    assert mocap.review.take == solved_take and current.last.error["code"] == "output_not_writable"
    assert bpy.ops.mocap.solve() == {"FINISHED"} and mocap.review.take != solved_take


@pytest.mark.slow
def test_a_motion_is_not_lost_when_its_report_cannot_be_written(mocap, tmp_path: Path) -> None:
    write_capture(tmp_path / "short.npz", demo_capture(8))
    assert bpy.ops.mocap.import_capture(filepath=str(tmp_path / "short.npz")) == {"FINISHED"}
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    first = mocap.review.take
    motion, report = (Path(first[key]).stat().st_size for key in ("motion_file", "report_file"))
    assert motion < 0.9 * report, "a limit fits between them"
    with full_disk((motion + report) // 2):
        assert bpy.ops.mocap.solve() == {"FINISHED"}
    take = mocap.review.take
    assert take != first and Path(take["motion_file"]).is_file() and take["report_file"] == ""
    assert "File too large" in current.last.error["message"]
    with pytest.raises(RuntimeError, match=r"This take has no report.*Solve again with Report enabled"):
        bpy.ops.mocap.open_report()


def test_a_full_disk_is_said_before_the_job_is_written(mocap, solved_take, solved: SolvedCapture) -> None:
    before = written(solved.folder)
    mocap.folder = str(solved.folder)
    with (
        full_disk(100),
        pytest.raises(RuntimeError, match=r"The folder for takes cannot be written to: File too large"),
    ):
        bpy.ops.mocap.solve()
    assert written(solved.folder) == before


@pytest.mark.slow
def test_takes_of_a_capture_in_a_read_only_folder_go_where_new_captures_go(
    mocap, solved_take, solved: SolvedCapture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    before = written(solved.folder)

    def probe(folder: Path) -> None:
        if folder.is_relative_to(solved.folder):
            raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(project_files, "probe", probe)
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    assert Path(mocap.review.take["motion_file"]).is_relative_to(tmp_path / "Aufnahmen ü")
    assert written(solved.folder) == before
    mocap.folder = str(solved.folder)
    with pytest.raises(RuntimeError, match=r"Read-only file system.*choose another folder under Advanced"):
        bpy.ops.mocap.solve()


@pytest.mark.slow
def test_a_capture_folder_may_move_after_the_import(mocap, solved: SolvedCapture, tmp_path: Path) -> None:
    """Everything a solve needs was copied; reading it again says that it is gone and keeps what is there."""
    source = tmp_path / "Quelle ü" / "source.npz"
    source.parent.mkdir()
    shutil.copy(solved.folder / "source.npz", source)
    assert bpy.ops.mocap.import_capture(filepath=str(source)) == {"FINISHED"}
    source.parent.rename(tmp_path / "moved")
    with pytest.raises(RuntimeError, match=r"There is no such file or folder.*source\.npz"):
        bpy.ops.mocap.import_capture(filepath=mocap.capture.source)
    assert mocap.capture.frames == 30 and len(mocap.capture.cameras) == 4
    assert bpy.ops.mocap.solve() == {"FINISHED"} and mocap.review.take["frames"] == 30


@pytest.mark.skipif(os.name == "nt", reason="processes are killed differently there")
def test_a_solver_that_is_killed_leaves_the_scene_and_says_so(mocap, solved_take, monkeypatch) -> None:
    def started(verb: str, arguments: list[str], python: Path | None, folder: Path) -> Run:
        run = start(verb, arguments, python, folder)
        os.kill(run.process.pid, signal.SIGKILL)
        return run

    monkeypatch.setattr("blender_addon.solving.run.start", started)
    with pytest.raises(
        RuntimeError, match=r"The solver stopped without a result.*signal 9.*earlier takes are untouched"
    ):
        bpy.ops.mocap.solve()
    assert mocap.review.take == solved_take and not current.busy


@pytest.mark.slow
def test_a_take_arrives_in_the_scene_it_was_solved_for(
    mocap, solved: SolvedCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bpy.ops.mocap.import_capture(filepath=str(solved.folder / "source.npz")) == {"FINISHED"}
    scene, other = bpy.context.scene, bpy.data.scenes.new("another")

    def wait(process: SolverProcess) -> int:
        bpy.context.window.scene = other
        return waited(process)

    waited = SolverProcess.wait
    monkeypatch.setattr(SolverProcess, "wait", wait)
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    assert bpy.context.window.scene == other and other.mocap.review.armature is None and not other.objects
    assert scene.mocap.review.armature.name in scene.objects and scene.mocap.review.take["frames"] == 30


def test_open_report_opens_what_a_solve_wrote_and_nothing_else(
    mocap, solved_take, solved: SolvedCapture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    opened: list[str] = []

    def path_open(filepath: str) -> set[str]:
        opened.append(filepath)
        return {"FINISHED"}

    monkeypatch.setattr(review, "bpy", SimpleNamespace(ops=SimpleNamespace(wm=SimpleNamespace(path_open=path_open))))
    report = Path(solved_take["report_file"])
    assert bpy.ops.mocap.open_report() == {"FINISHED"} and opened == [str(report)]
    (solved.folder / "page.html").write_text("<script>alert(1)</script>")
    (solved.folder / "run.sh").write_bytes(report.read_bytes())
    shutil.copyfile(report, tmp_path / "elsewhere.html")
    (solved.folder / "link.html").symlink_to(tmp_path / "elsewhere.html")
    for path in (*(solved.folder / name for name in ("page.html", "run.sh", "link.html")), tmp_path / "elsewhere.html"):
        solved_take["report_file"] = str(path)
        with pytest.raises(RuntimeError, match="This file is not a solver report"):
            bpy.ops.mocap.open_report()
    assert len(opened) == 1
