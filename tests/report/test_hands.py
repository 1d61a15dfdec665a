"""The section about hands: shares, bends and curls of a motion whose fingers are known, and pictures."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.hand_skeleton import ANGLES
from solver_backend.body.hands import by_joint, hand_skeletons, with_fingers
from solver_backend.fitters.hands.solve_hands import with_finger_turns
from solver_backend.geometry.rotations import log_so3
from solver_backend.report.body_sections import hands_section
from solver_backend.report.page import report_html
from solver_backend.types import Motion
from tests.support.html_page import Strict
from tests.support.solved import solved


def bent(pip_deg: np.ndarray, unseen_right: slice = slice(0, 0)) -> Motion:
    """Return the solved motion with index fingers whose middle joints bend by (F,) degrees, others straight."""
    _, motion = solved()
    body, frames = with_fingers(load_body()), motion.num_frames
    angles = np.zeros((frames, len(ANGLES)))
    angles[:, ANGLES.index("index_pip_flexion")] = np.deg2rad(pip_deg)
    turns = [log_so3(by_joint(skeleton.local_rotations(angles))) for skeleton in hand_skeletons(body)]
    resting = np.zeros((frames, 30), bool)
    resting[unseen_right, 15:] = True
    return with_finger_turns(motion, load_body(), np.concatenate(turns, axis=1), resting)


def cells(page: str) -> dict[str, list[str]]:
    """Return the texts of the table's cells by row."""
    rows = re.findall(r"<tr><th>((?:left|right) \w+)</th>(.*?)</tr>", page)
    return {name: re.findall(r">([^<]*)</td>", row) for name, row in rows}


def test_fingers_have_their_bends_and_shares() -> None:
    frames = solved()[1].num_frames
    bend = np.linspace(0.0, 80.0, frames)
    page = hands_section(bent(bend, slice(0, frames // 2)))
    found = cells(page)
    assert len(found) == 10
    informed, _, median, most = found["left index"]
    assert informed == "100.0" and abs(float(most) - 80.0) < 2.0 and abs(float(median) - np.median(bend)) < 2.0
    assert abs(float(found["right ring"][0]) - 100 * (1 - (frames // 2) / frames)) < 0.1
    assert float(found["left ring"][3]) < 5.0
    assert "No camera sees the right hand in" in page and "left hand in" not in page


def test_curls_are_drawn_over_time() -> None:
    frames = solved()[1].num_frames
    parsed = Strict(hands_section(bent(np.linspace(0.0, 80.0, frames))))
    [plot] = [json.loads(a["data-plot"]) for tag, a in parsed.seen if tag == "figure" and a.get("data-plot")]
    curls = dict(plot["lines"])
    assert len(curls) == 10 and curls["left index"][-1] - curls["left index"][0] > 38


def test_hands_lie_within_their_pictures() -> None:
    frames = solved()[1].num_frames
    page = hands_section(bent(np.full(frames, 30.0)))
    places = np.array(re.findall(r'cx="([-\d.]+)" cy="([-\d.]+)"', page), dtype=float)
    size = np.array(re.findall(r'viewBox="0 0 (\d+) (\d+)"', page)[-1], dtype=float)
    assert len(places) == 3 * 2 * 2 * 20 and (places > 0).all() and (places < size).all()


def test_the_page_has_hands_where_the_motion_has_them() -> None:
    capture, motion = solved()
    assert hands_section(motion) == "" and 'id="hands"' not in report_html(capture, motion)
    wide = bent(np.full(motion.num_frames, 20.0))
    record = {"size": 1.04, "left": {"seen_percent": 91.0, "reprojection_median_px": 1.5, "status": "done"}}
    page = report_html(capture, replace(wide, provenance={**wide.provenance, "hands": record}))
    text = " ".join(Strict(page).words)
    assert "104 % of the size in the body shape" in text and "91.0 %" in text and "1.5 px" in text
