"""Every diagnostic that the program makes has the values that its sentence names."""

from __future__ import annotations

import ast
import string
from functools import cache
from pathlib import Path

from solver_backend.exchange.diagnostics import load_table

ROOT = Path(__file__).resolve().parents[2] / "solver_backend"
LISTED = ("camera", "marker", "joint")


def named_fields(code: str, given: dict[str, object]) -> set[str]:
    """Return the arguments of ``diagnostic`` that the words of a code need, with these values."""
    entry = load_table()[code]
    texts = [entry.text, entry.remedy]
    texts += [words[str(given[name])] for name, words in entry.words.items() if str(given.get(name)) in words]
    fields = {name for text in texts for _, name, _, _ in string.Formatter().parse(text) if name}
    return {next((f"{one}s" for one in LISTED if name in (one, f"{one}s", f"other_{one}")), name) for name in fields}


@cache
def calls() -> list[tuple[str, str, dict[str, object]]]:
    """Return place, code and arguments of every call with a literal code and named arguments."""
    found = list[tuple[str, str, dict[str, object]]]()
    for path in sorted(ROOT.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "diagnostic(" in text else ():
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "diagnostic"):
                continue
            code = node.args[0] if node.args else None
            given = {k.arg: k.value.value if isinstance(k.value, ast.Constant) else None for k in node.keywords}
            if isinstance(code, ast.Constant) and isinstance(code.value, str) and None not in given:
                values = {str(name): value for name, value in given.items()}
                found.append((f"{path.relative_to(ROOT)}:{node.lineno}", code.value, values))
    return found


def test_every_call_names_what_its_sentence_needs() -> None:
    found = list(calls())
    assert len(found) > 80
    wanted = ((place, code, named_fields(code, given) - given.keys()) for place, code, given in found)
    assert not [(place, code, missing) for place, code, missing in wanted if missing]


def test_every_named_value_has_its_words() -> None:
    """A parameter with words takes free text as well, but not a word that is neither."""
    entries = load_table()
    named = [
        (place, code, name, value)
        for place, code, given in calls()
        for name, value in given.items()
        if name in entries[code].words and isinstance(value, str) and value.isidentifier()
    ]
    assert len(named) > 60
    assert not [item for item in named if item[3] not in entries[item[1]].words[item[2]]]
