"""Several captures in one scene: panels and operators are about the one the active object belongs to."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

import bpy
import pytest

from blender_addon.ui.operators.import_results import take_capture, take_motion
from blender_addon.ui.scene_job import prepare_job
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.synthesis.embedded.demo import record_markers
from tests.support.kept_scenes import KeptScene, registered

FRAMES = 40


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_c3d(tmp_path_factory.mktemp("zweite") / "walk.c3d", record_markers(FRAMES).cloud)


@pytest.fixture(scope="module")
def kept_solve(
    kept_solve: KeptScene[bpy.types.Action], recording: Path, tmp_path_factory: pytest.TempPathFactory
) -> KeptScene[bpy.types.Action]:
    """Import a recording of markers beside the solved capture of cameras, once."""
    folder = tmp_path_factory.mktemp("kept")

    def imported(_: bpy.types.Scene) -> bpy.types.Action:
        scene = kept_solve.opened()
        with registered():
            scene.mocap.folder = str(folder)
            assert bpy.ops.mocap.import_capture(filepath=str(recording)) == {"FINISHED"}
            return kept_solve.found()

    return KeptScene(folder / "both.blend", imported)


@pytest.fixture
def both(solved_take: bpy.types.Action, mocap: bpy.types.PropertyGroup) -> bpy.types.PropertyGroup:
    """Return a scene with a solved capture of cameras and, imported after it, a recording of markers."""
    mocap.folder = str(Path(mocap.capture.file).parents[1])  # where it was imported
    return mocap


def activate(obj: bpy.types.Object) -> None:
    bpy.context.view_layer.objects.active = obj


def test_a_second_import_is_shown_and_hides_nothing_of_the_first(both, solved_take):
    assert [capture.name for capture in both.captures] == ["demo", "walk"]
    assert both.capture_index == 1 and both.review.take is None and both.capture.markers == 42
    first = both.captures[0]
    assert first.review.take == solved_take and (first.review.first, first.review.last) == (1, 30)
    body = first.review.armature
    activate(both.capture.cloud)
    activate(body)
    assert both.capture_index == 0 and both.review.take == solved_take and len(both.capture.cameras) == 4
    assert bpy.ops.mocap.next_bad_range.poll() and bpy.ops.mocap.select_body.poll()
    (skin,) = (obj for obj in body.children if obj.type == "MESH" and obj.find_armature() == body)
    for obj, index in ((both.captures[1].cloud, 1), (skin, 0), (first.cameras[2].object, 0), (first.floor, 0)):
        activate(obj)
        assert both.capture_index == index, obj.name


def test_an_object_of_nobodys_leaves_the_panels_where_they_were(both, scene):
    cube = bpy.data.objects.new("cube", None)
    scene.collection.objects.link(cube)
    activate(cube)
    assert both.capture_index == 1
    activate(None)
    assert both.capture_index == 1
    assert bpy.ops.mocap.show_capture(index=0) == {"FINISHED"} and both.capture_index == 0
    activate(both.captures[1].cloud)
    assert both.capture_index == 1
    assert bpy.ops.mocap.show_capture(index=0) == {"FINISHED"}
    assert both.capture_index == 0, "chosen by hand after that object was made active"


def test_the_result_of_a_network_stays_with_its_capture_of_one_camera(both, scene, tmp_path):
    first, second = both.captures
    result = tmp_path / "hmr4d_results.pt"
    result.touch()
    first.network = str(result)
    assert prepare_job(scene, None, first)[0].start_from == (), "four cameras see the person"
    while len(first.cameras) > 1:
        first.cameras.remove(1)
    assert prepare_job(scene, None, first)[0].start_from == (str(result),)
    assert prepare_job(scene, None, second)[0].start_from == ()


def test_a_run_ends_in_the_capture_it_was_started_for(both, solved, monkeypatch):
    assert bpy.ops.mocap.show_capture(index=0) == {"FINISHED"}
    taken: list[bpy.types.Action] = []

    def arrive(context: bpy.types.Context, *_: object, **__: object) -> bpy.types.Action:
        taken.append(take_motion(context, solved.files))
        return taken[0]

    class Run:
        result = MappingProxyType({"event": "result", "unseen_frames": 0, "unsure_frames": 0, "solve_s": 1.0})
        error, finished, headline, share = None, True, "", 1.0

        class process:
            wait = kill = staticmethod(lambda: None)

    def started(*_: object) -> Run:
        activate(both.captures[1].cloud)  # the user goes on to the other capture
        return Run()

    monkeypatch.setattr("blender_addon.solving.run.start", started)
    monkeypatch.setattr("blender_addon.ui.operators.import_results.take_motion", arrive)
    body = both.captures[0].review.armature
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    assert both.captures[0].review.take == taken[0] and both.captures[0].review.armature == body
    assert both.captures[1].review.armature is None and both.held == -1 and both.capture_index == 1


def test_reading_one_again_replaces_it_alone(both, recording, solved):
    names = sorted(obj.name for obj in bpy.data.objects)
    assert bpy.ops.mocap.import_capture(filepath=str(recording)) == {"FINISHED"}
    assert len(both.captures) == 2 and sorted(obj.name for obj in bpy.data.objects) == names
    take_capture(bpy.context.scene, solved.read)
    assert both.capture_index == 0 and both.review.take is not None and len(both.captures) == 2


def test_everything_follows_another_frame_rate(both, scene, solved_take):
    scene.render.fps = 30
    assert bpy.ops.mocap.follow_rate() == {"FINISHED"}
    assert solved_take.frame_range[1] == pytest.approx(15.5)
    assert [capture.review.last for capture in both.captures] == [16, 20]


def test_files_of_every_capture_follow_the_blend_file(both, tmp_path):
    both.folder = ""
    project = tmp_path / "project" / "shot.blend"
    project.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(project))
    assert [Path(bpy.path.abspath(capture.file)).is_file() for capture in both.captures] == [True, True]
    assert all(capture.file.startswith("//") for capture in both.captures)
