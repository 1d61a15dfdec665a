"""The exchange library stands on NumPy alone, and both halves import the same files as separate packages."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

import blender_addon._exchange.errors as addon_errors
import build_addon
import solver_backend.exchange.errors as solver_errors


def test_a_checkout_has_the_files_once_and_the_halves_share_no_class() -> None:
    assert addon_errors.__file__ == solver_errors.__file__
    assert addon_errors is not solver_errors
    assert addon_errors.MocapError is not solver_errors.MocapError


def test_the_zip_has_the_files_in_both_halves() -> None:
    files = build_addon.contents()
    held = {name.removeprefix("_exchange/"): path for name, path in files.items() if name.startswith("_exchange/")}
    solver = "backend/solver_backend/exchange/"
    assert held == {name.removeprefix(solver): path for name, path in files.items() if name.startswith(solver)}
    assert set(build_addon.EXCHANGE.rglob("*.py")) <= set(held.values())


@pytest.mark.parametrize("path", sorted(build_addon.EXCHANGE.rglob("*.py")), ids=lambda path: path.name)
def test_imports_are_relative_or_numpy_or_pythons_own(path: Path) -> None:
    allowed = sys.stdlib_module_names | {"numpy"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            inside = 1 <= node.level <= len(path.relative_to(build_addon.EXCHANGE).parts)
            assert inside or (node.level == 0 and str(node.module).split(".")[0] in allowed), ast.unparse(node)
        elif isinstance(node, ast.Import):
            assert all(item.name.split(".")[0] in allowed for item in node.names), ast.unparse(node)
