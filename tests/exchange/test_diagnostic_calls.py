"""Every diagnostic that the program makes has the values that its sentence names."""

from __future__ import annotations

import ast
import string
from collections.abc import Iterator
from pathlib import Path

import pytest

from solver_backend.exchange.diagnostics.table import GROUPS, TABLE

ROOT = Path(__file__).resolve().parents[2] / "solver_backend"
LISTED = ("camera", "marker", "joint")


def named_fields(code: str) -> set[str]:
    """Return the arguments of ``diagnostic`` that the words of a code need."""
    words = TABLE[code].what + TABLE[code].advice
    fields = {name for _, name, _, _ in string.Formatter().parse(words) if name}
    return {next((f"{one}s" for one in LISTED if name in (one, f"{one}s", f"other_{one}")), name) for name in fields}


def calls() -> Iterator[tuple[str, str, set[str]]]:
    """Yield place, code and arguments of every call whose code stands in it and whose arguments are all named."""
    for path in sorted(ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "diagnostic"):
                continue
            code = node.args[0] if node.args else None
            arguments = {keyword.arg for keyword in node.keywords}
            if isinstance(code, ast.Constant) and isinstance(code.value, str) and None not in arguments:
                yield f"{path.relative_to(ROOT)}:{node.lineno}", code.value, {name for name in arguments if name}


@pytest.mark.slow
def test_every_call_names_what_its_sentence_needs() -> None:
    found = list(calls())
    assert len(found) > 80
    assert not [(place, code, missing) for place, code, given in found if (missing := named_fields(code) - given)]


def test_no_code_is_in_two_tables() -> None:
    assert sum(map(len, GROUPS.values())) == len(TABLE)
