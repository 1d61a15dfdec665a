"""Whatever a public type is made of, it is either as it says or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps

from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.joint_sets import JointSet
from solver_backend.exchange.motion_file import MotionFile
from solver_backend.exchange.plausible import FARTHEST_M, FRAME_RATES, LARGEST_BETA, LARGEST_TURN
from solver_backend.types import Capture, Keypoints2D, MarkerCloud, MarkerSubject, Motion, PersonInViews
from tests.support.scenes import ring_of_cameras

NUMBERS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0.0, 1.0, -1.0, 1e5, 1e30, -7e37, 1e300])
)
RATES = st.one_of(st.sampled_from([60.0, 120.0]), NUMBERS)
SIZES = st.integers(0, 3)


def array(*shape: int) -> st.SearchStrategy[np.ndarray]:
    """Return arrays of a shape or, one time in a few, of another; mostly zeros, now and then any number."""
    usual = nps.arrays(np.float64, shape, elements=NUMBERS, fill=st.just(0.0))
    plain = st.just(np.zeros(shape))
    other = nps.arrays(np.float64, nps.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=3), fill=st.just(0.0))
    return st.one_of(plain, plain, plain, usual, other)


def made(make: Callable[..., Any], **parts: Any) -> Any:
    """Return what is made of the parts, None where it is refused by name."""
    try:
        return make(**parts)
    except MocapError:
        return None


def within(values: np.ndarray, most: float) -> bool:
    return bool(np.isfinite(values).all() and (np.abs(values) <= most).all())


@st.composite
def motion_parts(draw: st.DrawFn) -> dict[str, Any]:
    frames = draw(SIZES)
    return {
        "betas": draw(array(10)), "global_orient": draw(array(frames, 3)), "body_pose": draw(array(frames, 69)),
        "transl": draw(array(frames, 3)), "joints": draw(array(frames, 24, 3)), "fps": draw(RATES), "body": "neutral",
    }  # fmt: skip


@pytest.mark.slow
@given(motion_parts())
@settings(max_examples=150, deadline=None)
def test_motions(parts: dict[str, Any]) -> None:
    motion = made(Motion, **parts)
    if motion is None:
        return
    assert motion.num_frames > 0 and FRAME_RATES[0] <= motion.fps <= FRAME_RATES[1]
    assert (
        within(motion.transl, FARTHEST_M) and within(motion.joints, FARTHEST_M) and within(motion.betas, LARGEST_BETA)
    )
    assert within(motion.body_pose, LARGEST_TURN) and motion.joints.shape == (motion.num_frames, 24, 3)


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_motion_files(data: st.DataObject) -> None:
    frames = data.draw(SIZES)
    parts = {"rotvec": (frames, 24, 3), "transl": (frames, 3), "betas": (10,)}
    drawn = {name: data.draw(array(*shape)) for name, shape in parts.items()}
    motion = made(MotionFile, name="walk", fps=data.draw(RATES), **drawn)
    if motion is not None:
        assert motion.num_frames and within(motion.rotvec, LARGEST_TURN) and within(motion.transl, FARTHEST_M)


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_clouds(data: st.DataObject) -> None:
    frames, markers = data.draw(SIZES), data.draw(SIZES)
    labels = data.draw(st.one_of(st.none(), st.lists(st.text(max_size=3), max_size=3).map(tuple)))
    residual = data.draw(st.one_of(st.none(), array(frames, markers)))
    covariance = data.draw(st.one_of(st.none(), array(frames, markers, 3, 3)))
    cloud = made(MarkerCloud, positions=data.draw(array(frames, markers, 3)), fps=data.draw(RATES), labels=labels,
                 residual=residual, covariance=covariance)  # fmt: skip
    if cloud is None:
        return
    assert (
        cloud.positions.ndim == 3 and (len(cloud.positions) or not cloud.positions.shape[1]) and 0 < cloud.fps < np.inf
    )
    assert cloud.labels is None or len(cloud.labels) == cloud.positions.shape[1]
    assert cloud.residual is None or cloud.residual.shape == cloud.positions.shape[:2]


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_captures(data: st.DataObject) -> None:
    def keypoints() -> Keypoints2D | None:
        views, frames = data.draw(st.integers(1, 4)), data.draw(SIZES)
        shape = (views, frames, 17)
        return made(Keypoints2D, xy=data.draw(array(*shape, 2)), confidence=data.draw(array(*shape)),
                    joint_set=JointSet.COCO_17, fps=data.draw(RATES))  # fmt: skip

    found, other = keypoints(), keypoints()
    people = (PersonInViews("Ann", other),) if other is not None and data.draw(st.booleans()) else ()
    cameras = data.draw(st.sampled_from([None, ring_of_cameras(2), ring_of_cameras(3)]))
    footage = (None,) * data.draw(SIZES)
    capture = made(Capture, name="a", cameras=cameras, keypoints=found, people=people, footage=footage)
    if capture is None:
        return
    if cameras is not None and found is not None:
        assert len(cameras) == found.num_views and capture.views([0]).num_frames == found.num_frames
    assert cameras is None or not footage or len(footage) == len(cameras)


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_subjects(data: st.DataObject) -> None:
    count = data.draw(SIZES)
    labels = tuple(data.draw(st.lists(st.sampled_from("ABC"), min_size=count, max_size=count)))
    subject = made(MarkerSubject, body="neutral", betas=data.draw(array(10)), labels=labels, places=("LASI",) * count,
                   offsets=data.draw(array(count, 3)), sigma_m=data.draw(array(count)) + 0.01,
                   skin_m=data.draw(array(count)))  # fmt: skip
    if subject is not None:
        assert within(subject.sigma_m, FARTHEST_M) and (subject.sigma_m**2 > 0).all()
        assert within(subject.betas, LARGEST_BETA) and len(set(labels)) == count


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_layouts(data: st.DataObject) -> None:
    count = data.draw(st.integers(0, 6))
    names = tuple(data.draw(st.lists(st.text(max_size=2), min_size=count, max_size=count)))
    parents = tuple(data.draw(st.lists(st.integers(-3, 7), min_size=0, max_size=7)))
    layout = made(BodyLayout, name="a", joints=names, parents=parents, groups=names, resting=())
    if layout is not None:
        assert len(layout.parents) == len(layout.joints) == layout.num_joints
        assert layout.parents[0] == -1 and all(0 <= p < j for j, p in enumerate(layout.parents) if j)


@pytest.mark.parametrize("name", ["betas", "transl", "joints", "body_pose"])
def test_a_number_that_cannot_be_is_named_with_its_field(name: str) -> None:
    parts: dict[str, Any] = {
        "betas": np.zeros(10), "global_orient": np.zeros((2, 3)), "body_pose": np.zeros((2, 69)),
        "transl": np.zeros((2, 3)), "joints": np.zeros((2, 24, 3)), "fps": 60.0, "body": "neutral",
    }  # fmt: skip
    parts[name].flat[1] = 7e37
    with pytest.raises(MocapError, match="pose" if name == "body_pose" else name):
        Motion(**parts)


def test_a_recording_without_frames_is_named_so() -> None:
    with pytest.raises(MocapError, match="The recording of 42 markers has no frames.*Record or export it again"):
        MarkerCloud(np.zeros((0, 42, 3)), 60.0)


@pytest.mark.parametrize("place", [(1e8, 5.0), (np.inf, 5.0), (5.0, -1e30)])
def test_a_detection_beyond_any_picture_is_named_with_its_keypoint(place: tuple[float, float]) -> None:
    xy = np.zeros((2, 3, 17, 2))
    xy[1, 2, 16] = place
    with pytest.raises(MocapError, match=r"detection (lies at|is infinite).*view 1, frame 2, right_ankle"):
        Keypoints2D(xy, np.ones((2, 3, 17)), JointSet.COCO_17, 30.0)


@pytest.mark.parametrize(("name", "number"), [("t", 1e30), ("K", 1e300), ("distortion", -1e12), ("R", 1e300)])
def test_a_camera_that_cannot_be_is_named(name: str, number: float) -> None:
    cameras = ring_of_cameras(2)
    values = getattr(cameras, name).copy()
    values[1, 0] = number
    with pytest.raises(MocapError, match=f"{name} contains 1e"):
        replace(cameras, **{name: values})
