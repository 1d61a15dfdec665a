"""The command that writes the body as an asset, and what another file gets from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.__main__ import main
from blender_addon._exchange.errors import OutputExists
from blender_addon._exchange.progress import silent
from blender_addon.body.controls.limbs import CONTROLS, ROOT, has_finger_controls
from blender_addon.body.shape import get_betas, set_betas, sliders
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.headless.body import run_body
from blender_addon.headless.verb_table import VERBS
from blender_addon.render.asset import BODIES, CATALOG_FILE, add_catalog
from tests.support.library_override import override_linked


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the shipped body once."""
    path = tmp_path_factory.mktemp("library ü") / "Body.blend"
    run_body(VERBS["body"].arguments(out=path, betas=(1.0, -0.5)), silent)
    return path


@pytest.mark.slow
def test_an_asset_has_fingers_where_they_are_asked_for(library: Path, tmp_path: Path) -> None:
    main(["body", "--out", str(tmp_path / "Hands.blend"), "--fingers"])
    for path, has_fingers in ((library, False), (tmp_path / "Hands.blend", True)):
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
        [armature] = [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]
        assert has_finger_controls(armature) == has_fingers == ("left_index1" in armature.data.bones)


def test_asset_says_what_it_is(library: Path) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(library), load_ui=False)
    marked = [item for item in (*bpy.data.collections, *bpy.data.objects) if item.asset_data]
    assert marked == [bpy.data.collections["Body"]]
    data = marked[0].asset_data
    assert "manifold_neutral" in data.description and data.author and data.license == "CC0-1.0"
    assert {"body", "rig"} <= {tag.name for tag in data.tags} and data.catalog_id == BODIES[0]
    pixels = np.array(marked[0].preview.image_pixels_float).reshape(*marked[0].preview.image_size, 4)
    body = np.ptp(pixels[..., :3], axis=-1) > 0.1
    assert 0.05 < body.mean() < 0.5 and body[100:156, 100:156].any() and (pixels[..., 3] > 0.99).all()


def test_appended_body_is_whole_and_stands_on_the_floor(scene: bpy.types.Scene, library: Path) -> None:
    with bpy.data.libraries.load(str(library), link=False) as (_, wanted):
        wanted.collections = ["Body"]
    scene.collection.children.link(bpy.data.collections["Body"])
    armature = next(obj for obj in scene.objects if obj.type == "ARMATURE")
    mesh = next(child for child in armature.children if child.type == "MESH")
    np.testing.assert_allclose(get_betas(mesh)[:3], [1.0, -0.5, 0.0], atol=1e-6)
    assert all(armature.pose.bones[name].custom_shape for name in (ROOT, *JOINTS, *CONTROLS))
    rng = np.random.default_rng(0)
    heights = set()
    for _ in range(4):
        set_betas(mesh, rng.normal(size=10))
        bpy.context.view_layer.update()
        skin = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
        z = [(skin.matrix_world @ vertex.co).z for vertex in skin.data.vertices]
        assert abs(min(z)) < 1e-3
        heights.add(round(max(z), 2))
    assert len(heights) > 1


def test_linked_body_can_be_overridden_and_shaped(scene: bpy.types.Scene, library: Path) -> None:
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.collections = ["Body"]
    override_linked(bpy.data.collections["Body"])
    armature = next(obj for obj in scene.objects if obj.type == "ARMATURE" and obj.override_library)
    mesh = next(obj for obj in scene.objects if obj.type == "MESH" and obj.parent == armature)
    before = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones["head"].head.z
    sliders(mesh)[0].value += 2.0
    bpy.context.view_layer.update()
    after = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones["head"].head.z
    assert after > before + 0.03


def test_catalogs_of_others_stay(library: Path, tmp_path: Path) -> None:
    (tmp_path / CATALOG_FILE).write_text("VERSION 1\n\n1234:Props:Props\n", encoding="utf-8")
    add_catalog(tmp_path)
    add_catalog(tmp_path)
    text = (tmp_path / CATALOG_FILE).read_text(encoding="utf-8")
    assert "1234:Props:Props" in text and text.count(BODIES[0]) == 1
    written = (library.parent / CATALOG_FILE).read_text(encoding="utf-8")
    assert "VERSION 1" in written and f"{BODIES[0]}:Characters/Manifold MoCap:" in written


def test_existing_file_stays(library: Path) -> None:
    size = library.stat().st_size
    with pytest.raises(OutputExists, match="Nothing was overwritten"):
        run_body(VERBS["body"].arguments(out=library), silent)
    assert library.stat().st_size == size < 5e6


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (["--betas=1,x"], "numbers separated by commas"),
        (["--betas=1,2,3,4,5,6,7,8,9,10,11"], "1 to 10 numbers"),
        (["--betas=nan"], "1 to 10 numbers"),
        ([], "must end in .blend"),
    ],
)
def test_wrong_command_lines_are_refused(wrong: list[str], named: str, tmp_path: Path, capsys: Any) -> None:
    name = "body.blend" if wrong else "body.fbx"
    assert main(["body", "--out", str(tmp_path / name), *wrong]) == 2
    assert not list(tmp_path.iterdir())
    assert named in capsys.readouterr().err
