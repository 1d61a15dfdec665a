"""Captures and takes lie beside their .blend file, and go where it goes; nothing is lost on the way."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from blender_addon.animation.takes import PATHS, take_file, takes_of
from blender_addon.conventions.file_paths import file_of, sessions_folder
from blender_addon.ui import project_files
from blender_addon.ui.operators.import_results import take_motion
from tests.support.narrow_layout import NarrowContext
from tests.support.panel_layout import Layout
from tests.support.solved_capture import SolvedCapture


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the home of a user with a folder of documents."""
    folder = tmp_path / "home ü"
    (folder / "Documents").mkdir(parents=True)
    monkeypatch.setattr(Path, "home", lambda: folder)
    return folder


@pytest.fixture
def unsaved(mocap, solved_take: bpy.types.Action, home: Path, solved: SolvedCapture) -> bpy.types.Action:
    """Return a take of a scene that was never saved, with all its files in the session folder."""
    mocap.folder = ""
    folder = project_files.files_folder(bpy.context.scene) / "source_1a2b"
    shutil.copytree(solved.folder, folder)
    (folder / "source.npz").unlink()
    mocap.capture.file = str(folder / "capture.npz")
    for key in PATHS:
        solved_take[key] = str(folder / Path(solved_take[key]).name)
    return solved_take


def save(path: Path, **options: bool) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **options)


def reopened(path: Path) -> bpy.types.Action:
    """Open a file and return the take of its body."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.context.scene.mocap.review.take


def assert_works(take: bpy.types.Action, base: Path) -> None:
    """Check that every path is relative and leads to a file beside the .blend file, and that a range can be solved."""
    settings = bpy.context.scene.mocap
    for key in PATHS:
        assert take[key].startswith("//mocap/")
        assert take_file(take, key).is_file() and take_file(take, key).is_relative_to(base / "mocap")
    assert settings.capture.file.startswith("//mocap/") and settings.session == ""
    assert takes_of(settings.capture.file) == [take]
    assert bpy.ops.mocap.thin_take.poll() and bpy.ops.mocap.thin_take() == {"FINISHED"}


def test_an_unsaved_scene_works_in_a_named_folder_outside_the_extension(mocap, home) -> None:
    mocap.folder = ""
    scene = bpy.context.scene
    folder = project_files.files_folder(scene)
    assert folder.parent == home / "Documents" / "Manifold MoCap" == sessions_folder()
    assert folder.name.startswith("unsaved ") and project_files.files_folder(scene) == folder
    assert project_files.waits_for_saving(scene) == str(folder)
    mocap.folder = "//takes"  # means nothing yet
    assert project_files.files_folder(scene) == folder
    assert not folder.is_relative_to(bpy.utils.user_resource("DATAFILES"))


def test_a_saved_scene_works_beside_its_file(mocap, home, tmp_path) -> None:
    mocap.folder = ""
    save(tmp_path / "Szene ü.blend")
    assert project_files.files_folder(bpy.context.scene) == tmp_path / "mocap"


def test_saving_moves_everything_beside_the_file_and_later_takes_go_there(mocap, unsaved, home, tmp_path) -> None:
    session = Path(mocap.session)
    save(tmp_path / "shot" / "Szene ü.blend")
    assert_works(unsaved, tmp_path / "shot")
    assert not session.exists() and project_files.waits_for_saving(bpy.context.scene) == ""
    assert project_files.files_folder(bpy.context.scene) == tmp_path / "shot" / "mocap"
    mocap.solve.preset = "FAST"
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    assert mocap.review.take["motion_file"].startswith("//mocap/source_1a2b/take_02")


def test_undo_and_recovery_after_saving_find_the_files_that_moved(mocap, unsaved, tmp_path) -> None:
    """Both bring back what the scene said before it was saved."""
    before = unsaved["motion_file"]
    save(tmp_path / "shot" / "a.blend")
    assert not Path(before).exists()
    assert file_of(before) == take_file(unsaved, "motion_file")


@pytest.mark.slow
def test_a_moved_project_folder_keeps_working(mocap, unsaved, tmp_path) -> None:
    save(tmp_path / "shot" / "a.blend")
    (tmp_path / "shot").rename(tmp_path / "Umzug ü")
    take = reopened(tmp_path / "Umzug ü" / "a.blend")
    assert_works(take, tmp_path / "Umzug ü")
    review = bpy.context.scene.mocap.review
    review.first, review.last = 8, 20
    assert bpy.ops.mocap.resolve_range() == {"FINISHED"}
    again = bpy.context.scene.mocap.review.take
    assert again != take and take_file(again, "motion_file").is_relative_to(tmp_path / "Umzug ü")
    job = json.loads(take_file(again, "job_file").read_text("utf-8"))
    assert (job["capture"], job["resolve"]["motion"]) == ("capture.npz", "take_01.npz")
    bpy.context.view_layer.objects.active = bpy.context.scene.mocap.review.armature
    assert bpy.ops.mocap.export_take(filepath="//take.csv", format="csv") == {"FINISHED"}


def test_a_project_of_full_paths_may_move_too(mocap, unsaved, tmp_path) -> None:
    """Files saved by earlier versions kept full paths."""
    save(tmp_path / "shot" / "a.blend")
    unsaved["motion_file"] = str(take_file(unsaved, "motion_file"))
    (tmp_path / "shot").rename(tmp_path / "moved")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "moved" / "a.blend"))
    take = bpy.context.scene.mocap.review.take
    take["motion_file"] = str(tmp_path / "shot" / "mocap" / "source_1a2b" / "take_01.npz")
    assert take_file(take, "motion_file") == tmp_path / "moved" / "mocap" / "source_1a2b" / "take_01.npz"


def test_a_copied_project_is_independent(mocap, unsaved, tmp_path) -> None:
    save(tmp_path / "shot" / "a.blend")
    shutil.copytree(tmp_path / "shot", tmp_path / "copy")
    shutil.rmtree(tmp_path / "shot")
    assert_works(reopened(tmp_path / "copy" / "a.blend"), tmp_path / "copy")


def test_save_as_elsewhere_copies_what_is_referenced(mocap, unsaved, tmp_path) -> None:
    save(tmp_path / "shot" / "a.blend")
    files = {path.name for path in (tmp_path / "shot" / "mocap" / "source_1a2b").iterdir()}
    save(tmp_path / "other" / "b.blend")
    assert_works(bpy.context.scene.mocap.review.take, tmp_path / "other")
    assert {path.name for path in (tmp_path / "shot" / "mocap" / "source_1a2b").iterdir()} == files
    assert_works(reopened(tmp_path / "shot" / "a.blend"), tmp_path / "shot")
    save(tmp_path / "other" / "c.blend")
    assert [path.name for path in (tmp_path / "other" / "mocap").iterdir()] == ["source_1a2b"], "the same files"


def test_a_saved_copy_has_its_own_files_and_the_open_file_keeps_its_links(mocap, unsaved, tmp_path) -> None:
    save(tmp_path / "shot" / "a.blend")
    save(tmp_path / "other" / "copy.blend", copy=True)
    assert take_file(unsaved, "motion_file").is_relative_to(tmp_path / "shot")
    assert_works(reopened(tmp_path / "other" / "copy.blend"), tmp_path / "other")


def test_a_copy_of_an_unsaved_scene_leaves_the_session_folder(mocap, unsaved, tmp_path) -> None:
    session, motion = mocap.session, unsaved["motion_file"]
    save(tmp_path / "other" / "copy.blend", copy=True)
    assert mocap.session == session and unsaved["motion_file"] == motion and Path(motion).is_file()
    assert_works(reopened(tmp_path / "other" / "copy.blend"), tmp_path / "other")


def test_takes_of_another_file_are_never_overwritten(mocap, unsaved, tmp_path) -> None:
    theirs = tmp_path / "shot" / "mocap" / "source_1a2b" / "take_01.npz"
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes(b"theirs")
    save(tmp_path / "shot" / "a.blend")
    assert theirs.read_bytes() == b"theirs"
    assert unsaved["motion_file"] == "//mocap/source_1a2b_2/take_01.npz"
    assert_works(unsaved, tmp_path / "shot")


def test_a_folder_that_takes_nothing_leaves_everything_where_it_was(mocap, unsaved, tmp_path, monkeypatch) -> None:
    before = {key: unsaved[key] for key in PATHS}
    (tmp_path / "shot").mkdir()
    (tmp_path / "shot" / "mocap").touch()  # in the way
    save(tmp_path / "shot" / "a.blend")
    assert {key: unsaved[key] for key in PATHS} == before and all(Path(path).is_file() for path in before.values())
    assert "were not moved" in project_files.following.failure
    (tmp_path / "shot" / "mocap").unlink()
    save(tmp_path / "shot" / "a.blend")
    assert project_files.following.failure == ""
    assert_works(unsaved, tmp_path / "shot")


def test_half_a_copy_is_taken_back(mocap, unsaved, tmp_path, monkeypatch) -> None:
    before, copy = {key: unsaved[key] for key in PATHS}, project_files._copy

    def full(old: Path, new: Path) -> None:
        if old.suffix == ".json":
            raise OSError(28, "No space left on device")
        copy(old, new)

    monkeypatch.setattr(project_files, "_copy", full)
    save(tmp_path / "shot" / "a.blend")
    assert "No space left" in project_files.following.failure
    assert {key: unsaved[key] for key in PATHS} == before
    assert not [path for path in (tmp_path / "shot").rglob("*") if path.suffix != ".blend" and path.is_file()]


def test_a_file_that_cannot_be_written_takes_everything_back(mocap, unsaved, tmp_path) -> None:
    before = {key: unsaved[key] for key in PATHS}
    blocked = tmp_path / "shot" / "a.blend@"
    blocked.mkdir(parents=True)  # Blender's temporary file
    with pytest.raises(RuntimeError):
        save(tmp_path / "shot" / "a.blend")
    assert {key: unsaved[key] for key in PATHS} == before and all(Path(path).is_file() for path in before.values())
    assert not [path for path in (tmp_path / "shot").rglob("*") if path.is_file()]


def test_a_take_that_arrives_after_saving_comes_home(mocap, unsaved, solved, tmp_path, monkeypatch) -> None:
    """The solve was started in the session folder, whose files stay while the solver may read them."""
    session = Path(mocap.session)
    monkeypatch.setattr(project_files.following, "solver_reads", True)
    save(tmp_path / "shot" / "a.blend")
    assert (session / "source_1a2b" / "capture.npz").is_file()
    shutil.copytree(solved.folder, session / "late")
    (session / "late" / "source.npz").unlink()
    monkeypatch.setattr(project_files.following, "solver_reads", False)
    late = SolvedCapture(session / "late", solved.read)
    take = take_motion(bpy.context, late.files)
    assert take["motion_file"] == "//mocap/late/take_01.npz" and take_file(take, "motion_file").is_file()
    assert not (session / "late").exists()


def test_footage_is_linked_relative_to_the_file(mocap, unsaved, tmp_path) -> None:
    from blender_addon.scene.cameras import Footage, _load

    save(tmp_path / "shot" / "a.blend")
    image = bpy.data.images.new("picture", 4, 4)
    image.filepath_raw, image.file_format = str(tmp_path / "shot" / "footage" / "0001.png"), "PNG"
    image.save()
    bpy.data.images.remove(image)
    found = _load(Footage((tmp_path / "shot" / "footage" / "0001.png",)))
    assert found is not None and found.filepath == "//footage/0001.png"


def test_files_that_were_moved_are_linked_again_and_others_are_left(mocap, unsaved, tmp_path) -> None:
    save(tmp_path / "shot" / "a.blend")
    old, new = tmp_path / "shot" / "mocap" / "source_1a2b", tmp_path / "archive" / "2026" / "source_1a2b"
    shutil.move(old, new)
    decoy = tmp_path / "archive" / "other_capture"
    shutil.copytree(new, decoy)
    gone = {file_of(link.text) for link in project_files.missing_links()}
    assert gone == {old / "capture.npz", *(old / Path(unsaved[key]).name for key in PATHS)}
    layout = Layout()
    bpy.types.VIEW3D_PT_mocap_run.draw(SimpleNamespace(layout=layout), NarrowContext(400))
    assert any("was moved or deleted" in text for text in layout.drawn)
    assert bpy.ops.mocap.relink_files(directory=str(tmp_path / "home ü")) == {"CANCELLED"}
    assert bpy.ops.mocap.relink_files(directory=str(tmp_path / "archive")) == {"FINISHED"}
    assert file_of(mocap.capture.file) == new / "capture.npz" and not project_files.missing_links()
    assert all(take_file(unsaved, key).parent == new for key in PATHS)
    assert takes_of(mocap.capture.file) == [unsaved] and bpy.ops.mocap.thin_take() == {"FINISHED"}
    shutil.move(new, tmp_path / "archive" / "renamed")
    shutil.copytree(tmp_path / "archive" / "renamed", tmp_path / "twice" / "a" / "source_1a2b")
    shutil.copytree(tmp_path / "archive" / "renamed", tmp_path / "twice" / "b" / "source_1a2b")
    assert bpy.ops.mocap.relink_files(directory=str(tmp_path / "twice")) == {"CANCELLED"}, "two are as likely"
    named = tmp_path / "archive" / "renamed"
    assert bpy.ops.mocap.relink_files(directory=str(named)) == {"FINISHED"}, "the folder itself may have any name"


def test_files_of_one_name_are_not_exchanged(solved_take, mocap, tmp_path) -> None:
    """Two takes with files of the same name: the one that is gone does not get the other's file."""
    for folder in ("A", "B"):
        (tmp_path / folder / "mocap").mkdir(parents=True)
        shutil.copy(take_file(solved_take, "motion_file"), tmp_path / folder / "mocap" / "take_01.npz")
    second = solved_take.copy()
    for take, folder in ((solved_take, "A"), (second, "B")):
        take["motion_file"] = str(tmp_path / folder / "mocap" / "take_01.npz")
    shutil.move(tmp_path / "A", tmp_path / "moved")
    shutil.rmtree(tmp_path / "B")
    lost = [tmp_path / folder / "mocap" / "take_01.npz" for folder in ("A", "B")]
    assert project_files.relink(tmp_path / "moved") == (0, lost), "either may be the one"
    (tmp_path / "disk").mkdir()
    shutil.move(tmp_path / "moved", tmp_path / "disk" / "A")
    assert project_files.relink(tmp_path / "disk") == (1, lost[1:])
    assert project_files.relink(tmp_path / "disk") == (0, lost[1:]), "another take has this file"
    assert take_file(solved_take, "motion_file") == tmp_path / "disk" / "A" / "mocap" / "take_01.npz"
