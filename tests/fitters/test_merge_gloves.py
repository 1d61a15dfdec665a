"""Gloves' hands on a body's motion: every supported file, the time by the wrists, and what is doubtful."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.hand_skeleton import ANGLES
from solver_backend.body.hands import by_finger, hand_skeletons, with_fingers
from solver_backend.cli.main import main
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.fitters.hands.solve_hands import finger_turns_of
from solver_backend.fitters.motion_import.merge_gloves import MergedHands, merge_gloves
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.motions.gloves import read_gloves
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import Motion
from tests.support.drawn_gloves import BODY_FPS, OFFSET_S, drawn_gloves, hands_bvh, manus_csv, rokoko_csv
from tests.support.words import codes

DRAWN = drawn_gloves()
COVERED = slice(int(np.ceil(OFFSET_S * BODY_FPS)) + 1, -2)
FLEXIONS = [a for a, name in enumerate(ANGLES) if name.endswith("flexion") and name != "thumb_cmc_flexion"]


def angles_of(motion: Motion) -> np.ndarray:
    """Return (F, 2, A) angles of a motion's fingers on our own hand."""
    turns = exp_so3(finger_turns_of(motion)).reshape(-1, 2, 15, 3, 3)
    skeletons = hand_skeletons(with_fingers(load_body()))
    return np.stack([s.angles_of(by_finger(turns[:, side])) for side, s in enumerate(skeletons)], axis=1)


def off_deg(merged: MergedHands, columns: list[int] | slice = slice(None)) -> np.ndarray:
    """Return degrees (F, 2, A) by which covered frames differ from the truth."""
    return np.rad2deg(np.abs(angles_of(merged.motion) - DRAWN.angles)[COVERED][..., columns])


def test_hands_of_bvh_with_and_without_metacarpals(tmp_path: Path) -> None:
    body, motion = load_body(), DRAWN.motion
    for side, word in enumerate(("Left", "Right")):
        path = hands_bvh(tmp_path / f"{word}.bvh", DRAWN, side, word + "Hand{finger}{number}", metacarpals=bool(side))
        merged = merge_gloves(motion, body, read_gloves(path))
        assert merged.offset_s == pytest.approx(OFFSET_S, abs=0.01)
        assert off_deg(merged)[:, side].max() < 2.0 and np.sqrt((off_deg(merged)[:, side] ** 2).mean()) < 0.3
        motion = merged.motion
    assert off_deg(MergedHands(motion, 0.0, ())).max() < 2.0, "the first hand stays as the second is added"
    np.testing.assert_allclose(motion.joints[:, :22], DRAWN.motion.joints[:, :22], atol=1e-9)
    assert motion.body_layout == SMPL_HANDS and not motion.resting[COVERED].any()


def test_a_single_hand_without_a_side_is_asked_for(tmp_path: Path) -> None:
    path = hands_bvh(tmp_path / "glove.bvh", DRAWN, 1, "Hand_{finger}_{number}")
    with pytest.raises(MotionInvalid, match="no hand with known fingers and a known side"):
        read_gloves(path)
    assert read_gloves(path, "right").sides == (1,)


@pytest.mark.parametrize("mirrored", [True, False])
def test_manus_positions_in_axes_of_either_hand(tmp_path: Path, mirrored: bool) -> None:
    path = manus_csv(tmp_path / "take_R.csv", DRAWN, 1, mirrored=mirrored)
    merged = merge_gloves(DRAWN.motion, load_body(), read_gloves(path))
    assert merged.offset_s == pytest.approx(OFFSET_S, abs=0.01)
    assert off_deg(merged)[:, 1].max() < 2.0


def test_a_table_whose_last_columns_are_blank_is_named(tmp_path: Path) -> None:
    path = manus_csv(tmp_path / "take_R.csv", DRAWN, 1)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *(",".join(row.split(",")[:9]) for row in rows)]) + "\n")
    with pytest.raises(MotionInvalid, match="palm points are missing"):
        read_gloves(path)


def test_manus_ergonomics_give_bends_and_the_prior_the_rest(tmp_path: Path) -> None:
    path = manus_csv(tmp_path / "take_left.csv", DRAWN, 0, ergonomics=True)
    merged = merge_gloves(DRAWN.motion, load_body(), read_gloves(path), OFFSET_S)
    assert off_deg(merged, FLEXIONS)[:, 0].max() < 1.0
    assert codes(merged.found) == ("gloves_cover_part", "gloves_angles_unknown")
    unknown = next(item for item in merged.found if item.code == "gloves_angles_unknown").values["angles"]
    assert "index mcp spread" in unknown and "thumb cmc flexion" in unknown and "index pip flexion" not in unknown
    spread, prior = ANGLES.index("ring_mcp_spread"), load_hand_prior()
    own = angles_of(merged.motion)[COVERED][:, 0, spread]
    assert own.min() >= prior.low[spread] - 1e-6 and own.max() <= prior.high[spread] + 1e-6
    assert merged.motion.resting[COVERED][:, [34]].all(), "nothing informs the thumb's root"
    assert not merged.motion.resting[COVERED][:, 22:31].any()


@pytest.mark.parametrize(("positions", "columns"), [(True, slice(None)), (False, FLEXIONS)])
def test_rokoko_tables(tmp_path: Path, positions: bool, columns: list[int] | slice) -> None:
    path = rokoko_csv(tmp_path / "take.csv", DRAWN, positions=positions)
    gloves = read_gloves(path)
    assert gloves.sides == (0, 1)
    merged = merge_gloves(DRAWN.motion, load_body(), gloves, None if positions else OFFSET_S)
    assert merged.offset_s == pytest.approx(OFFSET_S, abs=0.01)
    assert off_deg(merged, columns).max() < 2.0


def test_wrists_at_rest_show_no_time(tmp_path: Path) -> None:
    still = drawn_gloves(shakes=False)
    gloves = read_gloves(hands_bvh(tmp_path / "l.bvh", still, 0, "LeftHand{finger}{number}"))
    merged = merge_gloves(still.motion, load_body(), gloves)
    assert merged.offset_s == 0.0 and "gloves_time" in codes(merged.found)


def test_gloves_of_another_take_and_exchanged_ones_are_named(tmp_path: Path) -> None:
    gloves = read_gloves(rokoko_csv(tmp_path / "take.csv", DRAWN))
    other = replace(gloves, palms=gloves.palms[::-1])
    merged = merge_gloves(DRAWN.motion, load_body(), other)
    assert merged.offset_s == 0.0 and "gloves_time" in codes(merged.found)
    crossed = replace(gloves, angles=gloves.angles[:, ::-1], palms=gloves.palms[:, ::-1])
    merged = merge_gloves(DRAWN.motion, load_body(), crossed)
    assert merged.offset_s == 0.0 and "gloves_sides_exchanged" in codes(merged.found)


def test_what_gloves_do_not_cover_rests(tmp_path: Path) -> None:
    gloves = read_gloves(hands_bvh(tmp_path / "l.bvh", DRAWN, 0, "LeftHand{finger}{number}"))
    merged = merge_gloves(DRAWN.motion, load_body(), gloves)
    first = int(OFFSET_S * BODY_FPS)
    assert merged.motion.resting[:first, 22:37].all() and not merged.motion.resting[COVERED, 22:37].any()
    assert merged.motion.resting[:, 37:].all(), "the other hand has no glove"
    [part] = [item for item in merged.found if item.code == "gloves_cover_part"]
    assert part.where.frames[0] == (0, first)
    with pytest.raises(MotionInvalid, match="do not overlap the motion"):
        merge_gloves(DRAWN.motion, load_body(), gloves, 100.0)


def test_bends_that_nobody_has_are_named(tmp_path: Path) -> None:
    gloves = read_gloves(rokoko_csv(tmp_path / "take.csv", DRAWN))
    angles = gloves.angles.copy()
    angles[:, 0, ANGLES.index("index_pip_flexion")] = np.deg2rad(160.0)
    merged = merge_gloves(DRAWN.motion, load_body(), replace(gloves, angles=angles))
    [beyond] = [item for item in merged.found if item.code == "gloves_beyond_ranges"]
    assert beyond.values["side"] == "left" and beyond.values["angles"][0].startswith("index pip flexion by")


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        ("a.csv", "Frame,X\n0,1\n1,2\n", "not come from supported gloves"),
        ("a.trc", "x", r"not supported \(.trc\)"),
        ("a.fbx", "x", "read through Blender"),
        ("a.csv", "Timestamp,LeftDigit2Metacarpophalangeal_flexion\n0,1\n0,2\n", "do not increase"),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, text: str, match: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(MotionInvalid, match=match):
        read_gloves(path)


def test_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motion, out = write_motion(tmp_path / "m.npz", DRAWN.motion), tmp_path / "hands.npz"
    files = [str(manus_csv(tmp_path / f"{s}.csv", DRAWN, k)) for k, s in enumerate(("left", "right"))]
    assert main(["hands add", str(motion), *files, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "left.csv: left hand, from +0.85 s" in text and "warning     The gloves cover" in text
    merged = read_motion(out)
    assert off_deg(MergedHands(merged, 0.0, ())).max() < 2.0
    assert [row["sides"] for row in merged.provenance["gloves"]] == [["left"], ["right"]]
