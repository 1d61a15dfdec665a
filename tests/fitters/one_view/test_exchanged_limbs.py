"""Limbs that a detector exchanges for a time are given back, where their tracks show when; nothing else is touched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, read_diagnostics
from solver_backend.fitters.one_view import measure
from solver_backend.fitters.one_view.depth import LIMBS, LONGEST_S, restore_sides
from solver_backend.fitters.pipeline import solve
from solver_backend.priors.lifted_take import lift_take
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture, Keypoints2D
from tests.support.limb_errors import limb_errors
from tests.support.one_view_situations import filmed_walk


@pytest.fixture(scope="module")
def walked() -> Capture:
    return filmed_walk()


@pytest.fixture(scope="module")
def detected(walked: Capture) -> Keypoints2D:
    return walked.require_views()[1]


def columns(keypoints: Keypoints2D, part: str, only: tuple[str, ...] | None = None) -> tuple[list[int], list[int]]:
    names = keypoints.joint_set.keypoints
    parts = [p for p in only or LIMBS[part] if f"left_{p}" in names]
    left, right = ([names.index(f"{side}_{p}") for p in parts] for side in ("left", "right"))
    return left, right


def exchanged(keypoints: Keypoints2D, part: str, frames: slice, only: tuple[str, ...] | None = None) -> Keypoints2D:
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    left, right = columns(keypoints, part, only)
    for values in (xy, confidence):
        values[:, frames, left], values[:, frames, right] = values[:, frames, right], values[:, frames, left]
    return replace(keypoints, xy=xy, confidence=confidence)


def same(a: Keypoints2D, b: Keypoints2D) -> bool:
    return np.array_equal(a.xy, b.xy, equal_nan=True) and np.array_equal(a.confidence, b.confidence)


def restored(keypoints: Keypoints2D) -> tuple[Keypoints2D, dict[str, Diagnostic]]:
    found, diagnostics = restore_sides("cam01", keypoints)
    return found, {item.code: item for item in diagnostics}


def test_a_walk_whose_legs_pass_each_other_is_left_alone(detected: Keypoints2D) -> None:
    found, diagnostics = restored(detected)
    assert same(found, detected) and not diagnostics


@pytest.mark.parametrize("part", LIMBS)
def test_what_was_exchanged_for_a_time_is_given_back_to_the_bit(detected: Keypoints2D, part: str) -> None:
    found, diagnostics = restored(exchanged(detected, part, slice(20, 38)))
    assert same(found, detected)
    item = diagnostics["limbs_exchanged"]
    assert (item.where.cameras, item.where.frames, item.remedy) == (("cam01",), ((20, 37),), Remedy.REPAIRED)
    assert item.values["part"] == part


def test_what_is_never_exchanged_back_is_left_and_named(detected: Keypoints2D) -> None:
    given = exchanged(detected, "legs", slice(40, None))
    found, diagnostics = restored(given)
    assert same(found, given) and set(diagnostics) == {"limbs_jump_sides"}
    assert diagnostics["limbs_jump_sides"].where.frames == ((39, 40),)


def test_a_long_exchange_is_left_since_either_part_may_be_right(detected: Keypoints2D) -> None:
    frames = round(LONGEST_S * detected.fps) + 5
    given = exchanged(detected, "legs", slice(10, 10 + frames))
    found, diagnostics = restored(given)
    assert same(found, given) and set(diagnostics) == {"limbs_jump_sides"}


def test_one_keypoint_alone_is_an_outlier(detected: Keypoints2D) -> None:
    given = exchanged(detected, "arms", slice(20, 30), only=("wrist",))
    found, diagnostics = restored(given)
    assert same(found, given) and not diagnostics


def test_one_keypoint_ends_what_several_began(detected: Keypoints2D) -> None:
    given = exchanged(detected, "legs", slice(20, 34))
    confidence = given.confidence.copy()
    left, right = columns(given, "legs", tuple(p for p in LIMBS["legs"] if p != "ankle"))
    confidence[:, 25:45, left + right] = 0.0
    found, diagnostics = restored(replace(given, confidence=confidence))
    assert diagnostics["limbs_exchanged"].where.frames == ((20, 33),)
    ankles = columns(given, "legs", ("ankle",))
    np.testing.assert_array_equal(found.xy[0][:, ankles], detected.xy[0][:, ankles])


@pytest.mark.slow
def test_a_solve_of_exchanged_arms_and_legs_is_that_of_the_right_ones() -> None:
    walked = filmed_walk(60)
    spoiled = exchanged(exchanged(walked.require_views()[1], "legs", slice(20, 40)), "arms", slice(30, 44))
    motion = solve(replace(walked, keypoints=spoiled)).motion
    truth = solve(walked).motion
    assert limb_errors(motion.joints, truth.joints)[0] < 1e-3
    codes = [item.code for item in read_diagnostics(motion.provenance["diagnostics"])]
    assert codes.count("limbs_exchanged") == 2


@pytest.mark.slow
def test_an_exchange_that_fits_the_lifted_body_worse_is_not_made(
    walked: Capture, detected: Keypoints2D, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera, body = walked.require_views()[0], load_body()
    prior = prior_on_body(load_sposer(), body.layout)
    lift = partial(lift_take, camera, body=body, prior=prior, up=camera.R[0, :, 2])
    spoiled = exchanged(detected, "legs", slice(20, 38))
    found, _, reported = measure.lift_on_sides("cam01", spoiled, body, lift)
    assert same(found, detected) and [item.code for item in reported] == ["limbs_exchanged"]

    def wrong(camera: str, seen: Keypoints2D, but: Sequence[str] = ()) -> tuple[Keypoints2D, list[Diagnostic]]:
        return (seen, []) if "legs" in but else (spoiled, reported)

    monkeypatch.setattr(measure, "restore_sides", wrong)
    found, _, left = measure.lift_on_sides("cam01", detected, body, lift)
    assert same(found, detected) and not left
