"""What a motion is worth against known truth, whatever was recorded: views, markers, or a motion edited afterwards."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.cli.main import main
from solver_backend.evaluation.evaluate import CODED_FRAMES, evaluate
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.priors import gaussian_vae
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, MarkerCloud, Motion

FRAMES = 90
OFF_M = np.array([0.003, 0.004, 0.0])


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(FRAMES)


@pytest.fixture(scope="module")
def motion(capture) -> Motion:
    """The true motion, 5 mm beside where it was."""
    truth = capture.truth
    return Motion(
        truth["betas"], truth["global_orient"], truth["body_pose"], truth["transl"] + OFF_M, capture.fps,
        load_body().id, truth["joints"] + OFF_M, keypoints3d=truth["keypoints3d"] + OFF_M,
        joint_set=capture.keypoints.joint_set,
    )  # fmt: skip


def test_views_are_judged_beside_the_filter(capture, motion):
    found = evaluate(capture, motion)
    assert found.joints_mpjpe_mm == pytest.approx(5.0) and found.joints_rmse_mm == pytest.approx(5.0)
    assert found.keypoints_mpjpe_mm == pytest.approx(5.0)
    assert found.baseline_mpjpe_mm is not None and found.baseline_mpjpe_mm > 5.0
    assert (found.joints_pck1_percent, found.joints_pck7_percent) == (100.0, 100.0)
    assert found.angles_mae_deg == pytest.approx(0.0, abs=1e-4)
    assert found.mpjpe_ratio == pytest.approx(5.0 / found.baseline_mpjpe_mm)


REFERENCE = {"RHip": 2, "LHip": 1, "R_Knee": 5, "LKnee": 4, "right_ankle": 8, "LWrist": 20, "STRN": 9}


@pytest.fixture
def reference(capture) -> Capture:
    """Joint centres of another system at twice the rate, one without a joint's name and one missing at first."""
    points = np.array(capture.truth["joints"])[:, list(REFERENCE.values())]
    between = (points[1:] + points[:-1]) / 2
    positions = np.empty((2 * len(points) - 1, *points.shape[1:]))
    positions[::2], positions[1::2] = points, between
    positions[:4, 0] = np.nan
    return Capture("vicon", markers=MarkerCloud(positions, 2 * capture.fps, tuple(REFERENCE)))


def test_joint_centres_of_another_system_are_compared_by_name_and_time(reference, motion):
    found = evaluate(reference, motion)
    assert found.joints_mpjpe_mm == pytest.approx(5.0) and found.joints_pa_mpjpe_mm < 1e-6
    assert found.joints_moved_mpjpe_mm == pytest.approx(0.0, abs=1e-6)
    assert found.compared == ("right_hip", "left_hip", "right_knee", "left_knee", "right_ankle", "left_wrist")
    assert found.lines()[-1].endswith("right_hip, left_hip, right_knee, left_knee, right_ankle, left_wrist")


def test_keypoints_of_the_face_are_those_of_the_joint_set(capture, motion, reference):
    nose = np.array(capture.truth["keypoints3d"])[:, [0]]
    names = (*(f"{side}Ear" for side in "LR"), "Nose")
    ears = [motion.joint_set.keypoints.index(f"{side}_ear") for side in ("left", "right")]
    points = np.concatenate([np.array(capture.truth["keypoints3d"])[:, ears], nose], axis=1)
    markers = MarkerCloud(points, capture.fps, names)
    assert evaluate(replace(reference, markers=markers), motion).joints_mpjpe_mm == pytest.approx(5.0)


def test_a_reference_of_another_length_or_without_names_of_joints_is_refused(reference, motion):
    markers = reference.markers
    with pytest.raises(MotionInvalid, match="the reference 0.50 s"):
        evaluate(replace(reference, markers=replace(markers, positions=markers.positions[:60])), motion)
    positions = np.full_like(markers.positions, np.nan)
    positions[:, :2] = markers.positions[:, :2]
    with pytest.raises(MotionInvalid, match="fewer than three of its points"):
        evaluate(replace(reference, markers=replace(markers, positions=positions)), motion)
    with pytest.raises(MotionInvalid, match="fewer than three of its points"):
        evaluate(replace(reference, markers=replace(markers, labels=tuple("abcdefg"))), motion)


def test_a_hand_in_the_thigh_is_counted_beside_the_truth(capture, motion):
    joints = motion.joints.copy()
    joints[:9, [20, 22]] = joints[:9, [1, 4]]  # the left forearm and hand along the left thigh's axis
    found = evaluate(capture, replace(motion, joints=joints))
    assert found.self_intersection_true_percent is not None and found.self_intersection_percent is not None
    assert found.self_intersection_percent - found.self_intersection_true_percent == pytest.approx(10.0, abs=1e-6)
    assert any("body through itself" in line for line in found.lines())


def test_a_motion_without_keypoints_is_judged_by_its_joints(capture, motion):
    found = evaluate(capture, replace(motion, keypoints3d=None, joint_set=None))
    assert found.joints_mpjpe_mm == pytest.approx(5.0)
    assert found.keypoints_mpjpe_mm is None and found.baseline_mpjpe_mm is not None
    assert found.mpjpe_ratio == pytest.approx(5.0 / found.baseline_mpjpe_mm)


def test_a_solve_of_markers_is_judged_by_joints_and_markers(capture, motion):
    markers = capture.truth["joints"][:, :9] + 0.1
    recorded = Capture("markers", markers=MarkerCloud(markers, capture.fps, tuple("ABCDEFGHI")),
                       truth={**capture.truth, "markers": markers})  # fmt: skip
    del recorded.truth["keypoints3d"]
    solved = replace(
        motion, keypoints3d=None, joint_set=None, markers=markers - OFF_M, marker_labels=tuple("ABCDEFGHI")
    )
    found = evaluate(recorded, solved)
    assert found.joints_mpjpe_mm == pytest.approx(5.0) and found.markers_mpjpe_mm == pytest.approx(5.0)
    assert found.baseline_mpjpe_mm is None and found.mpjpe_ratio is None and found.accel_ratio is None
    assert "markers" in "\n".join(found.lines()) and "filter" not in "\n".join(found.lines())
    assert found.figures().keys().isdisjoint({"mpjpe_ratio", "baseline_mpjpe_mm", "keypoints_mpjpe_mm"})
    other = replace(solved, marker_labels=tuple("ABCDEFGHX"))
    assert evaluate(recorded, other).markers_mpjpe_mm is None


def test_poses_are_judged_by_realism_and_diversity_of_their_codes(capture, motion):
    found = evaluate(capture, motion).figures()
    assert found["codes_fid"] == 0.0 and found["codes_div"] == found["codes_div_true"] > 1.0
    still = replace(motion, body_pose=np.tile(motion.body_pose[:1], (FRAMES, 1)))
    frozen = evaluate(capture, still).figures()
    assert frozen["codes_fid"] > 1.0 and frozen["codes_div"] == 0.0
    assert frozen["angles_mae_deg"] > 1.0 and frozen["codes_div_true"] == found["codes_div_true"]


def test_few_frames_have_no_figures_of_codes():
    short = demo_capture(CODED_FRAMES - 1)
    truth = short.truth
    motion = Motion(truth["betas"], truth["global_orient"], truth["body_pose"], truth["transl"], short.fps,
                    load_body().id, truth["joints"])  # fmt: skip
    found = evaluate(short, motion)
    assert found.codes_fid is None and found.codes_div is None and found.joints_mpjpe_mm == 0.0


def test_without_vposers_weights_the_other_figures_are_there(capture, motion, tmp_path, monkeypatch):
    monkeypatch.setattr(gaussian_vae, "ASSETS", tmp_path)  # as in the extension, which leaves them out
    found = evaluate(capture, motion)
    assert found.codes_fid is None and "VPoser" not in "\n".join(found.lines()) and found.angles_mae_deg == 0.0


def test_a_capture_that_knows_no_truth_is_refused(capture, motion):
    with pytest.raises(MotionInvalid, match="has no ground truth"):
        evaluate(replace(capture, truth={}), motion)


def test_feet_and_alignments_are_judged(capture, motion):
    found = evaluate(capture, motion)
    assert found.joints_pa_mpjpe_mm == pytest.approx(0.0, abs=1e-6)
    assert found.joints_wa_mpjpe_100_mm == pytest.approx(0.0, abs=1e-6)
    assert found.joints_w_mpjpe_100_mm == pytest.approx(0.0, abs=1e-6)
    assert found.skating_cm_per_frame == pytest.approx(found.skating_true_cm_per_frame)
    slides = np.linspace(0.0, 1.0, FRAMES)[:, None, None] * [1.0, 0.0, 0.0]
    sliding = evaluate(capture, replace(motion, joints=motion.joints + slides))
    assert sliding.skating_cm_per_frame > found.skating_cm_per_frame + 0.1
    assert "foot skating" in "\n".join(sliding.lines())


def test_the_verb_compares_a_motion_of_some_frames_with_these_of_the_capture(capture, motion, tmp_path, capsys):
    write_capture(tmp_path / "take.npz", capture)
    part = {name: getattr(motion, name)[20:60] for name in ("global_orient", "body_pose", "transl", "joints")}
    write_motion(tmp_path / "part.npz", replace(motion, **part, keypoints3d=None, joint_set=None))
    verb = ["evaluate", str(tmp_path / "take.npz"), str(tmp_path / "part.npz")]
    assert main(verb) != 0
    assert "--frames" in capsys.readouterr().err
    assert main([*verb, "--frames", "20", "59", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["joints_mpjpe_mm"] == pytest.approx(5.0)


def test_a_motion_of_other_frames_is_refused_instead_of_nan(capture, motion):
    part = {name: getattr(motion, name)[:50] for name in ("global_orient", "body_pose", "transl", "joints")}
    with pytest.raises(MotionInvalid, match="50 frames.*90"):
        evaluate(capture, replace(motion, **part, keypoints3d=None, joint_set=None))
