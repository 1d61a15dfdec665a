"""List all texts that users see, for proofreading: ``python -m supply.texts [WORD]``.

These are the texts in the tables of diagnostics and verbs, and all strings in the program with a space that are not
docstrings. Labels of one word are in ``blender_addon/ui/german.txt``.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("solver_backend", "blender_addon", "dev.py")
TABLES = (Path("solver_backend/exchange/diagnostics.json"), Path("solver_backend/exchange/verbs.json"))
"""Tables with texts. Values are in braces."""
VALUE = "{…}"  # Replacement for a value in a message.
_SENTENCE = re.compile(r"[A-Za-z]{2,}\W+[A-Za-z]{2,}")
"""Two adjacent words. A string without any is a key, a path or a format."""
_JSON_TEXT = re.compile(r'[:,] "((?:[^"\\]|\\.)*)"')  # String value in a line of JSON.


@cache
def shown_strings(path: Path) -> tuple[tuple[int, str], ...]:
    """Return line and text of strings with a space, except docstrings. ``{…}`` replaces values."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    statements = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    whole = [node for node in nodes if isinstance(node, ast.JoinedStr)]
    values = [part for node in whole for part in node.values]
    formats = [part.format_spec for part in values if isinstance(part, ast.FormattedValue)]
    parts = {id(part) for part in [*values, *formats]}
    skipped = statements | parts
    kinds = (ast.Constant, ast.JoinedStr)
    found = ((node, _text(node)) for node in nodes if isinstance(node, kinds) and id(node) not in skipped)
    return tuple((node.lineno, text) for node, text in found if " " in text)


def _text(node: ast.Constant | ast.JoinedStr) -> str:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    return "".join(str(part.value) if isinstance(part, ast.Constant) else VALUE for part in node.values)


def texts() -> Iterator[tuple[Path, int, str]]:
    """Yield file, line and text of every text that may be shown to users, without duplicates."""
    known = set[str]()
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")) or [ROOT / package]:
            for line, found in sorted(shown_strings(path)):
                text = " ".join(found.split())
                if text not in known and _SENTENCE.search(text):
                    known.add(text)
                    yield path.relative_to(ROOT), line, text
    for table in TABLES:
        for line, written in enumerate((ROOT / table).read_text(encoding="utf-8").splitlines(), start=1):
            for match in _JSON_TEXT.finditer(written):
                text = re.sub(r"{[^}]*}", VALUE, json.loads(f'"{match[1]}"'))
                if text not in known and _SENTENCE.search(text):
                    known.add(text)
                    yield table, line, text


def main() -> int:
    """Print all texts, or the texts that contain a word, and return the exit code."""
    wanted = " ".join(sys.argv[1:]).lower()
    for path, line, text in texts():
        if wanted in text.lower():
            sys.stdout.write(f"{path}:{line}: {text}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
