"""Version of the code that a method's results depend on: all modules that it imports, and the weights."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from solver_backend.priors.weights import ASSETS

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("solver_backend", "research")
WEIGHTS = ("body_neutral.npz", "sposer.npz", "vposer.npz", "rvposer.npz", "gmm.npz", "lifter.npz", "view_lifter.npz")


@cache
def code_version(module: str, packages: tuple[str, ...] = PACKAGES) -> str:
    """Return the hash of a module, of all modules of the packages that it imports, and of the weights.

    It ignores comments, docstrings and line breaks.
    """
    digest = hashlib.sha256()
    for path in sorted(closure(module, packages)):
        digest.update(_instructions(path.read_text(encoding="utf-8")).encode())
    for name in WEIGHTS:
        if (ASSETS / name).exists():
            digest.update((ASSETS / name).read_bytes())
    return digest.hexdigest()


def closure(module: str, packages: tuple[str, ...] = PACKAGES) -> set[Path]:
    """Return the files of a module and of its imports from the packages, recursively and wherever the import is.

    A package around a module only counts if something is imported from it, because its exports do not affect the
    module.
    """
    seen: set[Path] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = _file(name)
        if path is not None and path not in seen:
            seen.add(path)
            waiting += [found for found in _imports(path, name) if found.startswith(packages)]
    return seen


class _NoDocstrings(ast.NodeTransformer):
    """Remove every statement that is only a string."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        """Remove the docstrings of modules, classes, functions and constants."""
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else node


@cache
def _instructions(source: str) -> str:
    """Return a module's syntax tree without the parts that have no effect when it runs."""
    return _told(_NoDocstrings().visit(ast.parse(source)))


def _told(node: object) -> str:
    """Return a syntax tree as text. Unlike ``ast.dump`` and ``ast.unparse``, it is the same in Python 3.11 to 3.13.

    Only some versions have empty fields, and empty constants in f-strings.
    """
    if isinstance(node, ast.JoinedStr):
        node = ast.JoinedStr([part for part in node.values if not isinstance(part, ast.Constant) or part.value])
    if isinstance(node, ast.AST):
        fields = (f"{name}={_told(value)}" for name, value in ast.iter_fields(node) if value not in (None, []))
        return f"{type(node).__name__}({','.join(fields)})"
    return f"[{','.join(map(_told, node))}]" if isinstance(node, list) else repr(node)


def _file(module: str) -> Path | None:
    """Return a module's file, or None if the name is not a module, as in ``from ... import``."""
    stem = ROOT.joinpath(*module.split("."))
    return next((path for path in (stem.with_suffix(".py"), stem / "__init__.py") if path.is_file()), None)


def _imports(path: Path, module: str) -> Iterator[str]:
    """Yield every name that may be a module: imported modules, and names imported from them."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            around = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            base = ".".join([*around, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)
