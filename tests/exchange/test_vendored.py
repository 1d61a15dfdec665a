"""The exchange library is one: the add-on's copy has its bytes, and it stands on NumPy alone."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

import build_addon


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder but byte code."""
    files = (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_the_addons_copy_has_the_librarys_bytes() -> None:
    library, copy = contents(build_addon.EXCHANGE), contents(build_addon.VENDORED)
    different = sorted(name for name in library.keys() | copy.keys() if library.get(name) != copy.get(name))
    assert not different, f"python3 dev.py vendor brings these up to date: {different}"


def test_vendoring_replaces_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "gone.py").touch()
    build_addon.vendor(build_addon.EXCHANGE, tmp_path / "copy")
    assert contents(tmp_path / "copy") == contents(build_addon.EXCHANGE)


@pytest.mark.parametrize("path", sorted(build_addon.EXCHANGE.rglob("*.py")), ids=lambda path: path.name)
def test_imports_are_relative_or_numpy_or_pythons_own(path: Path) -> None:
    allowed = sys.stdlib_module_names | {"numpy"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            inside = 1 <= node.level <= len(path.relative_to(build_addon.EXCHANGE).parts)
            assert inside or (node.level == 0 and str(node.module).split(".")[0] in allowed), ast.unparse(node)
        elif isinstance(node, ast.Import):
            assert all(item.name.split(".")[0] in allowed for item in node.names), ast.unparse(node)
