"""Anatomical rules: keypoints and markers of every set exist, mirror each other, and carry over to other meshes."""

import dataclasses

import numpy as np
import pytest

from solver_backend.body.anatomy import cast_ray
from solver_backend.body.body import load_body
from solver_backend.body.files.choices import load_smpl_file
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import (
    MARKER_OFFSET_M,
    marker_landmarks,
)
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.types import SMPL_JOINTS, JointSet

ALL_MARKERS = tuple(sorted({name for layout in load_layouts().layouts.values() for name in layout}))
HOLLOWS = ("T4", "T10", "STRN", "SACR")
"""Over the furrows of spine and breast bone the skin beside is nearer to a marker than the skin below it."""
MIRROR = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def body():
    return load_body()


def rest(landmarks: Landmarks) -> np.ndarray:
    return landmarks.anchors.sum(axis=1)


def to_triangles(point: np.ndarray, triangles: np.ndarray) -> float:
    """Return the distance of a point to the nearest triangle (Ericson 2005, "Real-time collision detection", 5.1.5)."""
    near = triangles[np.linalg.norm(triangles.mean(1) - point, axis=1) < 0.05]
    a, ab, ac = near[:, 0], near[:, 1] - near[:, 0], near[:, 2] - near[:, 0]
    gram = np.stack([(ab * ab).sum(1), (ab * ac).sum(1), (ac * ac).sum(1)], 1)
    d1, d2 = ((point - a) * ab).sum(1), ((point - a) * ac).sum(1)
    det = gram[:, 0] * gram[:, 2] - gram[:, 1] ** 2
    u, v = (gram[:, 2] * d1 - gram[:, 1] * d2) / det, (gram[:, 0] * d2 - gram[:, 1] * d1) / det
    inside = (u >= 0) & (v >= 0) & (u + v <= 1)
    feet = np.linalg.norm(a + u[:, None] * ab + v[:, None] * ac - point, axis=1)[inside]
    edges = []
    for start, end in ((0, 1), (1, 2), (2, 0)):
        edge = near[:, end] - near[:, start]
        along = (((point - near[:, start]) * edge).sum(1) / (edge * edge).sum(1)).clip(0, 1)
        edges.append(np.linalg.norm(near[:, start] + along[:, None] * edge - point, axis=1))
    return float(min(feet.min(initial=np.inf), np.min(edges)))


@pytest.mark.parametrize("joint_set", JointSet)
def test_keypoints_of_every_set_mirror_each_other(body, joint_set):
    landmarks = keypoint_landmarks(body, joint_set)
    assert landmarks.names == joint_set.keypoints
    np.testing.assert_allclose(landmarks.weights.sum(1), 1, atol=1e-12)
    places = rest(landmarks)
    np.testing.assert_allclose(places[list(joint_set.mirrored())] * MIRROR, places, atol=1e-4)
    for name, place in zip(landmarks.names, places, strict=True):
        side = 1 if name.startswith("left") or name.endswith("_left") else -1
        if "left" in name or "right" in name:
            assert side * place[0] > 0.005, name
        else:
            assert abs(place[0]) < 1e-3, name


def test_human36m_points_have_the_published_distances(body):
    """Martinez et al. 2017, forward_kinematics.py, mm; a thorax level with our shoulders is 14 mm higher."""
    landmarks = keypoint_landmarks(body, JointSet.H36M_17)
    place = dict(zip(landmarks.names, 1e3 * rest(landmarks), strict=True))
    published = {
        ("mid_hip", "left_hip"): (132.9, 5), ("mid_hip", "spine"): (233.4, 5), ("spine", "thorax"): (257.1, 15),
        ("thorax", "nose"): (121.1, 12), ("nose", "head_top"): (115.0, 5),
    }  # fmt: skip
    for (start, end), (length, within) in published.items():
        assert abs(np.linalg.norm(place[end] - place[start]) - length) < within, (start, end)


def test_necks_and_middles_are_midpoints(body):
    landmarks = keypoint_landmarks(body, JointSet.BODY_25)
    place = dict(zip(landmarks.names, rest(landmarks), strict=True))
    for middle, part in (("neck", "shoulder"), ("mid_hip", "hip")):
        np.testing.assert_allclose(place[middle], 0.5 * (place[f"left_{part}"] + place[f"right_{part}"]), atol=1e-12)


@pytest.mark.parametrize(("layout", "count"), [("CMU_41", 41), ("PLUGIN_GAIT_39", 39), ("MANIFOLD_53", 53)])
def test_layouts_have_their_markers(body, layout, count):
    names = load_layouts().layouts[layout]
    assert len(names) == len(set(names)) == count and set(marker_landmarks(body, names).names) == set(names)


def test_markers_are_off_the_skin_on_their_side(body):
    landmarks = marker_landmarks(body, ALL_MARKERS)
    triangles = body.v_template[body.faces]
    for name, place in zip(ALL_MARKERS, rest(landmarks), strict=True):
        below = 1.0e-3 if name in HOLLOWS else 3e-4
        assert MARKER_OFFSET_M - below < to_triangles(place, triangles) < MARKER_OFFSET_M + 3e-4, name
        if name in ("C7", "T4", "T10", "CLAV", "STRN", "SACR", "ARIEL"):
            assert abs(place[0]) < 3e-3, name
        else:
            assert (1 if name[0] == "L" else -1) * place[0] > 0.02, name
    assert landmarks.posedirs is not None and landmarks.posedirs.shape == (len(ALL_MARKERS), 3, 207)


def test_markers_mirror_each_other(body):
    left = tuple(name for name in ALL_MARKERS if name[0] == "L")
    right = tuple("R" + name[1:] for name in left)
    others = {name: ("RBAC" if name == "RBAK" else name) for name in right}
    places = rest(marker_landmarks(body, left)), rest(marker_landmarks(body, tuple(others.values())))
    np.testing.assert_allclose(places[0], places[1] * MIRROR, atol=2e-3)


@pytest.mark.slow
def test_aliases_are_the_same_places(body):
    aliases = load_layouts().aliases
    names, others = tuple(aliases), tuple(aliases.values())
    np.testing.assert_array_equal(rest(marker_landmarks(body, names)), rest(marker_landmarks(body, others)))


def save_as_smpl(body, path, scale: np.ndarray):
    kintree = np.array([[4294967295, *body.parents[1:]], range(24)], dtype=np.uint32)
    np.savez(
        path, v_template=body.v_template * scale, shapedirs=body.shapedirs * scale[:, None], posedirs=body.posedirs,
        J_regressor=body.J_regressor, weights=body.weights, kintree_table=kintree, f=body.faces,
    )  # fmt: skip
    return load_smpl_file(path, family="SMPL")


def test_landmarks_carry_over_to_a_loaded_file_of_another_size(body, tmp_path):
    """A body twice as large is a similar body: every landmark and every lever doubles, the marker's own size stays."""
    twice = save_as_smpl(body, tmp_path / "model.npz", np.full(3, 2.0))
    for joint_set in JointSet:
        np.testing.assert_allclose(
            rest(keypoint_landmarks(twice, joint_set)), 2 * rest(keypoint_landmarks(body, joint_set)), atol=0.03
        )
    ours, theirs = marker_landmarks(body, ALL_MARKERS), marker_landmarks(twice, ALL_MARKERS)
    np.testing.assert_allclose(theirs.weights, ours.weights, atol=1e-9)
    np.testing.assert_allclose(rest(theirs), 2 * rest(ours), atol=1.1 * MARKER_OFFSET_M)


def test_landmarks_carry_over_to_a_deformed_file(body, tmp_path):
    """Broader, shorter and deeper: rays find the new skin, near where the old points were moved to."""
    scale = np.array([1.12, 0.93, 1.2])
    other = save_as_smpl(body, tmp_path / "model.npz", scale)
    triangles = other.v_template[other.faces]
    ours, theirs = marker_landmarks(body, ALL_MARKERS), marker_landmarks(other, ALL_MARKERS)
    for name, old, new in zip(ALL_MARKERS, rest(ours), rest(theirs), strict=True):
        assert MARKER_OFFSET_M - 1.3e-3 < to_triangles(new, triangles) < MARKER_OFFSET_M + 4e-4, name
        assert np.linalg.norm(new - old * scale) < 0.03, name
    dominant = theirs.weights.argmax(1) == ours.weights.argmax(1)
    assert dominant.mean() > 0.9
    for joint_set in JointSet:
        places = rest(keypoint_landmarks(other, joint_set))
        assert np.isfinite(places).all()
        np.testing.assert_allclose(places, rest(keypoint_landmarks(body, joint_set)) * scale, atol=0.03)


def test_a_mesh_with_a_hole_is_named(body):
    headless = dataclasses.replace(body, faces=body.faces[(body.v_template[body.faces, 1] < 0.5).all(1)])
    with pytest.raises(BodyInvalid, match=r"A ray from .* misses the mesh.*closed T-posed mesh"):
        marker_landmarks(headless, ("ARIEL",))


def test_smpl_joints_are_the_joints(body):
    landmarks = keypoint_landmarks(body, JointSet.SMPL_24)
    assert landmarks.names == SMPL_JOINTS
    np.testing.assert_allclose(rest(landmarks), body.joints_template, atol=1e-12)


def test_rays_in_the_middle_meet_the_same_triangle_however_they_are_rounded(body):
    """Left and right triangles meet there: which of them is nearer was a matter of the processor."""
    start = body.joints_template[body.recorded_joints[SMPL_JOINTS.index("spine3")]]
    for direction in ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (0.0, 0.3, -1.0)):
        met = [cast_ray(body, start + np.array([nudge, 0.0, 0.0]), np.array(direction)) for nudge in (-1e-13, 0, 1e-13)]
        assert (met[0].vertices == met[1].vertices).all() and (met[1].vertices == met[2].vertices).all()
