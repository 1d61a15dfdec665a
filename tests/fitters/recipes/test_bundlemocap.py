"""BundleMoCap++ as a method: the data term alone, the shape of the first frame, published windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.optimise import in_turn
from solver_backend.fitters.pipeline import first_subject, prepare, solve
from solver_backend.fitters.problem import MethodResult, Problem
from solver_backend.fitters.recipes.bundlemocap import solve_bundlemocap
from solver_backend.fitters.single_frame import lifted_betas
from solver_backend.metrics import mpjpe_mm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture
from tests.support.short_solves import cut

SETTINGS = SolveSettings(method="bundlemocap++", iterations=6)


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=41)


@pytest.fixture(scope="module")
def problem(capture: Capture) -> Problem:
    return prepare(capture, SETTINGS, silent)


def _solved(problem: Problem) -> MethodResult:
    return solve_bundlemocap(problem, first_subject(problem, SETTINGS), SETTINGS, silent, in_turn)


@pytest.fixture(scope="module")
def solved(problem: Problem) -> MethodResult:
    return _solved(problem)


def test_windows_have_twenty_frames_and_a_key_in_the_middle(problem: Problem, solved: MethodResult) -> None:
    assert solved[0].key_times.tolist() == [0, 10, 20, 30, 40]
    assert solved[1].parts == 2
    assert solved[1].iterations <= SETTINGS.iterations


def test_the_mixture_of_poses_plays_no_part(problem: Problem, solved: MethodResult) -> None:
    assert problem.pose_terms
    without = _solved(replace(problem, pose_terms=()))
    np.testing.assert_array_equal(without[0].frames.local, solved[0].frames.local)


def test_the_shape_is_the_regressors_of_the_first_frame_and_landmarks_keep_their_places(
    problem: Problem, solved: MethodResult
) -> None:
    first = lifted_betas(first_subject(problem, SETTINGS), problem.measurements, np.array([0]))
    np.testing.assert_array_equal(solved[0].subject.betas, first)
    assert not solved[0].subject.offsets.any()


def test_the_person_is_found_and_the_motion_names_the_method(capture: Capture) -> None:
    motion = solve(capture, SolveSettings(method="bundlemocap++")).motion
    assert mpjpe_mm(motion.joints, capture.truth["joints"]) < 30.0
    assert motion.provenance["settings"]["method"] == "bundlemocap++"
    assert motion.provenance["prior"]["name"] == "sposer"


def test_another_prior_decodes_the_codes(capture: Capture) -> None:
    short = cut(capture, 0, 12)
    motion = solve(short, replace(SETTINGS, prior="rvposer")).motion
    assert motion.provenance["prior"]["name"] == "rvposer"
    assert mpjpe_mm(motion.joints, short.truth["joints"]) < 45.0


def test_the_published_method_has_no_other_curves(capture: Capture) -> None:
    with pytest.raises(JobInvalid, match="has no setting interpolation"):
        solve(capture, replace(SETTINGS, interpolation=3))
