"""A given stature survives the solve of several views, or the motion records both statures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from solver_backend.body.body import load_body
from solver_backend.fitters.pipeline import solve
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Motion
from tests.support.short_solves import QUICK, cut


def codes(motion: Motion) -> list[str]:
    return [item["code"] for item in motion.provenance["diagnostics"]]


def test_the_body_has_the_given_stature() -> None:
    capture = replace(cut(demo_capture(), 0, 6), stature_m=1.70)
    motion = solve(capture, QUICK).motion
    assert abs(load_body().stature_of(motion.betas) - 1.70) < 0.001
    assert {"stature_solved", "world_scaled"} <= set(codes(motion))


def test_a_stature_that_contradicts_the_given_shape_is_reported() -> None:
    capture = replace(cut(demo_capture(), 0, 6), stature_m=1.90)
    motion = solve(capture, replace(QUICK, betas=(0.0,) * 10)).motion
    assert load_body().stature_of(motion.betas) == pytest.approx(load_body().stature_m)
    (found,) = (item for item in motion.provenance["diagnostics"] if item["code"] == "stature_solved")
    assert found["severity"] == "warning" and found["values"]["stature"] == 1.90
