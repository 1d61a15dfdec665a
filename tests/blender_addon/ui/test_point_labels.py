"""A person says what points are: kept in the scene, written for the solver, binding in the solve."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import bpy
import pytest

from blender_addon._exchange.motion_file import read_motion
from blender_addon.conventions.naming import MARKERS
from blender_addon.scene.overlay import labels_of
from blender_addon.ui.operators.capture import choose_nearest
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.job import Job
from solver_backend.labelling import outputs
from solver_backend.synthesis.embedded.demo import record_markers


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of points that nobody named."""
    cloud = record_markers(40).cloud
    return write_c3d(tmp_path_factory.mktemp("bare") / "bare.c3d", replace(cloud, labels=None))


@pytest.fixture
def imported(mocap, bare):
    assert bpy.ops.mocap.import_capture(filepath=str(bare)) == {"FINISHED"}
    return mocap.capture


def test_names_are_the_solvers():
    assert MARKERS == outputs.MARKERS


def test_the_nearest_point_to_a_click_is_chosen(imported):
    label = imported.marker_items[7].name
    places = {item.name: (100.0 * i, 50.0) for i, item in enumerate(imported.marker_items)}
    assert choose_nearest(imported, places, 705.0, 55.0) and imported.marker_items[imported.marker_index].name == label
    assert not choose_nearest(imported, places, 650.0, 50.0) and imported.marker_index == 7


def test_a_point_that_is_not_seen_has_no_name(imported):
    imported.marker_index = -1
    with pytest.raises(RuntimeError, match="Select a point first"):
        bpy.ops.mocap.label_point()
    assert len(imported.point_labels) == 0


@pytest.mark.slow
def test_what_is_said_binds_in_the_next_solve(imported, mocap):
    scene = bpy.context.scene
    scene.frame_set(imported.frame_start + 10)
    imported.marker_index, imported.label_name = 3, "ARIEL"
    for _ in range(2):  # saying it again replaces it
        assert bpy.ops.mocap.label_point() == {"FINISHED"}
    imported.marker_index, imported.label_name = 4, "NONE"
    assert bpy.ops.mocap.label_point() == {"FINISHED"}
    said = [(item.point, item.frame, item.marker) for item in imported.point_labels]
    assert said == [(3, 10, "ARIEL"), (4, 10, "")]
    mocap.solve.preset = "FAST"
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    take = mocap.review.take
    job = Job.read(Path(bpy.path.abspath(take["job_file"])))
    assert job.labels is not None and json.loads(job.labels.read_text())["points"][0]["marker"] == "ARIEL"
    motion = read_motion(job.out)
    assert "ARIEL" in motion.marker_labels
    assert len(motion.marker_labels) <= len(labels_of(imported.cloud))
    assert bpy.ops.mocap.remove_point_label(index=0) == {"FINISHED"}
    assert [item.marker for item in imported.point_labels] == [""]
