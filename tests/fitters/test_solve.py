"""From capture to motion: accuracy on the embedded capture, agreement of the backends, gaps, and bad input."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.evaluation.evaluate import evaluate
from solver_backend.exchange.diagnostics import read_diagnostics, sentence
from solver_backend.exchange.errors import JobInvalid, NoDetections, TakeTooShort, TooFewViews
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.priors.sposer import SPoser, load_sposer
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import FLAG_UNSEEN, Capture, Keypoints2D
from tests.support.short_motion import short_motion
from tests.support.short_solves import QUICK, cut


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture()


def hidden(capture: Capture, frames: slice, views: slice = slice(None)) -> Capture:
    keypoints = capture.keypoints
    assert keypoints is not None
    confidence = keypoints.confidence.copy()
    confidence[views, frames] = 0
    return replace(capture, keypoints=Keypoints2D(keypoints.xy, confidence, keypoints.joint_set, keypoints.fps))


def test_demo_capture_is_solved_to_its_promise(capture):
    """The figures of the README: 20 mm, 0.6 x the filtered triangulation in position and in acceleration."""
    motion = solve(capture).motion
    result = evaluate(capture, motion)
    assert result.joints_mpjpe_mm <= 20
    assert result.mpjpe_ratio is not None and result.mpjpe_ratio <= 0.6, result.lines()
    assert result.accel_ratio is not None and result.accel_ratio <= 0.6, result.lines()
    assert motion.num_frames == capture.num_frames and motion.fps == 60
    assert motion.keyframes is not None and 40 < motion.keyframes.sum() < 110
    assert motion.flags is not None and (motion.flags & FLAG_UNSEEN).sum() == 0
    floor = np.asarray(motion.keypoints3d)[..., 2].min(axis=1)
    assert np.abs(floor).max() < 0.06


@pytest.mark.slow
def test_a_world_whose_origin_is_far_away_is_solved_as_well(capture):
    short = cut(capture, 100, 140)
    assert short.cameras is not None
    moved = np.array([20_000.0, -10_000.0, 0.0])
    cameras = replace(short.cameras, t=short.cameras.t - short.cameras.R @ moved)
    here, there = solve(short, QUICK).motion, solve(replace(short, cameras=cameras), QUICK).motion
    off_m = np.linalg.norm(np.asarray(there.joints) - moved - np.asarray(here.joints), axis=-1)
    assert off_m.max() < 5e-4


@pytest.mark.parametrize("backend", ["numpy", pytest.param("torch", marks=pytest.mark.slow)])
def test_the_same_input_gives_the_same_bytes(capture, backend):
    pytest.importorskip(backend)
    short, settings = cut(capture, 100, 120), replace(QUICK, backend=backend)
    first, second = solve(short, settings).motion, solve(short, settings).motion
    for name in ("betas", "global_orient", "body_pose", "transl", "joints", "joint_covariance"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_the_record_names_the_prior_that_was_used(capture):
    class Another(SPoser):
        name = "another"

    shipped, quick = load_sposer(), SolveSettings(method="frame", iterations=1)
    another = Another(shipped._encoder, shipped._decoder, shipped.residual_sigma, {"sha256": "abc"})
    short = cut(capture, 100, 104)
    usual, other = (solve(short, quick, prior=prior).motion.provenance["prior"] for prior in (None, another))
    assert usual == {"name": "sposer", "weights": shipped.metadata["sha256"]}
    assert other == {"name": "another", "weights": "abc"}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["global", *(pytest.param(m, marks=pytest.mark.slow) for m in ("sliding", "frame"))])
def test_torch_equals_numpy(capture, method):
    pytest.importorskip("torch")
    short = cut(capture, 200, 241)
    one = solve(short, replace(QUICK, method=method)).motion
    other = solve(short, replace(QUICK, method=method, backend="torch")).motion
    np.testing.assert_allclose(other.joints, one.joints, atol=3e-5)


@pytest.mark.slow
def test_frame_method_is_accurate_enough_to_look_at(capture):
    short = cut(capture, 0, 60)
    motion = solve(short, SolveSettings(method="frame")).motion
    assert evaluate(short, motion).joints_mpjpe_mm < 40


def test_one_frame_is_solved_by_the_frame_method_and_named_by_the_bundle(capture):
    one = cut(capture, 30, 31)
    assert solve(one, SolveSettings(method="frame")).motion.num_frames == 1
    with pytest.raises(TakeTooShort, match=r"needs 4 frames, but the take has 1.*--method frame"):
        solve(one)


@pytest.mark.slow
def test_a_second_in_which_nobody_is_seen_is_bridged_and_flagged(capture):
    short = hidden(cut(capture, 60, 210), slice(40, 101))
    motion = solve(short, QUICK).motion
    assert motion.flags is not None
    unseen = (motion.flags & FLAG_UNSEEN) > 0
    assert unseen[40:101].all() and not unseen[:38].any() and not unseen[103:].any()
    error = np.linalg.norm(motion.joints - short.truth["joints"], axis=-1).mean(axis=1)
    assert error[:35].mean() < 0.02 and error[105:].mean() < 0.02
    speed = np.linalg.norm(np.diff(motion.joints, axis=0), axis=-1) * 60
    assert speed[38:104].max() < 6.0


@pytest.mark.slow
def test_the_frame_method_bridges_too(capture):
    short = hidden(cut(capture, 60, 140), slice(30, 50))
    motion = solve(short, SolveSettings(method="frame")).motion
    assert motion.flags is not None and ((motion.flags & FLAG_UNSEEN) > 0)[30:50].all()
    step = np.linalg.norm(np.diff(motion.joints[28:53], axis=0), axis=-1)
    assert step.max() < 0.15


def test_all_zero_confidences(capture):
    with pytest.raises(NoDetections, match="All confidences are zero"):
        solve(hidden(cut(capture, 0, 20), slice(None)))


def test_fewer_than_two_views(capture):
    with pytest.raises(TooFewViews, match="1 of 4 cameras have detections, but two are needed"):
        hidden(cut(capture, 0, 20), slice(None), slice(1, None)).require_multiview()
    for method in ("sliding", "frame", "noise-aware"):
        with pytest.raises(JobInvalid, match="needs two cameras"):
            solve(cut(capture, 0, 20).views([2]), SolveSettings(method=method))


@pytest.mark.slow
def test_windows_of_three_keys_and_screws_are_for_the_sliding_method(capture):
    short, curves = cut(capture, 0, 31), {"interpolation": 3, "root_curve": "screw"}
    motion = solve(short, replace(QUICK, method="sliding", window=30, **curves)).motion
    assert motion.keyframes is not None and np.flatnonzero(motion.keyframes).tolist() == [0, 10, 20, 30]
    assert motion.provenance["settings"]["interpolation"] == 3
    assert evaluate(short, motion).joints_mpjpe_mm < 40
    with pytest.raises(JobInvalid, match=r"'global' has no setting interpolation and root_curve.*method 'sliding'"):
        solve(short, replace(QUICK, **curves))


def test_settings_without_effect_are_named(capture):
    short = cut(capture, 0, 6)
    given = replace(QUICK, method="frame", iterations=1, smoothing=3.0, window=30, contacts=False)
    found = read_diagnostics(solve(short, given).motion.provenance["diagnostics"])
    (named,) = [item for item in found if item.code == "setting_without_effect"]
    assert named.severity == "warning"
    assert sentence(named).startswith("The method 'frame' does not use these settings: window, contacts, smoothing")


def test_methods_that_hold_to_no_start_refuse_one(capture):
    with pytest.raises(JobInvalid, match=r"'sliding' cannot start from a motion.*method 'global'"):
        solve(cut(capture, 0, 6), SolveSettings(method="sliding"), start=short_motion(6))


def test_settings_name_what_is_wrong():
    with pytest.raises(JobInvalid, match=r"window = 2 is not valid. It must be a whole number from 4 to 240"):
        SolveSettings(window=2)
    with pytest.raises(JobInvalid, match=r"residual_rotations = 'no' is not valid. It must be true or false"):
        SolveSettings(residual_rotations="no")  # type: ignore[arg-type]
    with pytest.raises(JobInvalid, match=r"Unknown setting windows.*Known settings: method, window"):
        SolveSettings.from_dict({"windows": 20})


def test_two_views_still_place_the_body(capture):
    short = cut(capture, 0, 80).views([0, 1])
    assert evaluate(short, solve(short, QUICK).motion).joints_mpjpe_mm < 60


@pytest.mark.slow
def test_keys_stand_as_close_in_time_at_half_the_frame_rate(capture):
    """Every second frame of the same take: as many keys, and no worse than the frames left out explain."""
    keypoints = capture.keypoints
    slow = Keypoints2D(keypoints.xy[:, :160:2], keypoints.confidence[:, :160:2], keypoints.joint_set, 30.0)
    truth = {n: v[:160:2] if n != "betas" and len(v) == capture.num_frames else v for n, v in capture.truth.items()}
    half = solve(replace(capture, keypoints=slow, truth=truth), QUICK).motion
    whole = solve(cut(capture, 0, 160), QUICK).motion
    assert abs(half.keyframes.sum() - whole.keyframes.sum()) <= 3
    errors = [
        np.linalg.norm(m.joints - t, axis=-1).mean()
        for m, t in ((half, truth["joints"]), (whole, capture.truth["joints"][:160]))
    ]
    assert errors[0] < 1.5 * errors[1]
