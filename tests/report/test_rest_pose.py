"""The drawing of where markers sit on the body."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_layout
from solver_backend.report.body_pictures import rest_markers, rest_pose_section
from solver_backend.types import Motion
from tests.support.solved import solved

PLACES = marker_layout("MANIFOLD_53")


def motion_of(offsets: np.ndarray) -> Motion:
    """Return a motion whose markers sit so far from their places."""
    _, motion = solved()
    frames, count = motion.num_frames, len(PLACES)
    error = np.tile(np.linspace(1.0, 9.0, count), (frames, 1))
    error[:, 0] = np.nan
    return replace(
        motion, body=load_body().id, layout=PLACES, marker_labels=tuple(f"Ann:{name}" for name in PLACES),
        offsets=offsets, markers=np.zeros((frames, count, 3)), marker_residual_mm=error,
    )  # fmt: skip


def circles(drawing: str) -> dict[str, tuple[float, float, float, str]]:
    """Return place, radius and title of each marker that is drawn."""
    found = re.findall(r'cx="([-\d.]+)" cy="([-\d.]+)" r="([\d.]+)"><title>([^<]*)</title>', drawing)
    return {told.partition(":")[0]: (float(x), float(y), float(r), told) for x, y, r, told in found}


def test_every_marker_is_drawn_on_the_side_on_which_it_is():
    section = rest_pose_section(motion_of(np.zeros((len(PLACES), 3))))
    front, behind = (circles(part) for part in section.split("From behind"))
    assert {*front, *behind} == {*PLACES}
    assert {"STRN", "CLAV"} <= {*front} - {*behind}
    assert {"C7", "T10"} <= {*behind} - {*front}
    # The person's left is on the right from the front, and on the left from behind; the head is above.
    assert front["LFHD"][0] > front["RFHD"][0] and behind["LBHD"][0] < behind["RBHD"][0]
    assert front["LFHD"][1] < front["STRN"][1]


def test_offsets_and_residuals_are_told():
    offsets = np.zeros((len(PLACES), 3))
    chest = PLACES.index("STRN")
    offsets[chest] = [0.0, -0.03, 0.0]
    there, expected = circles(rest_pose_section(motion_of(offsets))), circles(rest_pose_section(motion_of(0 * offsets)))
    assert there["STRN"][1] > expected["STRN"][1] + 5
    assert there["STRN"][3].endswith("30 mm from its position in the layout")
    assert there[PLACES[-1]][2] > there[PLACES[1]][2]
    assert there[PLACES[0]][3].startswith(f"{PLACES[0]}: – mm")


def test_rest_markers_are_the_rules_with_their_offsets():
    body, offsets = load_body(), np.random.default_rng(0).normal(0, 0.01, (len(PLACES), 3))
    motion = motion_of(offsets)
    moved = rest_markers(body, motion, offsets) - rest_markers(body, motion, 0 * offsets)
    np.testing.assert_allclose(moved, offsets, atol=1e-9)


@pytest.mark.parametrize("given", [{"body": "another"}, {"offsets": None}, {"layout": None}])
def test_what_is_not_known_is_not_drawn(given):
    assert rest_pose_section(replace(motion_of(np.zeros((len(PLACES), 3))), **given)) == ""
