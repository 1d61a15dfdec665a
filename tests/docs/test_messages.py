"""What a user reads in messages, panels and help is free of the words that the project's style replaces."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from supply.texts import shown_strings, texts

ROOT = Path(__file__).resolve().parents[2]
WORDS = re.compile(
    r"\b(tells?|told|says?|said|judged|errs|whom|put right|put back|takes? back|by the clock|the way between"
    r"|processor time)\b",
    flags=re.IGNORECASE,
)
"""Left column of the style's table: the program reports, estimates, corrects."""


@pytest.mark.parametrize(("package", "least"), [("solver_backend", 1000), ("blender_addon", 1000), ("dev.py", 20)])
def test_no_message_uses_a_word_that_the_style_replaces(package: str, least: int) -> None:
    files = sorted((ROOT / package).rglob("*.py")) or [ROOT / package]
    shown = [(path, line, text) for path in files for line, text in shown_strings(path)]
    assert len(shown) > least
    assert not [f"{path.relative_to(ROOT)}:{line}: {text}" for path, line, text in shown if WORDS.search(text)]


def test_the_list_of_texts_has_each_once_and_leaves_no_package_out() -> None:
    found = list(texts())
    shown = [text for _, _, text in found]
    assert len(found) > 3000 and len(shown) == len(set(shown))
    assert {path.parts[0] for path, _, _ in found} == {"solver_backend", "blender_addon", "dev.py"}
    assert any("Pose limbs from their ends (IK)" in text for text in shown)
