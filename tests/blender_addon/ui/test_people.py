"""Several people in one capture: listed, renamed, solved together, and reviewed each by their own body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import pytest

from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from tests.support.narrow_layout import draw_panel

SESSION = Path("multiview", "pose2sim_session")
PAIR = SESSION / "S00_P01_MultiParticipants" / "S00_P01_T02_Participants1-2"


@pytest.fixture(scope="module")
def pair(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a capture file with the first twelve frames of the two people of the recording who are in four views."""
    whole = load_capture(shared_data / PAIR)
    assert whole.keypoints is not None
    people = tuple(replace(p, keypoints=p.keypoints.frames(0, 12)) for p in whole.people[:2])
    cut = replace(whole, keypoints=whole.keypoints.frames(0, 12), people=people)
    return write_capture(tmp_path_factory.mktemp("zu zweit") / "pair.npz", cut)


@pytest.fixture
def imported(mocap: bpy.types.PropertyGroup, pair: Path) -> bpy.types.PropertyGroup:
    assert bpy.ops.mocap.import_capture(filepath=str(pair)) == {"FINISHED"}
    mocap.solve.preset, mocap.solve.report = "FAST", False
    return mocap


def activate(obj: bpy.types.Object) -> None:
    bpy.context.view_layer.objects.active = obj


@pytest.mark.slow
def test_everybody_is_solved_and_each_body_has_its_own_review(imported) -> None:
    capture = imported.capture
    assert [(p.name, p.frames) for p in capture.people] == [("Person 1", 12), ("Person 2", 12)]
    capture.people[1].name = "Björn"
    assert bpy.ops.mocap.solve_all() == {"FINISHED"}
    first, second = (review.armature for review in capture.reviews)
    assert first != second and "Björn" in second.name and "Björn" in capture.reviews[1].take.name
    apart = (first.pose.bones["pelvis"].matrix.translation - second.pose.bones["pelvis"].matrix.translation).length
    assert apart > 0.8
    # Panels and operators follow the body that is active, or whoever is chosen from the list.
    activate(second)
    assert imported.review.armature == second and capture.person.name == "Björn"
    status = draw_panel(bpy.types.VIEW3D_PT_mocap_run, 600).drawn
    assert any(line.startswith("S00_P01_T02_Participants1-2: Björn Take") for line in status), status
    activate(first)
    assert imported.review.armature == first and bpy.ops.mocap.pin_pose() == {"FINISHED"}
    assert len(capture.reviews[0].pins) == 1 and not capture.reviews[1].pins
    capture.person_shown = 1
    assert imported.review.armature == second and bpy.context.view_layer.objects.active == second
    # One person again: an action of the same body, and the other's stays.
    kept = first.animation_data.action
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    assert second.animation_data.action["person"] == "Person 2" and first.animation_data.action == kept
    assert capture.reviews[1].armature == second
    # Read Again keeps bodies and names.
    assert bpy.ops.mocap.import_capture(filepath=capture.source) == {"FINISHED"}
    capture = imported.capture
    assert [p.name for p in capture.people] == ["Person 1", "Björn"]
    assert [review.armature for review in capture.reviews] == [first, second]


@pytest.mark.slow
def test_a_session_arrives_with_one_import(mocap, shared_data: Path) -> None:
    settings = shared_data / SESSION / "Config.toml"
    dropped = {"directory": str(settings.parent), "files": [{"name": settings.name}]}
    assert bpy.ops.mocap.import_capture(**dropped) == {"FINISHED"}
    assert [capture.frames for capture in mocap.captures] == [12, 12, 100]
    assert [len(capture.people) for capture in mocap.captures] == [0, 0, 3]
    assert all(Path(bpy.path.abspath(capture.file)).is_file() for capture in mocap.captures)
    assert mocap.captures[1].source.endswith("S00_P01_T01_StaticTrialParticipant2")
    assert bpy.ops.mocap.solve_all.poll()
    # The scene was as new: its range is the longest trial's, not the first one's.
    assert bpy.context.scene.frame_end - bpy.context.scene.frame_start == 99


@pytest.mark.slow
def test_a_session_leaves_a_shots_own_range(mocap, shared_data: Path) -> None:
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 10, 20
    assert bpy.ops.mocap.import_capture(filepath=str(shared_data / SESSION / "Config.toml")) == {"FINISHED"}
    assert (scene.frame_start, scene.frame_end) == (10, 20)
