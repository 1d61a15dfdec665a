"""A frame range solved again: what lies outside stays, pins are met, and what was wrong gets better."""

from dataclasses import fields, replace

import numpy as np
import pytest

from solver_backend.exchange.errors import JobInvalid, MotionInvalid
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import resolve_range, solve
from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
from solver_backend.fitters.measurements.views import CONSTANT_M
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, JointSet, Motion
from tests.support.short_solves import QUICK, cut

FIRST, LAST = 30, 70
BODY = JointSet.BODY_25.keypoints


@pytest.fixture(scope="module")
def capture() -> Capture:
    return cut(demo_capture(), 200, 300)


@pytest.fixture(scope="module")
def solved(capture) -> Motion:
    return solve(capture, QUICK).motion


def error_mm(motion: Motion, capture: Capture, frames: slice) -> float:
    return 1000 * float(np.linalg.norm(motion.joints - capture.truth["joints"], axis=-1)[frames].mean())


def spoiled(motion: Motion) -> Motion:
    """Return the motion with both arms thrown up within the range."""
    pose = motion.body_pose.copy()
    pose[FIRST + 1 : LAST, 45:51] += 1.0
    return replace(motion, body_pose=pose)


@pytest.fixture(scope="module")
def mended(capture, solved) -> Motion:
    """Return the motion whose range was spoiled and solved again."""
    return resolve_range(capture, spoiled(solved), FrameRange(FIRST, LAST), QUICK).motion


def test_a_spoiled_range_is_mended(capture, solved, mended):
    inside = slice(FIRST + 1, LAST)
    assert error_mm(mended, capture, inside) < 1.15 * error_mm(solved, capture, inside)
    step = np.linalg.norm(np.diff(mended.joints, axis=0), axis=-1).max(axis=1)
    assert step[[FIRST, LAST - 1]].max() < 1.5 * np.delete(step, [FIRST, LAST - 1]).max()
    assert mended.provenance["resolved"] == [{"first": FIRST, "last": LAST, "pins": []}]


@pytest.mark.slow
def test_a_pinned_pose_is_met_and_its_neighbours_follow(capture, solved):
    frame = 50
    pose = solved.body_pose[frame].copy()
    pose[45:48] += [0.0, 0.0, 0.4]
    pin = Pin(frame, solved.global_orient[frame], pose, solved.transl[frame])
    moved = resolve_range(capture, solved, FrameRange(FIRST, LAST, (pin,)), QUICK).motion
    np.testing.assert_allclose(moved.body_pose[frame, :63], pose[:63], atol=1e-6)
    assert moved.joint_sigma[FIRST : LAST + 1].max() < 2 * solved.joint_sigma.max()
    assert moved.joint_sigma[frame].max() < 1.05 * CONSTANT_M, "a pinned pose is as certain as the shape"
    change = np.linalg.norm(moved.joints - solved.joints, axis=-1).max(axis=1)
    assert change[frame] > 0.05
    assert change[frame - 1] > 0.5 * change[frame] and change[frame + 1] > 0.5 * change[frame]


@pytest.mark.slow
def test_a_pinned_frame_is_certain_and_beside_it_only_what_the_pin_moved_is_doubtful(capture, solved):
    frame = 50
    pose = solved.body_pose[frame].copy()
    pose[51:54] += [0.0, 0.0, 1.2]
    pin = Pin(frame, solved.global_orient[frame], pose, solved.transl[frame])
    again = resolve_range(capture, solved, FrameRange(FIRST, LAST, (pin,)), QUICK).motion
    change = np.linalg.norm(again.joints - solved.joints, axis=-1)
    assert change[frame].max() > 0.15, "the pin contradicts the views"
    assert again.flags[frame] == 0 and again.joint_sigma[frame].max() < 1.05 * CONSTANT_M
    still = change.max(axis=0) < 0.02
    assert still.sum() > 15 and not still[[20, 22]].any(), "wrist and hand alone follow the elbow"
    near = slice(frame - 4, frame + 5)
    assert again.joint_sigma[near][:, still].max() < 2 * solved.joint_sigma[near].max()
    assert not (again.flags[near] & ~solved.flags[near]).any(), "no whole frame is doubtful for a pin"


@pytest.mark.slow
def test_frames_that_nothing_changed_are_found_again(capture, solved):
    """The same data, shape and noise: what is left is where keys stand and how feet are judged.

    The take lies on a spline, what is solved again on its windows' own; so the first time moves most, and
    every further time a third as far.
    """
    again = resolve_range(capture, solved, FrameRange(FIRST, LAST), QUICK).motion
    moved = 1000 * np.linalg.norm(again.joints - solved.joints, axis=-1)[FIRST + 1 : LAST]
    assert moved.mean() < 4.0 and moved.max() < 25.0
    twice = resolve_range(capture, again, FrameRange(FIRST, LAST), QUICK).motion
    settled = 1000 * np.linalg.norm(twice.joints - again.joints, axis=-1)[FIRST + 1 : LAST]
    assert settled.mean() < 0.25 * moved.mean() and settled.max() < 2.0
    thrice = resolve_range(capture, twice, FrameRange(FIRST, LAST), QUICK).motion
    still = 1000 * np.linalg.norm(thrice.joints - twice.joints, axis=-1)[FIRST + 1 : LAST]
    assert still.mean() < 0.25 and still.max() < 1.0


@pytest.mark.slow
def test_pinned_poses_are_passed_through_exactly(capture, solved):
    """At an end of the range, in its middle, and off the prior's manifold; rotations, root and place."""
    rng, pins = np.random.default_rng(6), []
    for frame in (FIRST, 45, 46):
        orient = solved.global_orient[frame] + 0.1 * rng.normal(size=3)
        pose = solved.body_pose[frame] + np.r_[0.2 * rng.normal(size=63), np.zeros(6)]
        pins.append(Pin(frame, orient, pose, solved.transl[frame] + 0.05 * rng.normal(size=3)))
    solution = resolve_range(capture, solved, FrameRange(FIRST, LAST, tuple(pins)), QUICK)
    for pin in pins:
        for name in ("global_orient", "body_pose", "transl"):
            found = getattr(solution.motion, name)[pin.frame]
            np.testing.assert_allclose(found[:63], getattr(pin, name)[:63], atol=1e-9, err_msg=name)
    assert solution.motion.provenance["status"] == solution.status


def test_frames_outside_do_not_move_at_all(solved, mended):
    """Every array of the motion, bit for bit, whatever it holds; the ends keep their poses, as no pin stands there."""
    outside = np.r_[0 : FIRST + 1, LAST : solved.num_frames]
    compared = set()
    for field in fields(Motion):
        old, new = getattr(solved, field.name), getattr(mended, field.name)
        if isinstance(old, np.ndarray):
            frames = (slice(None), outside) if field.name == "reprojection_px" else outside
            old, new = (old, new) if field.name == "betas" else (old[frames], new[frames])
            assert old.tobytes() == new.tobytes(), field.name
            compared.add(field.name)
    assert {"global_orient", "body_pose", "transl", "joints", "joint_sigma", "keypoints3d"} <= compared
    assert {"flags", "keyframes", "contacts", "reprojection_px", "joint_covariance", "betas"} <= compared


@pytest.mark.slow
def test_the_whole_take_can_be_the_range(capture, solved):
    again = resolve_range(capture, solved, FrameRange(0, solved.num_frames - 1), QUICK).motion
    assert error_mm(again, capture, slice(None)) < 1.1 * error_mm(solved, capture, slice(None))


@pytest.mark.parametrize(
    ("frame_range", "message"),
    [
        (FrameRange(50, 50), "not a valid range in this take of 100 frames"),
        (FrameRange(-1, 20), "not a valid range"),
        (FrameRange(20, 100), "from 0 to 99, the earlier one first"),
        (FrameRange(20, 40, (Pin(60, np.zeros(3), np.zeros(69), np.zeros(3)),)), "pinned at frame 60, outside frames"),
    ],
)
def test_a_range_outside_the_take_is_named(capture, solved, frame_range, message):
    with pytest.raises(JobInvalid, match=message):
        resolve_range(capture, solved, frame_range, QUICK)


def test_a_motion_of_another_take_or_body_is_named(capture, solved):
    with pytest.raises(MotionInvalid, match="has 100 frames at 60 fps, but the capture has 50"):
        resolve_range(cut(capture, 0, 50), solved, FrameRange(10, 20), QUICK)
    with pytest.raises(MotionInvalid, match="with the body smpl_male"):
        resolve_range(capture, replace(solved, body="smpl_male"), FrameRange(10, 20), QUICK)


def test_plain_values_are_checked_and_read_back():
    pin = {"frame": 5, "global_orient": [0.0] * 3, "body_pose": [0.1] * 69, "transl": [0.0, 0.0, 1.0]}
    values = {"first": 2, "last": 9, "pins": [pin]}
    assert FrameRange.from_dict(values).as_dict() == values
    for change, message in (
        ({"first": 2.5}, "first is 2.5, but a whole number"),
        ({"frames": 3}, "no other keys"),
        ({"pins": [{**pin, "transl": [0.0, float("nan"), 1.0]}]}, "transl contains NaN or infinite values"),
        ({"pins": [{**pin, "transl": [0.0, 1.0]}]}, "transl must be 3 numbers"),
        ({"pins": [{**pin, "global_orient": [0.0, 1e300, 1.0]}]}, r"global_orient contains 1e\+300"),
        ({"pins": [{**pin, "body_pose": [0.0] * 63}]}, "body_pose must be 69"),
    ):
        with pytest.raises(JobInvalid, match=message):
            FrameRange.from_dict({**values, **change})


@pytest.mark.slow
def test_settings_without_residual_rotations_also_work(capture, solved):
    again = resolve_range(capture, solved, FrameRange(FIRST, LAST), SolveSettings(residual_rotations=False)).motion
    assert np.isfinite(again.joints).all()


@pytest.mark.slow
def test_feet_that_stand_beyond_the_range_do_not_slip_at_its_ends():
    """The left foot stands throughout, the right one at the start; hips and knees were bent by hand in the range."""
    # With the four linearisations of QUICK a take that starts at its fine keys is not at rest, and its feet slip.
    capture, frame_range, settled = cut(demo_capture(), 0, 120), FrameRange(65, 105), replace(QUICK, iterations=8)
    solved = solve(capture, settled).motion
    pose = solved.body_pose.copy()
    pose[66:105, [0, 3, 9, 12]] += 0.3
    spoiled = replace(solved, body_pose=pose)

    def slip_mm(contacts: bool) -> float:
        points = resolve_range(capture, spoiled, frame_range, replace(settled, contacts=contacts)).motion.keypoints3d
        stands = [points[3:117, BODY.index("left_big_toe")], points[43:86, BODY.index("right_big_toe")]]
        return 1000 * max(float(np.linalg.norm(stand - stand.mean(axis=0), axis=-1).max()) for stand in stands)

    assert slip_mm(True) < 8.0 < 15.0 < slip_mm(False)


@pytest.mark.slow
def test_a_motion_of_other_views_is_named(capture, solved):
    assert solved.reprojection_px is not None
    other = replace(solved, reprojection_px=solved.reprojection_px[:2])
    with pytest.raises(MotionInvalid, match="reprojection_px has the shape"):
        resolve_range(capture, other, FrameRange(FIRST, LAST), QUICK)
