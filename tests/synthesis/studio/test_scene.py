"""Surfaces before cameras: the z-buffer against rays, clothes in extreme poses, visibility, perturbation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.mesh import pose_mesh
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.studio.camera_arrays import build_camera_array
from solver_backend.synthesis.studio.costume import CornerSums, dress
from solver_backend.synthesis.studio.perturb import clean_capture, perturbed_capture
from solver_backend.synthesis.studio.room import pixel_rays, unit_box
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import list_shots, set_up
from solver_backend.synthesis.studio.truth import SELF_HIDDEN, VISIBLE, find_truth, true_motion
from solver_backend.synthesis.studio.write_pictures import write_body
from solver_backend.synthesis.studio.z_buffer import in_camera, rasterise
from solver_backend.types import SMPL_JOINTS, JointSet


def test_depth_of_a_box_through_a_bent_lens_is_where_its_rays_meet_it() -> None:
    cameras = build_camera_array({"preset": "azure_kinect_3", "scale": 0.4}).cameras
    corner, faces = unit_box(10)
    vertices = corner * [0.3, 0.2, 0.4] + [0.1, -0.2, 0.9]
    width, height = cameras.image_size[0].tolist()
    camera, px = in_camera(cameras, 0, vertices)
    found = rasterise(px, camera[:, 2], faces, (width, height))
    ray = pixel_rays(cameras, 0) @ cameras.R[0]
    # The slab method: a ray meets a box between the last plane entered and the first one left.
    with np.errstate(divide="ignore"):
        bounds = [
            (np.array([0.1, -0.2, 0.9]) + s * np.array([0.3, 0.2, 0.4]) - cameras.centres[0]) / ray for s in (-1, 1)
        ]
    near, far = np.minimum(*bounds).max(axis=-1), np.maximum(*bounds).min(axis=-1)
    hit = near < far
    seen = found.face >= 0
    assert (hit != seen).sum() <= 0.002 * hit.sum() + 6, "outlines differ by single pixels at most"
    both = hit & seen
    assert both.sum() > 2000
    assert np.abs(found.depth[both] - near[both]).max() < 2e-3
    assert np.abs(found.depth[both] - near[both]).mean() < 5e-5


EXTREME = (
    {"left_hip": (-2.0, 0.3, 0.2), "left_knee": (2.2, 0, 0)},
    {"right_hip": (-1.6, -0.4, -0.5), "right_knee": (0.3, 0, 0)},
    {"left_shoulder": (0, 0, 1.2)}, {"right_shoulder": (0, 1.5, 0.6), "right_elbow": (0, 2.2, 0)},
    {"left_hip": (-1.9, 0, 0), "right_hip": (-1.9, 0, 0), "left_knee": (2.3, 0, 0), "right_knee": (2.3, 0, 0)},
    {"spine1": (0.5, 0, 0), "spine2": (0.5, 0, 0), "spine3": (0.4, 0, 0)},
    {"spine1": (-0.35, 0, 0), "spine2": (-0.3, 0, 0)},
    {"spine1": (0, 0.5, 0), "spine2": (0, 0.5, 0), "spine3": (0, 0.4, 0)},
    {"left_hip": (0, 0, 1.1), "right_hip": (0, 0, -1.1)},
    {"left_shoulder": (0, -1.6, -0.4), "right_shoulder": (0, 1.6, 0.4)}, {"neck": (0.6, 0, 0), "head": (0.5, 0.4, 0)},
    {"left_hip": (0.6, 0, 0), "left_knee": (2.0, 0, 0), "left_ankle": (0.6, 0, 0)},
)  # fmt: skip


@pytest.mark.parametrize("clothes", ["suit", "shirt_trousers", "tee_shorts", "tee_trousers", "tunic_leggings"])
def test_no_skin_pierces_garments_in_extreme_poses(clothes: str) -> None:
    body = load_body()
    costume = dress(body, clothes, "short", np.random.default_rng(1))
    local = np.zeros((len(EXTREME), 21, 3))
    for pose, turns in zip(local, EXTREME, strict=True):
        for joint, turn in turns.items():
            pose[SMPL_JOINTS.index(joint) - 1] = turn
    upright = np.tile(exp_so3(np.array([np.pi / 2, 0, 0])), (len(EXTREME), 1, 1))
    skin = pose_mesh(body, np.zeros(10), upright, exp_so3(local), np.tile([0.0, 0.0, 1.0], (len(EXTREME), 1)))
    surface = costume.posed(skin, CornerSums(body.faces, len(body.v_template)))
    cameras = build_camera_array({"count": 4, "size": [320, 320], "fov_deg": 50}).cameras
    # A triangle of skin over which a garment's lies shows through it where it is seen.
    bare = costume.label == 1
    under = np.isin(costume.body_face, costume.body_face[~bare]) & bare
    shown, through = 0, 0
    for vertices in surface:
        for view in range(4):
            camera, px = in_camera(cameras, view, vertices)
            face = rasterise(px, camera[:, 2], costume.faces, (320, 320)).face
            shown += (face >= 0).sum()
            through += under[face[face >= 0]].sum()
    assert shown > 48 * 3000
    assert under.sum() > 500, "hems lie over skin"
    assert through == 0


def test_what_is_hidden_and_what_is_seen_agrees_with_the_picture() -> None:
    spec = spec_of(
        {"camera_arrays": [{"preset": "azure_kinect_3"}], "frames": 8, "fps": 2, "looks": ["bare"], "markers": None}
    )
    stage = set_up(spec, list_shots(spec)[0])
    truth = find_truth(stage, spec.fps)
    names = JointSet.COCO_17.keypoints
    agree = []
    for frame in range(stage.num_frames):
        surface = stage.surface(np.array([frame]))[0]
        for view in range(3):
            camera, px = in_camera(stage.cameras, view, surface)
            depth = rasterise(px, camera[:, 2], stage.costume.faces, (640, 576)).depth
            for name in ("nose", "left_eye", "right_eye", "left_ear", "right_ear"):
                k = names.index(name)
                state = truth.visibility[JointSet.COCO_17][view, frame, k]
                u, v = np.round(truth.xy[JointSet.COCO_17][view, frame, k]).astype(int)
                if state in (SELF_HIDDEN, VISIBLE) and 0 <= u < 640 and 0 <= v < 576:
                    point = truth.keypoints3d[JointSet.COCO_17][frame, k]
                    far = float(stage.cameras.R[view, 2] @ point + stage.cameras.t[view, 2])
                    agree.append((depth[v, u] > far - 0.04) == (state == VISIBLE))
    assert len(agree) > 90 and np.mean(agree) > 0.95
    hips = truth.visibility[JointSet.SMPL_24][:, :, 0]
    assert (hips == VISIBLE).mean() > 0.8, "the pelvis is inside its own flesh, which does not hide it"
    assert truth.contacts.any() and truth.inside.min() > 0.5


def test_clean_is_the_truth_and_every_fault_has_its_size() -> None:
    base = {"camera_arrays": ["vicon_12"], "frames": 60, "people": {"count": 1}, "film": []}
    spec = spec_of({**base, "perturb": {"jitter_mm": 10, "marker_mm": 2, "marker_gaps": 0.1, "missing": 0.05}})
    stage = set_up(spec, list_shots(spec)[0])
    truth = find_truth(stage, spec.fps, sight=False)
    motion = true_motion(stage.person, stage.joints, truth.contacts, spec.fps)
    clean = clean_capture(spec, stage, truth, motion)
    found = perturbed_capture(spec, stage, truth, clean)
    assert clean.keypoints is not None and found.keypoints is not None
    assert np.nanmax(np.abs(clean.keypoints.xy - truth.xy[spec.joint_set])) == 0
    px_mm = stage.cameras.K[0, 0, 0] / 1000 / np.linalg.norm(stage.cameras.centres - stage.joints[0, 0], axis=1).mean()
    off = found.keypoints.xy - clean.keypoints.xy
    assert np.nanstd(off) / px_mm == pytest.approx(10 * np.exp(0.0), rel=0.45)
    gone = 1 - (found.keypoints.confidence > 0).sum() / (clean.keypoints.confidence > 0).sum()
    assert 0.02 < gone < 0.09
    assert found.markers is not None
    error = found.markers.positions - stage.markers
    assert np.nanstd(error) == pytest.approx(0.002, rel=0.05)
    assert np.isnan(error).all(axis=-1).mean() == pytest.approx(0.1, abs=0.04)
    again = perturbed_capture(spec, stage, truth, clean)
    assert np.array_equal(again.keypoints.xy, found.keypoints.xy, equal_nan=True)


def test_a_body_of_other_joints_is_read_back_with_them(tmp_path) -> None:
    body = load_body()
    tail = replace(
        body.layout, name="tailed", joints=(*body.layout.joints, "tail"), parents=(*body.parents, 0),
        groups=(*body.layout.groups, "tail"), resting=(),
    )  # fmt: skip
    tailed = replace(
        body, id="tailed", layout=tail, weights=np.pad(body.weights, ((0, 0), (0, 1))),
        J_regressor=np.vstack([body.J_regressor, body.J_regressor[:1]]),
        posedirs=np.pad(body.posedirs, ((0, 0), (0, 0), (0, 9))),
    )  # fmt: skip
    for name, one in (("ours", body), ("tailed", tailed)):
        found = load_body(write_body(tmp_path / f"{name}.npz", one)).layout
        assert (found.joints, found.parents, found.groups) == (one.layout.joints, one.parents, one.layout.groups)
        assert found == body.layout or one is tailed
