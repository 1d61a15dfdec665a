"""Measure the product's folders against their budgets; ``python -m tests.support.budgets`` writes today's figures."""

from __future__ import annotations

import ast
import json
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from solver_backend.exchange.diagnostics import load_table

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "tests" / "budgets.json"
FOLDERS = ("solver_backend", "blender_addon", "assets_procedural", "training", "research")
PRODUCT = FOLDERS[:3]
LONG_FILE = 600
"""Lines of a file from which it counts as long."""
MEASUREMENTS = ROOT / "solver_backend" / "fitters" / "problem.py"
GROUPS = {
    "explanation of a capture": (
        "agreement", "io/recognition", "io/captures/agreement.py", "fitters/measurements/sanitise.py", "videos/sync",
    )
}  # fmt: skip
"""What decides whether a capture means what its files say, under ``solver_backend``. It has a budget of its own."""
_CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]*")


def product_folders() -> dict[str, list[Path]]:
    """Return the modules of each folder of the product, by its path; files beside folders are in their parent."""
    folders: dict[str, list[Path]] = {}
    for package in FOLDERS:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).parts
            deep = package in ("solver_backend", "blender_addon") and len(parts) > 2
            folders.setdefault("/".join(parts[:2]) if deep else package, []).append(path)
    return folders


def optional_fields() -> set[str]:
    """Return the fields of ``Measurements`` that may be None: they say what kind of measurement it is."""
    tree = ast.parse(MEASUREMENTS.read_text(encoding="utf-8"))
    [found] = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and node.name == "Measurements"]
    fields = [node for node in found.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)]
    return {field.target.id for field in fields if "None" in ast.unparse(field.annotation)}  # type: ignore[union-attr]


def _constants(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(name, ast.Name) and _CONSTANT.fullmatch(name.id):
                    yield name.id


def has_number(node: ast.AST) -> bool:
    """Return whether an expression holds a number other than 0 and 1, indices apart."""
    if isinstance(node, ast.Subscript):
        return has_number(node.value)
    if isinstance(node, ast.Constant):
        return type(node.value) in (int, float) and node.value not in (0, 1)
    return any(has_number(child) for child in ast.iter_child_nodes(node))


def thresholds(tree: ast.Module) -> int:
    """Return the number of a module's constants that hold numbers, each name of a tuple of names apart."""
    found = 0
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and has_number(node.value):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            found += len(target.elts) if isinstance(target, ast.Tuple) else 1
    return found


def of_group(parts: tuple[str, ...]) -> dict[str, int]:
    """Return lines and thresholds of some files and folders of the solver."""
    places = [ROOT / "solver_backend" / part for part in parts]
    files = [path for place in places for path in ([place] if place.is_file() else sorted(place.rglob("*.py")))]
    texts = [path.read_text(encoding="utf-8") for path in files]
    lines, numbers = sum(text.count("\n") for text in texts), sum(thresholds(ast.parse(text)) for text in texts)
    return {"lines": lines, "thresholds": numbers}


def _is_kind_test(node: ast.AST, fields: set[str]) -> bool:
    if isinstance(node, ast.Attribute):
        return node.attr in ("is_one_view", "is_direct")
    if not isinstance(node, ast.Compare) or not isinstance(node.ops[0], ast.Is | ast.IsNot):
        return False
    left, right = node.left, node.comparators[0]
    is_none = isinstance(right, ast.Constant) and right.value is None
    return is_none and isinstance(left, ast.Attribute) and left.attr in fields


def _is_literal_argument(node: ast.AST) -> bool:
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "add_argument"):
        return False
    return bool(node.args) and isinstance(node.args[0], ast.Constant)


def measure(paths: list[Path], fields: set[str]) -> dict[str, int]:
    """Return what a budget limits, of some files."""
    found: Counter[str] = Counter(
        lines=0, files=0, long_files=0, constants=0, literal_arguments=0, kind_tests=0, fmt_skips=0
    )
    for path in paths:
        text = path.read_text(encoding="utf-8")
        tree, lines = ast.parse(text), text.count("\n")
        nodes = list(ast.walk(tree))
        found["lines"] += lines
        found["files"] += 1
        found["long_files"] += lines > LONG_FILE
        found["constants"] += sum(1 for _ in _constants(tree))
        found["literal_arguments"] += sum(map(_is_literal_argument, nodes))
        found["kind_tests"] += sum(_is_kind_test(node, fields) for node in nodes)
        found["fmt_skips"] += text.count("# fmt: skip")
    return dict(found)


def measured() -> dict[str, dict[str, int]]:
    """Return the figures of every folder, and of the product as a whole."""
    fields = optional_fields()
    folders = {name: measure(paths, fields) for name, paths in sorted(product_folders().items())}
    whole: Counter[str] = Counter()
    for name, figures in folders.items():
        if name.startswith(PRODUCT):
            whole.update(figures)
    groups = {name: of_group(parts) for name, parts in GROUPS.items()}
    return {**folders, **groups, "product": {**whole, "diagnostics": len(load_table())}}


if __name__ == "__main__":
    found = measured()
    TABLE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write("".join(f"{group}: {found[group]}\n" for group in GROUPS))
