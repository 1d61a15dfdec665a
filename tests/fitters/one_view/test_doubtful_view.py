"""Videos that one camera should not have filmed so: each is named, solved through, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.exchange.diagnostics import Diagnostic, read_diagnostics
from solver_backend.fitters.one_view.depth import cuts, glides
from solver_backend.fitters.pipeline import solve
from solver_backend.types import FLAG_UNSEEN, Capture, JointSet, Motion
from tests.support.limb_errors import LIMBS, limb_errors
from tests.support.one_view_situations import (
    LEGS,
    cut,
    doubled,
    filmed_walk,
    mirrored,
    parts,
    standing,
    without,
    zoomed,
)

DOUBTS = {
    "picture_cuts", "parts_at_rest", "frames_repeated", "person_glides", "stature_at_odds", "feet_never_stand",
}  # fmt: skip
NOTES = {"feet_never_stand"}
"""The walk is a formula: its feet slide."""


@pytest.fixture(scope="module")
def walked() -> Capture:
    return filmed_walk()


def doubts(capture: Capture) -> tuple[Motion, dict[str, Diagnostic]]:
    motion = solve(capture).motion
    found = {item.code: item for item in read_diagnostics(motion.provenance["diagnostics"])}
    assert np.isfinite(motion.joints).all() and "one_camera" in found
    return motion, {code: item for code, item in found.items() if code in DOUBTS}


@pytest.mark.slow
def test_a_plain_walk_has_none(walked: Capture) -> None:
    assert set(doubts(walked)[1]) <= NOTES


@pytest.mark.slow
def test_half_a_body_is_named_and_the_rest_is_solved(walked: Capture) -> None:
    motion, found = doubts(without(walked, LEGS))
    assert set(found) <= {"parts_at_rest", "feet_never_stand"}
    assert found["parts_at_rest"].values["part"] == "Legs are not seen"
    arms = [LIMBS[k] for k in range(6)]
    off = [
        points[:, arms] - points[:, arms[:2]].mean(axis=1, keepdims=True)
        for points in (motion.joints, walked.truth["joints"])
    ]
    assert np.linalg.norm(off[0] - off[1], axis=-1).mean() < 0.15


@pytest.mark.slow
def test_a_cut_is_named_where_it_is(walked: Capture) -> None:
    _, found = doubts(cut(walked, 60))
    assert found["picture_cuts"].where.frames == ((60, 61),)


@pytest.mark.slow
def test_a_zoom_looks_like_gliding_and_is_called_so() -> None:
    still = standing()
    assert doubts(still)[1] == {}
    _, found = doubts(zoomed(still, 1.6))
    assert found["person_glides"].values["size"] > 0.5


@pytest.mark.slow
def test_nobody_stands_on_a_trampoline() -> None:
    motion, found = doubts(standing(jump_m=0.5))
    assert set(found) == {"feet_never_stand"}
    assert np.ptp(motion.joints[:, 0, 2]) > 0.2


@pytest.mark.slow
def test_who_walks_out_and_in_is_flagged_while_away(walked: Capture) -> None:
    _, keypoints = parts(walked)
    confidence = keypoints.confidence.copy()
    confidence[:, 40:70] = 0.0
    motion, found = doubts(replace(walked, keypoints=replace(keypoints, confidence=confidence)))
    assert motion.flags is not None and ((motion.flags & FLAG_UNSEEN) > 0)[40:70].all()
    assert set(found) <= NOTES


@pytest.mark.slow
def test_frames_that_are_shown_twice_are_bridged(walked: Capture) -> None:
    motion, found = doubts(doubled(walked, 5))
    assert found["frames_repeated"].values["size"] == pytest.approx(20.0, abs=1.0)
    still = np.linalg.norm(np.diff(motion.joints[:, 0], axis=0), axis=-1)
    assert still[20:100].min() > 0.25 * np.median(still)


@pytest.mark.slow
def test_a_child_who_is_called_tall_contradicts_the_floor(walked: Capture) -> None:
    body = load_body()
    assert "stature_at_odds" not in doubts(replace(walked, stature_m=body.stature_m))[1]
    _, found = doubts(replace(walked, stature_m=1.45 * body.stature_m))
    values = found["stature_at_odds"].values
    assert values["given"] == pytest.approx(1.45 * body.stature_m, rel=1e-3)
    assert abs(values["measured"] - body.stature_m) < 0.35


@pytest.mark.slow
def test_a_camera_whose_floor_is_elsewhere_is_named_without_a_stature(walked: Capture) -> None:
    cameras, _ = parts(walked)
    lower = replace(cameras, t=cameras.t - np.einsum("cij,j->ci", cameras.R, [0.0, 0.0, 0.9]))
    _, found = doubts(replace(walked, cameras=lower))
    assert found["stature_at_odds"].values["source"] == "typical adult sizes"


@pytest.mark.slow
def test_a_mirrored_video_is_the_mirrored_person_before_the_mirrored_camera() -> None:
    """One view cannot show it: what is solved is as likely, and the how-to says what to do."""
    walked = filmed_walk(40)
    cameras, _ = parts(walked)
    flip = np.diag([-1.0, 1.0, 1.0])
    elsewhere = replace(cameras, R=flip @ cameras.R @ flip, t=cameras.t @ flip)
    plain, found = doubts(walked)
    other, found_mirrored = doubts(replace(mirrored(walked), cameras=elsewhere))
    assert set(found) == set(found_mirrored)
    swap = list(JointSet.SMPL_24.mirrored())
    assert limb_errors(other.joints, (plain.joints @ flip)[:, swap])[0] < 25.0
    missed = [np.nanmedian(m.reprojection_px) for m in (plain, other) if m.reprojection_px is not None]
    assert missed[1] == pytest.approx(missed[0], rel=0.1)


def test_fast_people_neither_cut_nor_glide() -> None:
    fps, frames = 30.0, np.arange(90)
    rng = np.random.default_rng(0)
    body = rng.uniform(0, 300, (1, 17, 2))
    runner = body + np.stack([40.0 * frames, 20 * np.sin(frames)], axis=-1)[:, None]
    assert not len(cuts(runner, np.ones((90, 17), dtype=bool), fps))
    jumping = runner + np.where(frames >= 50, 400.0, 0.0)[:, None, None]
    assert cuts(jumping, np.ones((90, 17), dtype=bool), fps).tolist() == [49]
    root = np.stack([4.0 * frames / fps, 0 * frames, 0 * frames + 1], axis=-1)
    stride = 0.8 * np.sin(2 * np.pi * 1.5 * frames / fps)
    feet = root[:, None] + np.stack([np.stack([s * stride, 0 * stride, -1 + 0 * stride], -1) for s in (1, -1)], axis=1)
    seen = np.ones(90, dtype=bool)
    assert glides(root, feet, seen, fps) == []
    skating = root[:, None] - np.array([0.0, 0.0, 1.0])
    assert glides(root, np.repeat(skating, 2, axis=1), seen, fps) == [(0, 89)]


def test_a_person_in_one_place_cuts_nothing() -> None:
    xy = np.full((30, 17, 2), 40.0)
    assert not len(cuts(xy, np.ones((30, 17), bool), 30.0))
