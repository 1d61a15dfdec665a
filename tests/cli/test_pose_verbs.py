"""denoise, complete, sample and interpolate from the command line: files, provenance, errors and exit codes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.mesh import pose_mesh
from solver_backend.cli.main import main
from solver_backend.exchange.errors import Cancelled
from solver_backend.fitters.hands.solve_hands import finger_turns_of, with_finger_turns
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.metrics import pa_mpjpe_mm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Motion
from tests.support.pose_ndf_weights import random_prior
from tests.support.scenes import small_motion

FRAMES = 8


@pytest.fixture
def weights(tmp_path: Path) -> str:
    random_prior(tmp_path)
    return str(tmp_path / "pose_ndf.npz")


@pytest.fixture
def take(tmp_path: Path) -> str:
    body, rng = load_body(), np.random.default_rng(0)
    pose = np.concatenate([0.3 * rng.standard_normal((FRAMES, 63)), 0.1 * np.ones((FRAMES, 6))], axis=1)
    root, transl = 0.1 * rng.standard_normal((FRAMES, 3)), 0.1 * rng.standard_normal((FRAMES, 3))
    local = exp_so3(pose[:, :63].reshape(FRAMES, 21, 3))
    joints = forward_kinematics(body, np.zeros(10), exp_so3(root), local, transl).joints
    contacts = rng.uniform(size=(FRAMES, 2)) > 0.5
    motion = Motion(
        np.zeros(10), root, pose, transl, 30.0, body.id, joints, contacts=contacts,
        provenance={"sources": ["take"], "edits": [{"verb": "earlier"}]},
    )  # fmt: skip
    return str(write_motion(tmp_path / "take.npz", motion))


def result(capsys) -> dict:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_denoise_writes_a_smoother_motion_that_remembers_where_it_came_from(take, weights, tmp_path, capsys):
    out = tmp_path / "new" / "clean.npz"
    assert main(["motion denoise", take, str(out), "--prior", weights, "--smoothness", "9", "--json"]) == 0
    told = result(capsys)
    before, after = read_motion(take), read_motion(out)
    assert told["event"] == "result" and told["frames"] == FRAMES and told["motion"] == str(out)
    speed = [np.linalg.norm(np.diff(m.joints, axis=0), axis=-1).mean() for m in (before, after)]
    assert speed[1] < 0.5 * speed[0]
    assert [e["verb"] for e in after.provenance["edits"]] == ["earlier", "motion denoise"]
    assert after.provenance["sources"] == ["take"] and len(after.provenance["edits"][1]["weights"]) == 64
    np.testing.assert_array_equal(after.contacts, before.contacts)
    np.testing.assert_allclose(after.body_pose[:, 63:], before.body_pose[:, 63:])
    body = load_body()
    local = exp_so3(after.body_pose[:, :63].reshape(FRAMES, 21, 3))
    joints = forward_kinematics(body, after.betas, exp_so3(after.global_orient), local, after.transl).joints
    np.testing.assert_allclose(after.joints, joints, atol=1e-5)


def test_denoise_can_leave_the_root_alone(take, weights, tmp_path):
    out = tmp_path / "clean.npz"
    assert main(["motion denoise", take, str(out), "--prior", weights, "--keep-root", "--manifold", "0.1"]) == 0
    before, after = read_motion(take), read_motion(out)
    np.testing.assert_allclose(after.transl, before.transl, atol=1e-6)
    np.testing.assert_allclose(after.global_orient, before.global_orient, atol=1e-5)


def test_complete_changes_the_missing_limb_alone(take, weights, tmp_path):
    out = tmp_path / "whole.npz"
    assert main(["motion complete", take, str(out), "--prior", weights, "--missing", "left_leg", "head"]) == 0
    before, after = read_motion(take), read_motion(out)
    turned = exp_so3(after.body_pose.reshape(FRAMES, 23, 3)) @ np.swapaxes(
        exp_so3(before.body_pose.reshape(FRAMES, 23, 3)), -1, -2
    )
    moved = np.linalg.norm(log_so3(turned), axis=-1).max(axis=0) > 1e-4
    assert set(np.flatnonzero(moved)) == {0, 3, 6, 9, 14}
    assert after.provenance["edits"][-1]["missing"] == ["left_leg", "head"]


def test_samples_stand_on_the_floor_and_repeat_with_their_seed(weights, tmp_path):
    paths = [tmp_path / name for name in ("a.npz", "b.npz", "c.npz")]
    for path, seed in zip(paths, ("3", "3", "4"), strict=True):
        assert main(["motion sample", str(path), "--count", "5", "--seed", seed, "--prior", weights]) == 0
    a, b, c = (read_motion(path) for path in paths)
    np.testing.assert_array_equal(a.body_pose, b.body_pose)
    assert a.num_frames == 5 and np.abs(a.body_pose - c.body_pose).max() > 0.1
    local = exp_so3(a.body_pose[:, :63].reshape(5, 21, 3))
    mesh = pose_mesh(load_body(), a.betas, exp_so3(a.global_orient), local, a.transl)
    np.testing.assert_allclose(mesh[..., 2].min(axis=1), 0.0, atol=1e-4)
    assert (mesh[..., 2].max(axis=1) > 0.3).all()


def test_interpolation_begins_and_ends_with_the_frames(take, weights, tmp_path):
    out = tmp_path / "between.npz"
    assert main(["motion interpolate", take, str(out), "--frames", "6", "1", "--count", "3", "--prior", weights]) == 0
    before, after = read_motion(take), read_motion(out)
    assert after.num_frames == 5
    for frame, source in ((0, 6), (-1, 1)):
        np.testing.assert_allclose(
            exp_so3(after.body_pose[frame, :63].reshape(21, 3)), exp_so3(before.body_pose[source, :63].reshape(21, 3)),
            atol=1e-5,
        )  # fmt: skip
        np.testing.assert_allclose(after.transl[frame], before.transl[source], atol=1e-6)
    steps = np.diff(after.transl, axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-6)


@pytest.mark.parametrize(
    ("argv", "code", "name"),
    [
        (["motion complete", "TAKE", "OUT", "--missing", "tail"], 2, "job_invalid"),
        (["motion complete", "TAKE", "OUT"], 2, "command_line_invalid"),
        (["motion interpolate", "TAKE", "OUT", "--frames", "0", "8", "--count", "3"], 2, "job_invalid"),
        (["motion interpolate", "TAKE", "OUT", "--frames", "2", "2", "--count", "3"], 2, "job_invalid"),
        (["motion interpolate", "TAKE", "OUT", "--frames", "0", "3", "--count", "0"], 2, "job_invalid"),
        (["motion sample", "OUT", "--count", "0"], 2, "job_invalid"),
        (["motion denoise", "TAKE", "OUT", "--smoothness", "-1"], 2, "command_line_invalid"),
        (["motion denoise", "TAKE", "OUT", "--manifold", "nan"], 2, "command_line_invalid"),
        (["motion denoise", "missing.npz", "OUT"], 3, "file_missing"),
        (["motion denoise", "TAKE", "TAKE"], 3, "output_exists"),
        (["motion sample", "OUT", "--prior", "missing.npz"], 3, "file_missing"),
    ],
)
def test_what_is_wrong_is_named_and_nothing_is_written(take, weights, tmp_path, capsys, argv, code, name):
    out = tmp_path / "out.npz"
    argv = [{"TAKE": take, "OUT": str(out)}.get(a, a) for a in argv]
    argv += [] if "--prior" in argv or name == "command_line_invalid" else ["--prior", weights]
    assert main([*argv, "--json"]) == code
    assert result(capsys)["code"] == name
    assert not out.exists()


def test_a_motion_of_another_body_is_refused(weights, tmp_path, capsys):
    path = write_motion(tmp_path / "other.npz", small_motion())
    assert main(["motion denoise", str(path), str(tmp_path / "out.npz"), "--prior", weights, "--json"]) == 3
    told = result(capsys)
    assert told["code"] == "motion_invalid" and "was solved with the body neutral-1" in told["message"]


def test_cancelling_leaves_nothing_behind(take, weights, tmp_path, monkeypatch, capsys):
    def cancelled(*_):
        raise Cancelled("The work was cancelled.")

    monkeypatch.setattr("solver_backend.fitters.pose_ndf.edit_motion.denoise", cancelled)
    assert main(["motion denoise", take, str(tmp_path / "out.npz"), "--prior", weights, "--json"]) == 130
    assert result(capsys)["code"] == "cancelled"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pose_ndf.npz", "take.npz"]


def test_a_motion_is_fitted_anew_to_the_keypoints_of_one_view(tmp_path, capsys):
    capture = demo_capture(4)
    truth, body = capture.truth, load_body()
    seen = capture.keypoints.confidence * (np.arange(len(capture.cameras)) == 0)[:, None, None]
    one = replace(capture, keypoints=replace(capture.keypoints, confidence=seen))
    rng = np.random.default_rng(3)
    local = exp_so3(truth["body_pose"][:, :63].reshape(4, 21, 3)) @ exp_so3(0.15 * rng.standard_normal((4, 21, 3)))
    root, transl = exp_so3(truth["global_orient"]), truth["transl"] + 0.05 * rng.standard_normal((4, 3))
    pose = truth["body_pose"].copy()
    pose[:, :63] = log_so3(local).reshape(4, 63)
    joints = forward_kinematics(body, truth["betas"], root, local, transl).joints
    start = Motion(truth["betas"], truth["global_orient"], pose, transl, capture.fps, body.id, joints)
    files = [str(tmp_path / name) for name in ("one.npz", "start.npz", "fitted.npz")]
    write_capture(files[0], one)
    write_motion(files[1], start)
    assert main(["motion fit", *files, "--json"]) == 0
    assert result(capsys)["frames"] == 4
    found = read_motion(files[2])
    off = [pa_mpjpe_mm(motion.joints, truth["joints"]) for motion in (start, found)]
    assert off[1] < 0.7 * off[0] and found.provenance["edits"][-1]["verb"] == "motion fit"
    short = replace(small_motion(3, optional=False), body=body.id)
    write_motion(files[1], short, overwrite=True)
    assert main(["motion fit", *files, "--overwrite", "--json"]) == 3
    assert "The motion has 3 frames, but the capture has 4" in capsys.readouterr().out
    assert main(["motion fit", *files, "--noise-px", "0", "--overwrite"]) != 0


@pytest.fixture
def fingered(take: str, tmp_path: Path) -> str:
    """Return the take with fingers that move."""
    turns = 0.3 * np.random.default_rng(3).standard_normal((FRAMES, 30, 3))
    return str(write_motion(tmp_path / "fingered.npz", with_finger_turns(read_motion(take), load_body(), turns)))


def test_denoise_and_complete_keep_the_fingers(fingered, weights, tmp_path):
    before = finger_turns_of(read_motion(fingered))
    for verb in (["motion denoise"], ["motion complete"]):
        out = tmp_path / f"{verb[0]}.npz"
        more = ["--missing", "left_arm"] if verb == ["motion complete"] else []
        assert main([*verb, fingered, str(out), "--prior", weights, *more]) == 0
        np.testing.assert_allclose(finger_turns_of(read_motion(out)), before, atol=1e-6)


def test_interpolated_fingers_turn_evenly(fingered, weights, tmp_path):
    out, ends = tmp_path / "between.npz", exp_so3(finger_turns_of(read_motion(fingered))[[1, 6]])
    assert (
        main(["motion interpolate", fingered, str(out), "--frames", "1", "6", "--count", "3", "--prior", weights]) == 0
    )
    found = exp_so3(finger_turns_of(read_motion(out)))
    np.testing.assert_allclose(found[[0, -1]], ends, atol=1e-5)
    steps = np.linalg.norm(log_so3(np.swapaxes(found[:-1], -1, -2) @ found[1:]), axis=-1)
    np.testing.assert_allclose(steps, np.broadcast_to(steps.mean(0), steps.shape), atol=1e-4)
