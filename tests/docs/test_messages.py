"""What a user reads in messages, panels and help is free of the words that the project's style replaces."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from supply.texts import TABLES, shown_strings, texts
from tests.support.style_words import WORDS

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*(ROOT / "docs" / "how-to").glob("*.md"), *(ROOT / "docs" / "tutorials").glob("*.md")])
MOST_WORDS = 30
"""Of a sentence; twenty is the style's measure."""
_NO_SENTENCES = (
    "training/",
    "solver_backend/synthesis/studio/writers/",
    "solver_backend/camera_calibration/formats/",
)
"""Model cards and files' contents."""
_NO_PROSE = re.compile(r"<|:root|\bimport (?:sys|json)\b|--json")
"""Markup, style sheets, programs and the table of exit codes."""
_PROSE = re.compile(r"\b(?:the|an?|is|are|of|to|in|and|or|no)\b")
"""Sentences hold one of these words; tables of names do not."""


@pytest.mark.parametrize(
    ("package", "least"), [("solver_backend", 1000), ("blender_addon", 1000), ("dev.py", 20), ("supply", 100)]
)
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
    assert set(TABLES) <= {path for path, _, _ in found}
    assert not [text for path, _, text in found if path in TABLES and WORDS.search(text)]


def test_a_sentence_of_a_message_is_read_in_one_breath() -> None:
    shown = [(f"{path}", text) for path, _, text in texts() if not str(path).startswith(_NO_SENTENCES)]
    prose = [(path, text) for path, text in shown if _PROSE.search(text) and not _NO_PROSE.search(text)]
    sentences = [(path, part) for path, text in prose for part in re.split(r"(?<=[.!?])\s+", text)]
    long = [(path, part) for path, part in sentences if len(part.split()) > MOST_WORDS]
    assert not long, f"more than {MOST_WORDS} words: {long}"


def test_nobody_is_sent_to_a_registry_for_this_program() -> None:
    """It is in none; a missing package is named by its own name."""
    shown = [text for _, _, text in texts()] + [page.read_text(encoding="utf-8") for page in PAGES]
    assert not [text for text in shown if re.search(r"pip install\b[^\n]*manifold-mocap", text)]


def test_every_argument_of_a_verb_has_a_line_of_help() -> None:
    pages = (ROOT / "docs" / "reference").glob("command-line*.md")
    rows = [line for page in pages for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    assert len(rows) > 200
    assert not [line for line in rows if re.search(r"\| (?:–|\(required\)) \|$", line)]


OTHERS_WORDS = ("No space left on device",)  # Of the system.
_VALUES = re.compile(r"…|\{…\}|[\d.,]*\d ?%?|\b[A-Z]\b(?:, [A-Z]\b)*|\b(?:left|right) \w+\b")
"""What stands in a quoted message for a value."""


def quoted(page: Path) -> list[str]:
    """Return the messages that a page quotes: in italics in the first cell of a row, or bold and in quotation marks."""
    text = page.read_text(encoding="utf-8")
    cells = re.findall(r"^\|([^|]+)\|", text, flags=re.MULTILINE)
    found = [part for cell in cells for part in re.findall(r"(?<!\*)\*([^*▸]+)\*(?!\*)", cell)]
    return found + re.findall(r"\*\*\"([^\"*\n]+)\"\*\*", text)


def test_messages_that_a_page_quotes_are_those_of_the_program() -> None:
    shown = "\n".join(text.replace("{…}", "\n") for _, _, text in texts()).lower()
    parts = [
        (page.name, part.strip(" ,.:;")) for page in PAGES for whole in quoted(page) for part in _VALUES.split(whole)
    ]
    parts = [(page, part) for page, part in parts if part.count(" ") > 1 and part not in OTHERS_WORDS]
    assert len(parts) > 20
    assert not [(page, part) for page, part in parts if part.lower() not in shown]
