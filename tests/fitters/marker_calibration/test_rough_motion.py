"""Rough motion of a known person's markers reaches the last frame, and finds limbs that move fast."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_layout
from solver_backend.exchange.progress import silent
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.marker_calibration.marker_problem import marker_problem
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.fitters.single_frame import rough_markers
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture
from tests.support.worn_markers import worn_markers

pytestmark = pytest.mark.slow  # Making what these tests look at takes 4 to 14 seconds of CPU time.
FRAMES = 58  # The last frame is none of every sixth.


@pytest.fixture(scope="module")
def worn():
    return worn_markers(marker_layout("PLUGIN_GAIT_39"), FRAMES, step=3)


@pytest.fixture(scope="module")
def person(worn):
    return calibrate_person([Capture("take", markers=worn.cloud)])


def test_rough_motion_ends_with_the_take(worn, person):
    problem = marker_problem(
        worn.cloud, load_body(), load_sposer(), np.zeros(1), SolveSettings(), silent, person=person
    )
    measured = problem.measurements
    assert measured.rough is not None and measured.known_person is not None
    assert measured.rough.frames[0] == 0 and measured.rough.frames[-1] == FRAMES - 1
    found = rough_markers(problem, measured.known_person, measured.rough)[measured.rough.frames]
    off = np.linalg.norm(found - worn.cloud.positions[measured.rough.frames], axis=-1)
    assert np.median(off) < 0.02 and off.max() < 0.12


def test_a_take_in_fast_motion_is_solved_to_its_last_frame(worn, person):
    motion = solve(Capture("take", markers=worn.cloud), person=person).motion
    assert np.nanmedian(motion.marker_residual_mm) < 6.0
    assert np.nanmax(motion.marker_residual_mm[-6:]) < 70.0
