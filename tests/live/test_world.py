"""Units and axes of points that nobody described."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.io.units_and_axes import rotation_to_z_up
from solver_backend.labelling.point_network import load_network
from solver_backend.live.session import AXES, up_axis_of
from solver_backend.synthesis.embedded.demo import record_markers


@pytest.mark.parametrize("axis", AXES)
def test_somebody_who_walks_is_upright_along_any_axis(axis: str) -> None:
    positions = record_markers(40, seed=5).cloud.positions[::10]
    frames = [frame[np.isfinite(frame).all(axis=1)] @ rotation_to_z_up(axis) for frame in positions]
    assert up_axis_of(frames, load_network()) == axis
