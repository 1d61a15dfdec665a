"""What a user reads in messages, panels and help is free of the words that the project's style replaces."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WORDS = re.compile(
    r"\b(tells?|told|says?|said|judged|errs|whom|put right|put back|takes? back|by the clock|the way between"
    r"|processor time)\b",
    flags=re.IGNORECASE,
)
"""Left column of the style's table: the program reports, estimates, corrects."""


def shown_strings(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the strings of a file that are sentences: with a blank, and no docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    statements = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or id(node) in statements:
            continue
        if isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value


@pytest.mark.parametrize(("package", "least"), [("solver_backend", 1000), ("blender_addon", 1000), ("dev.py", 20)])
def test_no_message_uses_a_word_that_the_style_replaces(package: str, least: int) -> None:
    files = sorted((ROOT / package).rglob("*.py")) or [ROOT / package]
    shown = [(path, line, text) for path in files for line, text in shown_strings(path)]
    assert len(shown) > least
    assert not [f"{path.relative_to(ROOT)}:{line}: {text}" for path, line, text in shown if WORDS.search(text)]
