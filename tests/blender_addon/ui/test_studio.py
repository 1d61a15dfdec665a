"""The Studio panel: the user's array benchmarked, shown on the floor, and a data set checked, made and resumed."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.capture_file import CameraFile
from blender_addon._exchange.errors import FileDamaged, FileMissing
from blender_addon.scene.cameras import create_camera
from blender_addon.studio.places import MAP, read_places, shared_limits
from blender_addon.studio.scene_file import array_of_scene
from blender_addon.ui.acquisition_properties import FAULTS, PRESET_ARRAYS
from blender_addon.ui.operators.base import SolverOperator, current
from blender_addon.ui.operators.studio import benchmark_description, data_set_description
from solver_backend.synthesis.studio.camera_arrays import CameraRing, build_camera_array, camera_array_presets
from solver_backend.synthesis.studio.spec import ENGINES, FORMATS, KINDS, PRESETS, spec_of
from tests.support.panel_layout import Layout


def film_with(array: CameraRing) -> None:
    """Stand an array's cameras into the scene, as pinholes."""
    c = array.cameras
    for i, name in enumerate(c.names):
        size = int(c.image_size[i, 0]), int(c.image_size[i, 1])
        source = CameraFile(name, c.K[i], c.R[i], c.t[i], size, np.zeros(8), "opencv", None)
        create_camera(source, bpy.context.scene.collection)
    bpy.context.view_layer.update()


@pytest.fixture
def ring() -> CameraRing:
    return build_camera_array({"count": 4, "radius_m": 2.5, "height_m": 1.5, "size": [320, 240]})


def test_the_panel_offers_what_the_backend_knows(mocap) -> None:
    assert {item[0] for item in PRESET_ARRAYS} == set(camera_array_presets())
    assert {item[0] for item in FAULTS} == set(PRESETS)
    items = {name: mocap.studio.bl_rna.properties[name].enum_items.keys() for name in ("film", "write", "engine")}
    assert set(items["film"]) == set(KINDS) and set(items["write"]) == set(FORMATS)
    assert set(items["engine"]) == set(ENGINES)
    for group in (mocap.studio, mocap.studio.rows.add()):
        for name, prop in group.bl_rna.properties.items():
            is_labelled = prop.name != name and name not in ("rna_type", "name")
            assert prop.description or not is_labelled, name


@pytest.mark.parametrize("fit", ["HORIZONTAL", "VERTICAL", "AUTO"])
def test_the_scenes_cameras_are_filmed_with_as_they_stand(mocap, ring, fit) -> None:
    film_with(ring)
    scene, graph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    found = build_camera_array(array_of_scene(scene, graph)).cameras
    for name in ("K", "R", "t", "image_size"):
        assert np.abs(getattr(found, name) - getattr(ring.cameras, name)).max() < 2e-4, name
    data = bpy.data.cameras.new("own")
    data.sensor_fit, data.lens, data.shift_x, data.shift_y = fit, 40.0, 0.05, -0.1
    own = bpy.data.objects.new("own", data)
    holder = bpy.data.objects.new("holder", None)
    own.parent, holder.scale = holder, (2.0, 2.0, 2.0)
    own.location, own.rotation_euler = (0.5, -2.0, 0.7), (1.2, 0.1, 0.3)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 600, 800, 50
    for obj in (own, holder):
        scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    camera = array_of_scene(scene, bpy.context.evaluated_depsgraph_get())["cameras"][-1]
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    assert camera["name"] == "own" and camera["image_size"] == [300, 400]
    for point in ([0.9, 0.5, 1.2], [1.6, 1.4, 1.0]):
        x, y, _ = world_to_camera_view(scene, own, Vector(point))
        p = np.array(camera["K"]) @ (np.array(camera["R"]) @ point + camera["t"])
        assert p[:2] / p[2] == pytest.approx([x * 300 - 0.5, (1 - y) * 400 - 0.5], abs=0.01)


def test_cameras_that_cannot_film_are_named(mocap, ring) -> None:
    mocap.studio.array = "SCENE"
    with pytest.raises(RuntimeError, match="The scene has no cameras"):
        bpy.ops.mocap.benchmark()
    film_with(ring)
    next(obj for obj in bpy.data.objects if obj.name == "cam02").data.type = "ORTHO"
    with pytest.raises(RuntimeError, match=r"cam02.*perspective"):
        bpy.ops.mocap.benchmark()
    mocap.studio.array, mocap.studio.faults = "RING", "depth_markers"
    with pytest.raises(RuntimeError, match="errors are for markers"):
        bpy.ops.mocap.benchmark()


@pytest.mark.slow
def test_a_button_says_what_the_users_cameras_would_reach(mocap, ring, monkeypatch) -> None:
    film_with(ring)
    monkeypatch.setattr("blender_addon.ui.operators.studio._BENCHMARK_FRAMES", 8)
    studio = mocap.studio
    studio.fewer, studio.methods = True, {"triangulation", "frame"}
    assert bpy.ops.mocap.benchmark() == {"FINISHED"}
    assert [row.array for row in studio.rows] == ["my cameras", "my cameras less 1"]
    more, less = studio.rows
    # Draws are seeded by the name of the array: medians of so few differ by several per cent.
    assert "Triangulation" in more.reached and "Frame by Frame" in more.reached
    assert 2 < more.median_mm < 1.1 * less.median_mm
    shown = [obj for obj in bpy.data.objects if MAP in obj]
    assert len(shown) == 1 and shown[0][MAP] == "my cameras"
    mesh, maps = shown[0].data, read_places(Path(more.places))
    assert len(mesh.polygons) == maps[0].error_mm.size == 81
    colours = np.array([p.material_index for p in mesh.polygons])
    error = maps[0].error_mm.ravel()
    good = np.isfinite(error)
    assert (colours[~good] == len(mesh.materials) - 1).all() and colours[good].max() > colours[good].min()
    assert (np.diff(colours[good][np.argsort(error[good])]) >= 0).all(), "larger errors are redder"
    centre = mesh.polygons[int(np.nanargmin(error))].center
    assert abs(centre.x - maps[0].x_m[int(np.nanargmin(error)) % 9]) < 1e-5
    assert tuple(studio.shown_mm) == pytest.approx(shared_limits(maps))
    assert bpy.ops.mocap.show_places(index=1) == {"FINISHED"}
    assert [obj[MAP] for obj in bpy.data.objects if MAP in obj] == ["my cameras less 1"]
    page = Path(more.page)
    assert "my cameras less 1" in page.read_text("utf-8") and "Worst frames" in page.read_text("utf-8")
    layout = Layout()
    bpy.types.VIEW3D_PT_mocap_benchmark.draw(SimpleNamespace(layout=layout), panel_context())
    assert f"label:{more.reached}" in layout.drawn or any("Triangulation" in line for line in layout.drawn)
    page.unlink()
    with pytest.raises(RuntimeError, match="page no longer exists"):
        bpy.ops.mocap.open_benchmark(index=0)
    assert bpy.ops.mocap.clear_benchmarks() == {"FINISHED"}
    assert not len(studio.rows) and not [obj for obj in bpy.data.objects if MAP in obj]


def panel_context() -> Any:
    """Return a context with a sidebar, which a Blender without windows has not."""
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))
    return SimpleNamespace(scene=bpy.context.scene, preferences=preferences, region=SimpleNamespace(width=800))


def test_a_benchmark_is_of_the_captures_own_lenses_where_there_is_a_capture(mocap, solved) -> None:
    from blender_addon.ui.operators.import_results import take_capture

    take_capture(bpy.context.scene, solved.read)
    described = benchmark_description(bpy.context)
    assert (
        described["camera_arrays"][0]["layout"] == "capture"
        and Path(described["camera_arrays"][0]["capture"]).is_file()
    )
    array = spec_of(described).arrays[0]
    assert array.cameras.image_size.max() == 400 and array.stand is not None and len(array.cameras) == 4
    mocap.studio.motion = "TAKE"
    with pytest.raises(FileMissing, match="no solved take"):
        data_set_description(bpy.context)
    mocap.studio.array, mocap.studio.motion = "vicon_12", "CHOREOGRAPHY"
    mocap.studio.against = {"vicon_12", "oak_d_4"}
    assert [array.name for array in spec_of(benchmark_description(bpy.context)).arrays] == ["vicon_12", "oak_d_4"]


@pytest.mark.slow
def test_a_data_set_is_checked_made_and_gone_on_with(mocap, tmp_path) -> None:
    studio = mocap.studio
    studio.array, studio.scale, studio.frames, studio.people = "azure_kinect_3", 0.15, 3, 2
    studio.film = {"masks"}
    assert not bpy.ops.mocap.make_data_set.poll()
    assert bpy.ops.mocap.check_data_set() == {"FINISHED"}
    assert studio.planned.startswith("2 shots, 6 frames, 18 images: about") and "GiB are free" in studio.planned
    out = Path(studio.planned_out)
    assert not out.exists(), "nothing is made yet"
    studio.people = 1
    assert not studio.planned and not bpy.ops.mocap.make_data_set.poll(), "what was checked is no longer so"
    assert bpy.ops.mocap.check_data_set() == {"FINISHED"}
    assert bpy.ops.mocap.make_data_set() == {"FINISHED"}
    assert (out / "card.md").is_file() and len(list((out / "shots").glob("*/shot.json"))) == 1
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.png") if "masks" in path.parts}
    assert len(before) == 9
    assert bpy.ops.mocap.check_data_set() == {"FINISHED"} and Path(studio.planned_out) == out
    assert bpy.ops.mocap.make_data_set() == {"FINISHED"}
    assert {path: path.stat().st_mtime_ns for path in before} == before
    studio.film = set()
    with pytest.raises(RuntimeError, match="No kind of image is selected"):
        bpy.ops.mocap.check_data_set()


def test_a_cancelled_run_says_that_it_goes_on(mocap, monkeypatch) -> None:
    mocap.studio.planned = "1 shot"
    cancelled = {"code": "cancelled", "message": "The work was cancelled.", "where": "", "hint": ""}
    monkeypatch.setattr(current, "last", SimpleNamespace(verb="dataset make", error=cancelled, result=None))
    monkeypatch.setattr(current, "about", (bpy.context.scene.name, mocap.capture.file))
    layout = Layout()
    bpy.types.VIEW3D_PT_mocap_studio.draw(SimpleNamespace(layout=layout), panel_context())
    assert any("continues with the next one" in line for line in layout.drawn)
    mocap.studio.array = "RING"
    bpy.types.VIEW3D_PT_mocap_studio.draw(SimpleNamespace(layout=layout), panel_context())
    assert "prop:MocapStudio.count" in layout.drawn
    mocap.studio.film = {"rgb"}
    bpy.types.VIEW3D_PT_mocap_data_set.draw(SimpleNamespace(layout=layout), panel_context())
    assert "prop:MocapStudio.engine" in layout.drawn
    assert issubclass(bpy.types.MOCAP_OT_benchmark, SolverOperator)


def test_a_map_of_another_kind_is_refused(tmp_path) -> None:
    path = tmp_path / "places.json"
    with pytest.raises(FileMissing):
        read_places(path)
    path.write_text(json.dumps({"format": "manifold_mocap_places", "version": 1, "places": [{"camera_array": "a"}]}))
    with pytest.raises(FileDamaged):
        read_places(path)
    item = {"camera_array": "a", "x_m": [0, 1], "y_m": [0, 1], "error_mm": [[1, None]]}
    path.write_text(json.dumps({"format": "manifold_mocap_places", "version": 1, "places": [item]}))
    with pytest.raises(FileDamaged, match="rows"):
        read_places(path)
