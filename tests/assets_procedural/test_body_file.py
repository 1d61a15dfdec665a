"""The committed body file keeps what animators and solvers rely on."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets_procedural.build import BODY_FILE, NUM_VERTICES
from assets_procedural.detail.lay_on import lay_on_details
from assets_procedural.hand.build import HANDS_FILE
from assets_procedural.layout import BORDERS, MIRROR_JOINT, PARENTS
from assets_procedural.mesh.charts import MATERIAL_NAMES
from assets_procedural.mesh.meshing import SymmetricMesh, build_mesh
from assets_procedural.primitives import load_primitives
from assets_procedural.quality.contact_sheet import BENDS, EXTREMES, BakedBody, read_baked, rotations
from assets_procedural.quality.figures import Figure, figures
from assets_procedural.shown import SHOWN_FILE
from assets_procedural.skeleton.correctives import joint_masks
from assets_procedural.skeleton.skinning import load_joints, volume
from solver_backend.body.body import load_body
from tests.support.blas_kernels import KERNELS, environment_with_kernel

ROOT = BODY_FILE.parents[2]
FROM_A_MESH = """
import sys
from pathlib import Path
import numpy as np
from assets_procedural.build import build_body, write_body
from assets_procedural.hand.build import build_hands
from assets_procedural.mesh.meshing import SymmetricMesh
with np.load(sys.argv[1]) as mesh:
    built = build_body(fitted=SymmetricMesh(**mesh))
write_body(Path(sys.argv[2]), built.arrays)
write_body(Path(sys.argv[3]), build_hands(built))
"""
"""Builds the body on a mesh of the skin that is there, since the mesh takes most of a build's time."""


@pytest.fixture(scope="module")
def body() -> BakedBody:
    return read_baked()


@pytest.fixture(scope="module")
def measured(body: BakedBody) -> list[Figure]:
    return list(figures(body, BODY_FILE))


def test_every_figure_is_in_its_range(measured: list[Figure]) -> None:
    missed = [figure.row() for figure in measured if not figure.good]
    assert not missed, "\n".join(missed)


def test_vertices_weights_and_regressor_mirror_exactly(body: BakedBody) -> None:
    with np.load(BODY_FILE) as data:
        mirror = data["mirror"]
    flip = np.array([-1.0, 1.0, 1.0])
    np.testing.assert_array_equal(mirror[mirror], np.arange(len(mirror)))
    np.testing.assert_allclose(body.vertices[mirror] * flip, body.vertices, atol=1e-6)
    np.testing.assert_allclose(body.shapedirs[mirror] * flip[:, None], body.shapedirs, atol=1e-6)
    np.testing.assert_allclose(body.weights[mirror][:, list(MIRROR_JOINT)], body.weights, atol=1e-6)
    np.testing.assert_allclose(body.regressor[list(MIRROR_JOINT)][:, mirror], body.regressor, atol=1e-6)


def test_weights_are_a_partition_with_six_influences(body: BakedBody) -> None:
    assert body.weights.min() >= 0.0
    np.testing.assert_allclose(body.weights.sum(axis=1), 1.0, atol=1e-6)
    assert np.sum(body.weights > 0, axis=1).max() <= 6
    left_leg, right_side = body.weights[:, [1, 4, 7, 10]].sum(axis=1), body.vertices[:, 0] < -0.02
    assert left_leg[right_side].max() < 0.25


def test_joints_stand_where_the_smpl_tree_wants_them(body: BakedBody) -> None:
    joints = body.joints
    np.testing.assert_allclose(joints[0], 0.0, atol=1e-5)
    assert 0.08 <= joints[0, 1] - joints[1, 1] <= 0.09
    assert abs(joints[7, 0] - joints[1, 0]) < 0.03, "the legs are near vertical"
    assert np.ptp(joints[[16, 18, 20, 22], 1]) < 0.015, "the arms are level"
    assert joints[16, 0] > 0 and joints[10, 2] > joints[7, 2], "left is +X and toes point to +Z"


def test_each_joint_lies_inside_the_skin_it_carries(body: BakedBody) -> None:
    for joint in range(1, len(PARENTS)):
        skin = body.vertices[body.weights[:, joint] > 0.05]
        assert body.weights[:, joint].max() > 0.7
        assert np.all(skin.min(axis=0) < body.joints[joint] + 0.02)
        assert np.all(skin.max(axis=0) > body.joints[joint] - 0.02)


def test_betas_keep_the_pelvis_at_the_origin(body: BakedBody) -> None:
    moved = body.regressor @ (body.vertices + body.shapedirs @ np.full(10, 1.5))
    assert np.linalg.norm(moved[0]) < 1e-4


def test_rest_pose_is_the_template(body: BakedBody) -> None:
    np.testing.assert_allclose(body.posed(rotations({})), body.vertices, atol=1e-6)


def test_correctives_stay_where_joints_act(body: BakedBody) -> None:
    active = np.abs(body.posedirs).reshape(len(body.vertices), 3, 23, 9).max(axis=(1, 3)) > 0
    assert not np.any(active & (joint_masks(body.weights) == 0))


@pytest.mark.parametrize("name", BENDS)
def test_correctives_keep_more_volume_than_linear_blending(body: BakedBody, name: str) -> None:
    rest, turned = volume(body.vertices, body.faces), rotations(BENDS[name], 90)
    lost = [abs(volume(body.posed(turned, correctives=use), body.faces) / rest - 1) for use in (True, False)]
    assert lost[0] < 0.6 * lost[1] or lost[0] < 0.002


@pytest.mark.parametrize("name", EXTREMES)
def test_extreme_poses_stretch_no_edge_apart(body: BakedBody, name: str) -> None:
    pairs = np.concatenate([body.faces[:, [0, 1]], body.faces[:, [1, 2]], body.faces[:, [2, 0]]])
    posed = body.posed(rotations(EXTREMES[name]))
    length = [np.linalg.norm(v[pairs[:, 0]] - v[pairs[:, 1]], axis=1) for v in (posed, body.vertices)]
    assert np.isfinite(posed).all() and np.quantile(length[0] / length[1], 0.9999) < 3.5


def test_texture_charts_cover_every_face_without_turning_over(body: BakedBody) -> None:
    with np.load(BODY_FILE) as data:
        vt, ft, material = data["vt"].astype(np.float64), data["ft"], data["face_material"]
    assert ft.shape == body.faces.shape
    assert vt.min() >= 0.0 and vt.max() <= 1.0 and ft.max() == len(vt) - 1
    a, b, c = (vt[ft[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert np.mean(area <= 0) < 0.002
    assert set(np.unique(material)) == set(range(len(MATERIAL_NAMES)))


def test_the_runtime_loads_the_file() -> None:
    body = load_body()
    assert body.id == "manifold_neutral"
    assert body.parents == PARENTS


def assert_is_the_committed_file(out: Path, committed: Path) -> None:
    with np.load(committed) as data, np.load(out) as rebuilt:
        assert set(data.files) == set(rebuilt.files)
        for key, value in rebuilt.items():
            if value.dtype.kind == "f":
                tolerance = 1e-4 if key == "posedirs" else 1e-5  # correctives under 5e-5 m are cut off
                np.testing.assert_allclose(value, data[key], rtol=0, atol=tolerance, err_msg=key)
            else:
                np.testing.assert_array_equal(value, data[key], err_msg=key)


@pytest.fixture(scope="module")
def disturbed() -> SymmetricMesh:
    """Return the skin's mesh from primitives whose last bits differ, far more than kernels of BLAS make them differ."""
    exact, rng = load_primitives(), np.random.default_rng(0)
    noise = 1e-12 * rng.normal(size=(len(exact.mean) // 2, 3))
    primitives = replace(exact, mean=exact.mean + np.concatenate([noise, noise * [-1.0, 1.0, 1.0]]))
    return build_mesh(primitives, NUM_VERTICES, BORDERS)


@pytest.mark.slow
def test_last_bits_of_the_primitives_do_not_change_the_mesh(body: BakedBody, disturbed: SymmetricMesh) -> None:
    detailed = lay_on_details(disturbed, load_joints())
    np.testing.assert_array_equal(detailed.mesh.faces, body.faces)


@pytest.mark.slow
def test_rebuilding_from_the_committed_numbers_gives_the_committed_file(tmp_path: Path) -> None:
    out, hands, shown = (tmp_path / f"{name}.npz" for name in ("rebuilt", "hands", "shown"))
    command = [sys.executable, "-m", "assets_procedural"]
    command += ["--out", str(out), "--hands", str(hands), "--shown", str(shown)]
    subprocess.run(command, cwd=ROOT, env=environment_with_kernel(KERNELS[0]), check=True, capture_output=True)
    assert_is_the_committed_file(out, BODY_FILE)
    assert_is_the_committed_file(hands, HANDS_FILE)
    assert_is_the_committed_file(shown, SHOWN_FILE)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", KERNELS)
def test_every_kernel_makes_the_committed_file_of_the_mesh(
    kernel: str, disturbed: SymmetricMesh, tmp_path: Path
) -> None:
    mesh, out, hands = tmp_path / "mesh.npz", tmp_path / "rebuilt.npz", tmp_path / "hands.npz"
    np.savez(mesh, vertices=disturbed.vertices, faces=disturbed.faces, mirror=disturbed.mirror)
    command = [sys.executable, "-c", FROM_A_MESH, str(mesh), str(out), str(hands)]
    subprocess.run(command, cwd=ROOT, env=environment_with_kernel(kernel), check=True, capture_output=True)
    assert_is_the_committed_file(out, BODY_FILE)
    assert_is_the_committed_file(hands, HANDS_FILE)
