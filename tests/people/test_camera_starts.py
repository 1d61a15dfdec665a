"""Cameras that started apart: found with a margin, refused where nothing tells, left alone where they are in step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.agreement.starts import CameraStarts, StartEvidence, find_starts
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.simulation.cast import Take
from solver_backend.types import Capture, Detections
from tests.support.walking_take import circling, walk


def started(captures: list[Capture], starts: list[int], length: int) -> Detections:
    """Return what cameras recorded that started at these frames: everybody in the order of a frame's own luck."""
    cameras, first = captures[0].require_multiview()
    rng = np.random.default_rng(0)
    shape = (len(cameras), length, len(captures), *first.xy.shape[2:])
    xy, confidence = np.full(shape, np.nan, np.float32), np.zeros(shape[:-1], np.float32)
    for c, start in enumerate(starts):
        for p, capture in enumerate(captures):
            _, keypoints = capture.require_multiview()
            stop = min(start + length, keypoints.num_frames)
            xy[c, : stop - start, p] = keypoints.xy[c, start:stop]
            confidence[c, : stop - start, p] = keypoints.confidence[c, start:stop]
    order = rng.permuted(np.tile(np.arange(len(captures)), (len(cameras), length, 1)), axis=-1)[..., None]
    return Detections(
        cameras.names, np.take_along_axis(xy, order[..., None], axis=2), np.take_along_axis(confidence, order, axis=2),
        first.joint_set,
    )  # fmt: skip


def found(captures: list[Capture], starts: list[int], length: int) -> CameraStarts:
    cameras, keypoints = captures[0].require_multiview()
    return find_starts(cameras, started(captures, starts, length), keypoints.fps, np.zeros(len(starts), int))


def filmed(take: Take, seed: int = 1) -> Capture:
    return benchmark_capture(take, BenchmarkSettings(seed=seed))


@pytest.fixture(scope="module")
def demo() -> Capture:
    return demo_capture()


def against_first(starts: list[int]) -> list[int]:
    return [starts[0] - start for start in starts]


@pytest.mark.parametrize("starts", [[0, 45, 90, 20], [120, 0, 0, 0], [0, 0, 0, 100], [60, 61, 0, 119]])
def test_starts_are_found(demo, starts):
    result = found([demo], starts, 240)
    assert (result.evidence, result.doubtful) == (StartEvidence.APART, ())
    np.testing.assert_allclose(result.offsets, against_first(starts), atol=1)


@pytest.mark.parametrize("starts", [[0, 0, 0, 0], [30, 30, 30, 30], [3, 0, 0, 2]])
def test_cameras_in_step_stay(demo, starts):
    result = found([demo], starts, 240)
    assert result.evidence is StartEvidence.IN_STEP
    assert not result.offsets.any()


def test_a_doubtful_camera_spoils_no_start(demo):
    _, keypoints = demo.require_multiview()
    xy, starts = keypoints.xy.copy(), [0, 45, 90, 20]
    xy[1] = np.random.default_rng(0).uniform(0, 1000, xy[1].shape)
    result = found([replace(demo, keypoints=replace(keypoints, xy=xy))], starts, 240)
    assert (result.evidence, result.doubtful) == (StartEvidence.APART, (1,))
    np.testing.assert_allclose(result.offsets, [0, 0, -90, -20], atol=1)


def test_several_people_in_any_order_share_their_cameras_starts(demo):
    _, keypoints = demo.require_multiview()
    other = replace(
        demo, keypoints=replace(keypoints, xy=keypoints.xy[:, ::-1], confidence=keypoints.confidence[:, ::-1])
    )
    starts = [0, 45, 90, 20]
    np.testing.assert_allclose(found([demo, other], starts, 240).offsets, against_first(starts), atol=1)


@pytest.mark.slow
def test_steps_that_repeat_leave_it_open():
    still = walk(500)
    in_place = filmed(replace(still, root=still.root * [1.0, 1.0, 0.0]))
    result = found([in_place], [0, 45, 0, 0], 400)
    assert result.evidence is StartEvidence.AMBIGUOUS and not result.offsets.any()
    one, other = result.rivals
    assert abs(abs(one - other) % 60) in (0, 1, 59), "whole periods of the walk lie between"
    assert found([in_place], [0, 0, 0, 0], 400).evidence is StartEvidence.IN_STEP


@pytest.mark.slow
def test_a_person_who_stands_still_tells_nothing():
    take = walk(400)
    held = replace(take, rotations=np.repeat(take.rotations[:1], 400, 0), root=np.repeat(take.root[:1], 400, 0))
    for starts in ([0, 0, 0, 0], [0, 45, 90, 20]):
        result = found([filmed(held)], starts, 300)
        assert result.evidence is StartEvidence.STILL and not result.offsets.any()


@pytest.mark.slow
def test_a_camera_that_has_nothing_in_common_is_no_finding():
    result = found([filmed(circling(600))], [0, 400, 0, 0], 180)
    assert 1 in result.doubtful and not result.offsets.any()


def test_views_of_nobody_in_common_are_no_finding(demo):
    _, keypoints = demo.require_multiview()
    rng = np.random.default_rng(0)
    junk = replace(demo, keypoints=replace(keypoints, xy=rng.uniform(0, 1000, keypoints.xy.shape)))
    assert found([junk], [0, 0, 0, 0], 300).evidence is StartEvidence.STILL
