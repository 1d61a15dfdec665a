"""Ten people's questions, each answered by following links from the README within three clicks.

A click is a link by the words that it shows; the page (and heading) that it leads to must hold the answer.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from solver_backend.exchange.diagnostics import load_table

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
MOST_CLICKS = 3
QUESTIONS = {
    "I have four phone videos": (
        ("from videos",),
        ("from-videos session", "one video per camera", "Without a calibration", "bake session/mocap/motion.npz"),
    ),
    "I have a C3D": (("from markers",), ("solve take.c3d --out", "bake", "C3D")),
    "how accurate is it with three cameras": (
        ("by number of cameras",),
        (r"| views | 2 | 3 | 4 | 8 |", "bench bundle", "median MPJPE"),
    ),
    "how do I add my detector": (
        ("add a detector",),
        ("--detector-worker mine.py", "joint_set", "solver_backend/exchange/video_settings.py"),
    ),
    "what does warning X mean": (("diagnostics",), tuple(f"[`{code}`](diagnostics-" for code in load_table())),
    "how do I get it onto my Mixamo character": (("retarget",), ("Mixamo's", "*Target*", "press *Retarget*")),
    "I have one phone video": (("one",), ("from-videos walk.mp4 --stature", "What is measured and what is estimated")),
    "can it do fingers": (("fingers",), ("find hands", "Gloves", "Markers on hands")),
    "may I use it commercially, what about SMPL and patents": (
        ("body and patents",),
        ("CC0-1.0", "contain the body's mesh", "US 10,395,411", "SMPL-family files"),
    ),
    "it ended with exit code 3": (("exit codes",), ("  3    a file is missing, damaged or unusable",)),
}
"""Question: the links to click, by a part of what they show; what the last page must hold."""


def clicked(page: Path, words: str) -> tuple[Path, str]:
    """Return the page, and the part of it, that the first link with these words leads to."""
    for shown, target, anchor in re.findall(r"\[([^\]]+)\]\(([^)#\s]*)#?([^)\s]*)\)", page.read_text("utf-8")):
        if words.lower() in shown.lower() and "://" not in target:
            place = (page.parent / target).resolve() if target else page
            return place, section(place, anchor)
    raise AssertionError(f"no link '{words}' in {page.name}")


def section(page: Path, anchor: str) -> str:
    """Return the text below a heading up to the next of its level, the whole page without an anchor."""
    text = page.read_text("utf-8")
    if not anchor:
        return text
    for level, head in re.findall(r"^(#+) (.+)$", text, flags=re.MULTILINE):
        if re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") == anchor:
            after = text.split(f"{level} {head}\n", 1)[1]
            return re.split(rf"^#{{1,{len(level)}}} ", after, maxsplit=1, flags=re.MULTILINE)[0]
    raise AssertionError(f"no heading '{anchor}' in {page.name}")


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_is_answered_within_three_clicks(question: str) -> None:
    clicks, answer = QUESTIONS[question]
    assert 0 < len(clicks) <= MOST_CLICKS
    page, text = README, ""
    for words in clicks:
        page, text = clicked(page, words)
    assert not [part for part in answer if part not in text], page
