"""A body far from its markers is reported, and one very far refused; joint centres of networks may be farther."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import Severity, sentence
from solver_backend.report.checks import hips_never_move, marker_plausibility
from solver_backend.types import MARKER_GHOST, Capture, MarkerCloud
from tests.support.solved import solved


@pytest.mark.parametrize(
    ("place", "millimetres", "severity"),
    [
        ("LASI", 6.0, None), ("LASI", 16.0, Severity.WARNING), ("LASI", 80.0, Severity.ERROR),
        ("=left_hip", 25.0, None), ("=left_hip", 50.0, Severity.WARNING), ("=left_hip", 200.0, Severity.ERROR),
    ],
)  # fmt: skip
def test_a_body_far_from_its_markers(place: str, millimetres: float, severity: Severity | None) -> None:
    _, motion = solved(faults=False)
    error = np.full((motion.num_frames, 3), millimetres)
    error[::5] = np.nan
    motion = replace(
        motion, marker_residual_mm=error, marker_labels=("a", "b", "c"), markers=np.zeros((motion.num_frames, 3, 3)),
        provenance={**motion.provenance, "markers": [place] * 3},
    )  # fmt: skip
    found = list(marker_plausibility(motion))
    assert [item.severity for item in found] == ([severity] if severity else [])
    if severity:
        assert found[0].code == "markers_far"
        assert "subject file" in sentence(found[0])


def test_one_marker_that_is_far_always_or_for_a_while_is_named() -> None:
    _, motion = solved(faults=False)
    error = np.full((motion.num_frames, 4), 3.0)
    error[:, 1], error[5:10, 2], error[10 : 10 + int(0.5 * motion.fps), 3] = 45.0, 90.0, 70.0
    motion = replace(
        motion, marker_residual_mm=error, marker_labels=("a", "b", "c", "d"),
        markers=np.zeros((motion.num_frames, 4, 3)), provenance={**motion.provenance, "markers": ["LASI"] * 4},
    )  # fmt: skip
    found = list(marker_plausibility(motion))
    assert [(item.code, item.where.markers) for item in found] == [
        ("marker_far", ("b",)), ("marker_far", ("d",))
    ]  # fmt: skip
    assert found[1].where.frames == ((10, 9 + int(0.5 * motion.fps)),)
    thrown_out = np.zeros(error.shape, np.uint8)
    thrown_out[:, [1, 3]] = MARKER_GHOST
    assert not list(marker_plausibility(replace(motion, marker_flags=thrown_out)))


def test_one_limb_alone_is_of_the_side_that_its_labels_state_unless_its_ankle_shows_it() -> None:
    _, motion = solved(faults=False)
    arm, leg = ("RSHO", "RUPA", "RELB", "RFRM", "RWRA", "RWRB"), ("LTHI", "LKNE", "LSHN", "LANK", "LHEE", "LTOE")
    for places, code in ((arm, ["limb_side_found"]), (leg, []), (leg[:4], ["limb_side_found"]), (arm + leg, [])):
        shape = (motion.num_frames, len(places))
        one = replace(
            motion, marker_residual_mm=np.full(shape, 3.0), marker_labels=places, markers=np.zeros((*shape, 3)),
            layout=places, offsets=np.zeros((len(places), 3)),
            provenance={**motion.provenance, "markers": list(places)},
        )  # fmt: skip
        assert [item.code for item in marker_plausibility(one)] == code


def test_positions_relative_to_the_hips_are_named() -> None:
    _, motion = solved(faults=False)
    labels, frames = ("LASI", "RASI", "LKNE"), motion.num_frames
    points = np.random.default_rng(1).normal(0.0, 0.3, (frames, 3, 3))
    worn = replace(motion, marker_labels=labels, layout=("LFWT", "RFWT", "LKNE"), offsets=np.zeros((3, 3)))
    for middle, expected in ((points[:, :2].mean(axis=1, keepdims=True), True), (0.0, False)):
        relative = Capture("take", markers=MarkerCloud(points - middle, motion.fps, labels))
        assert hips_never_move(relative, worn) is expected
    still = Capture("take", markers=MarkerCloud(points[:1].repeat(frames, axis=0), motion.fps, labels))
    assert not hips_never_move(still, worn)
