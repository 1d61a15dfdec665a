"""A given stature survives the solve of several views, or the motion records both statures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from solver_backend.body.body import load_body
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.pipeline import solve
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Motion
from tests.support.short_solves import QUICK, cut


def codes(motion: Motion) -> list[str]:
    return [item["code"] for item in motion.provenance["diagnostics"]]


@pytest.mark.parametrize("off", [-0.02, 0.02])
def test_a_stature_that_the_limbs_allow_is_kept(off: float) -> None:
    capture = cut(demo_capture(), 0, 60)
    free = solve(capture, SolveSettings(iterations=4)).motion
    stature = round(load_body().stature_of(free.betas) * (1 + off), 3)
    kept = solve(replace(capture, stature_m=stature), SolveSettings(iterations=4)).motion
    (found,) = (item for item in kept.provenance["diagnostics"] if item["code"] == "stature_solved")
    assert load_body().stature_of(kept.betas) == pytest.approx(stature, abs=1e-3)
    assert (found["severity"], found["values"]["reason"]) == ("note", "given")


def test_both_statures_are_reported_if_the_limbs_contradict_the_given_one() -> None:
    motion = solve(replace(cut(demo_capture(), 0, 6), stature_m=1.95), QUICK).motion
    (found,) = (item for item in motion.provenance["diagnostics"] if item["code"] == "stature_solved")
    assert found["severity"] == "warning" and found["values"]["reason"] == "contradicted"
    assert found["values"]["size"] == pytest.approx(load_body().stature_of(motion.betas), abs=1e-3)
    assert found["values"]["stature"] == 1.95


def test_one_camera_that_is_left_of_two_measures_no_stature() -> None:
    capture = cut(demo_capture(), 0, 12).views([0, 1])
    motion = solve(capture, replace(QUICK, leave_out=("cam02",))).motion
    assert "stature_solved" not in codes(motion)


def test_a_stature_that_contradicts_the_given_shape_is_reported() -> None:
    capture = replace(cut(demo_capture(), 0, 6), stature_m=1.90)
    motion = solve(capture, replace(QUICK, betas=(0.0,) * 10)).motion
    assert load_body().stature_of(motion.betas) == pytest.approx(load_body().stature_m)
    (found,) = (item for item in motion.provenance["diagnostics"] if item["code"] == "stature_solved")
    assert found["severity"] == "warning" and found["values"]["stature"] == 1.90


def test_a_given_shape_is_not_said_to_be_measured() -> None:
    motion = solve(cut(demo_capture(), 0, 6), replace(QUICK, betas=(0.0,) * 10)).motion
    (found,) = (item for item in motion.provenance["diagnostics"] if item["code"] == "stature_solved")
    assert (found["severity"], found["values"]["reason"]) == ("note", "given")
