"""The realistic body: what can be checked without the package it is baked from, and the whole where it is installed."""

import importlib.util

import numpy as np
import pytest

pytest.importorskip("scipy", reason="baking a body needs SciPy")

from assets_procedural import anny_body
from assets_procedural.anny_body import TOPOLOGIES, AnnyRig
from solver_backend.body.body import DEFAULT_BODY, load_body
from solver_backend.body.files.choices import list_bodies, load_chosen_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.exchange.errors import BackendMissing, JobInvalid
from solver_backend.types import SMPL_JOINTS, JointSet

HAS_ANNY = importlib.util.find_spec("anny") is not None


def stick_figure() -> AnnyRig:
    """Return a rig of bare bones in an A-pose, legs splayed, one vertex at each bone's head."""
    from scipy.sparse import csr_matrix

    joints = load_body().joints_template.copy()
    bones, parents, heads = [], [], []
    for name, bone in anny_body._sources().items():
        j = SMPL_JOINTS.index(name)
        x, y, z = joints[j]
        bones.append(bone)
        heads.append((0.7 * x, y - 0.6 * max(abs(x) - 0.17, 0), z) if y > 0.3 else (x * (1 - 0.4 * y), y, z))
        parents.append(j)
    order = np.argsort(parents)
    bones = [bones[i] for i in order]
    bones.append("spine04")
    heads = np.array([heads[i] for i in order] + [(0.0, 0.06, 0.0)])
    tree = (*load_body().parents, 0)
    return AnnyRig(tuple(bones), tree, csr_matrix(np.eye(len(bones))), np.zeros((0, 3), int), heads[None], heads[None])


def test_arms_become_level_and_legs_vertical():
    rig = stick_figure()
    vertices, _ = anny_body._reposed(rig, anny_body._owners(rig))
    place = {bone: vertices[0, i] for i, bone in enumerate(rig.bones)}
    for side, sign in (("L", 1.0), ("R", -1.0)):
        for start, end in (("upperarm01", "lowerarm01"), ("lowerarm01", "wrist"), ("wrist", "finger3-1")):
            segment = place[f"{end}.{side}"] - place[f"{start}.{side}"]
            np.testing.assert_allclose(segment, [sign * np.linalg.norm(segment), 0, 0], atol=1e-12)
        for start, end in (("upperleg01", "lowerleg01"), ("lowerleg01", "foot")):
            segment = place[f"{end}.{side}"] - place[f"{start}.{side}"]
            np.testing.assert_allclose(segment, [0, -np.linalg.norm(segment), 0], atol=1e-12)
    lengths = [np.linalg.norm(v[3] - v[0]) for v in (vertices[0], rig.vertices[0])]
    assert lengths[0] == pytest.approx(lengths[1])


def test_fingers_and_toes_hang_on_one_joint_each():
    rig = stick_figure()
    bones = (*rig.bones, "finger5-2.L", "toe4-1.R", "finger1-2.L")
    parents = (*rig.parents, *(bones.index(b) for b in ("wrist.L", "foot.R", "wrist.L")))
    longer = AnnyRig(bones, parents, rig.weights, rig.faces, rig.vertices, rig.heads)
    owners = [SMPL_JOINTS[j] for j in anny_body._owners(longer)[-3:]]
    assert owners == ["left_hand", "right_foot", "left_wrist"]


def test_topologies_without_a_free_licence_are_refused():
    with pytest.raises(JobInvalid, match="'smplx' is unknown; notoes, anny, makehuman are known"):
        anny_body.bake("smplx")
    assert not {"smpl", "smplx"} & set(TOPOLOGIES)


@pytest.mark.skipif(HAS_ANNY, reason="anny is installed")
def test_without_the_package_the_error_says_what_to_install():
    with pytest.raises(BackendMissing, match="pip install anny"):
        anny_body.bake()


@pytest.mark.slow
@pytest.mark.skipif(not HAS_ANNY, reason="anny is not installed")
def test_the_baked_body_is_like_ours(tmp_path):
    np.savez(tmp_path / "anny.npz", **anny_body.bake(num_samples=60))
    body, ours = load_body(tmp_path / "anny.npz"), load_body()
    assert body.stature_m == pytest.approx(1.70, abs=0.06)
    assert np.linalg.norm(body.joints_template - ours.joints_template, axis=1).max() < 0.08
    assert (body.weights > 0).sum(1).max() <= 6
    assert len(marker_landmarks(body, marker_layout("MANIFOLD_53"))) == 53
    for joint_set in JointSet:
        keypoint_landmarks(body, joint_set)


def test_command_makes_the_body_a_choice(tmp_path, monkeypatch):
    with np.load(DEFAULT_BODY, allow_pickle=False) as data:
        arrays = dict(data)
    monkeypatch.setenv("MANIFOLD_MOCAP_BODIES", str(tmp_path / "bodies"))
    monkeypatch.setattr(anny_body, "bake", lambda topology: {**arrays, "body_id": np.array(f"anny_{topology}")})
    monkeypatch.setattr("sys.argv", ["anny_body", "--topology", "makehuman"])
    anny_body.main()
    assert [body.name for body in list_bodies()] == ["neutral", "anny"]
    assert load_chosen_body("anny").id == "anny_makehuman"
