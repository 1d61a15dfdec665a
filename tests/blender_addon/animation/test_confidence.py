"""Confidence from standard deviations."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon._exchange.motion_file import FLAG_UNSEEN, FLAG_UNSURE
from blender_addon.animation.lanes import HALF_AT_M, joint_confidence, sigma_of
from solver_backend import types as solver_types


def test_confidence_falls_with_the_standard_deviation():
    confidence = joint_confidence(np.array([[0.0, HALF_AT_M / 3, HALF_AT_M, 10.0]]), None)
    assert confidence[0, :3] == pytest.approx([1.0, 0.9, 0.5]) and 0 < confidence[0, 3] < 1e-4
    assert [sigma_of(float(c)) for c in confidence[0]] == pytest.approx([0.0, HALF_AT_M / 3, HALF_AT_M, 10.0])


def test_flagged_frames_lose_confidence():
    flags = np.array([0, FLAG_UNSURE, FLAG_UNSEEN, FLAG_UNSEEN | FLAG_UNSURE], np.uint8)
    sigma = np.tile([0.0, 0.1], (4, 1))
    confidence = joint_confidence(sigma, flags)
    assert confidence[:, 0].tolist() == [1.0, 0.3, 0.0, 0.0]
    assert confidence[1, 1] == confidence[0, 1] < 0.3  # a low one is not raised
    assert (solver_types.FLAG_UNSEEN, solver_types.FLAG_UNSURE) == (FLAG_UNSEEN, FLAG_UNSURE)
