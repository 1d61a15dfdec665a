"""Keys stand closer where people move faster."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.fitters.keyframes.initial_keys import dense_layout, window_of
from solver_backend.fitters.keyframes.normal_equations import BundleModel, BundleObjective
from solver_backend.fitters.model.keyframe_curve import keys_at
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import FrameObjective, Keyframes, Subject
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import JointSet
from tests.support.layouts import WHOLE
from tests.support.scenes import small_motion

LAYOUT = KeyframeLayout.even(121, 10)
FPS = 60.0


def model() -> BundleModel:
    body = load_body()
    subject = Subject.average(body, keypoint_landmarks(body, JointSet.COCO_17), np.zeros(1))
    return BundleModel(subject, load_sposer(), BundleObjective(FrameObjective(())), WHOLE)


def swaying(acceleration: float) -> Keyframes:
    """Return keys of somebody who is moved to and fro once a second, with this mean acceleration in m/s²."""
    prior, times, count = load_sposer(), LAYOUT.key_times, LAYOUT.num_keys
    amplitude = acceleration * np.pi / 2 / (2 * np.pi) ** 2
    transl = np.zeros((count, 3))
    transl[:, 0] = amplitude * np.sin(2 * np.pi * times / FPS)
    z = np.repeat(prior.encode(np.broadcast_to(np.eye(3), (1, 21, 3, 3))), count, axis=0)
    return Keyframes(z, np.tile([1.0, 0, 0, 0], (count, 1)), transl, np.zeros((count, 21, 3)))


@pytest.mark.parametrize(("acceleration", "window"), [(3.0, 10), (5.5, 10), (8.0, 8), (15.5, 6), (60.0, 6)])
def test_windows_shorten_with_the_root_of_acceleration(acceleration, window):
    layout = dense_layout(model(), LAYOUT, swaying(acceleration), 10, FPS)
    assert (layout is LAYOUT) == (window == 10)
    np.testing.assert_array_equal(layout.bounds, KeyframeLayout.even(121, window).bounds)


def test_the_rate_does_not_matter():
    keys = swaying(15.5)  # at half the rate the same frames are half as fast: a quarter of the acceleration
    assert dense_layout(model(), LAYOUT, keys, 10, FPS / 2) is LAYOUT


def test_denser_keys_lie_on_the_curve_that_was_solved():
    rng, found = np.random.default_rng(0), swaying(10.0)
    z = found.z + 0.02 * rng.normal(size=found.z.shape)
    z -= z.mean(axis=1, keepdims=True)
    residual = 0.1 * rng.normal(size=found.residual.shape)
    found = replace(found, z=z / np.linalg.norm(z, axis=1, keepdims=True), residual=residual)
    denser = KeyframeLayout.even(121, 6)
    keys = keys_at(found, LAYOUT, denser.key_times)
    at = denser.bounds
    expected = model().poses(found, LAYOUT, at)
    got = model().poses(keys, denser, at)
    np.testing.assert_allclose(got.local, expected.local, atol=1e-9)
    np.testing.assert_allclose(got.transl, expected.transl, atol=1e-12)
    np.testing.assert_allclose(got.root, expected.root, atol=1e-12)


def test_a_range_is_solved_with_the_windows_of_its_take():
    motion = small_motion(121)
    keyframes = np.zeros(121, dtype=bool)
    keyframes[::3] = True
    assert window_of(replace(motion, keyframes=keyframes), 10) == 6
    assert window_of(replace(motion, keyframes=None), 10) == 10
    keyframes = np.zeros(121, dtype=bool)
    keyframes[::20] = True
    assert window_of(replace(motion, keyframes=keyframes), 10) == 10
