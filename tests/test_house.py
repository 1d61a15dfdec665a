"""The shape of the repository: what may import tests, budgets of folders, and no rings of imports."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.support.budgets import TABLE, has_number, measured

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = ("solver_backend", "blender_addon", "assets_procedural", "research")


@cache
def product_files() -> list[Path]:
    """Return the modules of the three packages, and the scripts and tools beside them."""
    packages = (path for name in (*PRODUCT, "training", "supply") for path in sorted((ROOT / name).rglob("*.py")))
    return [*sorted(ROOT.glob("*.py")), *packages]


def dotted(path: Path) -> str:
    """Return the name that a file is imported by."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def files_of_tests() -> list[Path]:
    """Return every file of the tests."""
    return sorted((ROOT / "tests").rglob("*.py"))


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield every statement of a tree but those for type checkers; what expressions hold is passed over."""
    if isinstance(tree, ast.If) and isinstance(tree.test, ast.Name) and tree.test.id == "TYPE_CHECKING":
        for node in tree.orelse:
            yield node
            yield from statements(node)
        return
    for field in ("body", "orelse", "finalbody", "handlers", "cases"):
        held = getattr(tree, field, ())
        for node in held if isinstance(held, list) else ():
            yield node
            yield from statements(node)


@cache
def found_in(path: Path) -> tuple[list[str], list[str]]:
    """Return the full names that a file imports, also inside functions, and its classes."""
    package = dotted(path).split(".")[: None if path.name == "__init__.py" else -1]
    names: list[str] = []
    classes: list[str] = []
    for node in statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            around = package[: len(package) + 1 - node.level] if node.level else []
            base = ".".join([*around, *([node.module] if node.module else [])])
            names += [base, *(f"{base}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.ClassDef):
            classes.append(node.name)
    return names, classes


def imported(path: Path) -> list[str]:
    """Return the full names that a file imports, also those taken out of modules."""
    return found_in(path)[0]


def imports_under(files: list[Path], prefixes: tuple[str, ...]) -> list[str]:
    """Return who imports what, where the imported name begins with one of the prefixes."""
    pairs = ((dotted(path), name) for path in files for name in imported(path))
    return [f"{importer} imports {name}" for importer, name in pairs if name.startswith(prefixes)]


def test_no_file_imports_a_test() -> None:
    every = files_of_tests()
    tests = {dotted(path) for path in every if path.name.startswith("test_")}
    assert len(tests) > 100
    assert not {f"{dotted(path)} imports {name}" for path in every for name in imported(path) if name in tests}


def test_tests_import_benchmarks_only_beside_them() -> None:
    files = [path for path in files_of_tests() if "benchmarks" not in path.parts]
    assert not imports_under(files, ("tests.benchmarks",))


def test_the_product_imports_no_tests() -> None:
    assert not imports_under(product_files(), ("tests",))
    assert imports_under(product_files(), ("numpy",))


@pytest.mark.parametrize("package", PRODUCT)
def test_no_modules_import_each_other_in_a_ring(package: str) -> None:
    files = {dotted(path): path for path in (ROOT / package).rglob("*.py")}
    graph = {name: set(imported(path)) & files.keys() - {name} for name, path in files.items()}
    assert sum(map(len, graph.values())) > len(files)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as ring:
        pytest.fail(" -> ".join(ring.args[1]))


@pytest.mark.parametrize("package", PRODUCT)
def test_no_folders_beside_each_other_import_each_other_in_a_ring(package: str) -> None:
    files = {dotted(path): path for path in (ROOT / package).rglob("*.py") if path.name != "__main__.py"}
    folders = {name: (name if path.name == "__init__.py" else name.rpartition(".")[0]) for name, path in files.items()}
    graphs: dict[str, dict[str, set[str]]] = {}
    for name, path in files.items():
        for other in set(imported(path)) & files.keys():
            ours, theirs = folders[name].split("."), folders[other].split(".")
            depth = next((d for d, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b), 0)
            if depth:  # they part below a common folder
                graph = graphs.setdefault(".".join(ours[:depth]), {})
                graph.setdefault(ours[depth], set()).add(theirs[depth])
    assert graphs
    for parent, graph in graphs.items():
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as ring:
            pytest.fail(f"{parent}: {' -> '.join(ring.args[1])}")


def test_a_class_name_has_one_home() -> None:
    homes: dict[str, list[str]] = {}
    for path in product_files():
        for name in found_in(path)[1]:
            homes.setdefault(name, []).append(dotted(path))
    assert len(homes) > 500
    assert not {name: places for name, places in homes.items() if len(places) > 1}


def test_every_folder_keeps_its_budget() -> None:
    """``python -m tests.support.budgets`` writes today's figures; a budget is only ever lowered."""
    budgets, found = json.loads(TABLE.read_text(encoding="utf-8")), measured()
    assert found["product"]["lines"] > 50_000 and found["product"]["kind_tests"] and found["product"]["constants"]
    assert not found.keys() - budgets.keys(), "folders without a budget"
    assert not {
        f"{folder}: {figures[name]} {name}, budget {limit}"
        for folder, figures in found.items()
        for name, limit in budgets[folder].items()
        if figures[name] > limit
    }


def test_nothing_asks_whether_a_value_is_of_a_protocol() -> None:
    """What a caller needs of one implementation is a method of all of them."""
    texts = {dotted(path): path.read_text(encoding="utf-8") for path in product_files()}
    protocols = {name for text in texts.values() for name in re.findall(r"class (\w+)\(.*\bProtocol\b", text)}
    assert len(protocols) > 10
    asked = [(name, call) for name, text in texts.items() for call in re.findall(r"\bisinstance\(.*", text)]
    assert len(asked) > 100
    assert not [(name, call) for name, call in asked if protocols & set(re.findall(r"\w+", call))]


def test_the_solver_compares_no_names_of_methods() -> None:
    """What distinguishes a method is a value of ``Method``."""
    files = sorted((ROOT / "solver_backend" / "fitters").rglob("*.py"))
    lines = [(dotted(path), line) for path in files for line in path.read_text(encoding="utf-8").splitlines()]
    assert [line for _, line in lines if "METHODS[settings.method]" in line]
    assert not [found for found in lines if re.search(r"\bsettings\.method (==|!=|in|not in) ", found[1])]


def unexplained_constants(text: str) -> list[str]:
    """Return the constants of a module's text that hold numbers and have neither a docstring nor a comment.

    A docstring below a block without empty lines is about all of the block.
    """
    body, lines, found = ast.parse(text).body, text.splitlines(), []
    for i, node in enumerate(body):
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
        if not isinstance(target, ast.Name) or not target.id.isupper() or value is None or not has_number(value):
            continue
        end = i
        while (
            end + 1 < len(body)
            and isinstance(body[end + 1], ast.Assign | ast.AnnAssign)
            and (body[end + 1].lineno == (body[end].end_lineno or 0) + 1)
        ):
            end += 1
        after = body[end + 1] if end + 1 < len(body) else None
        documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        if not documented and not any("#" in line for line in lines[max(node.lineno - 2, 0) : node.end_lineno]):
            found.append(target.id)
    return found


@pytest.mark.slow
def test_constants_have_a_docstring_or_a_comment() -> None:
    """Unit and origin of a number stand beside it."""
    found = {dotted(path): unexplained_constants(path.read_text(encoding="utf-8")) for path in product_files()}
    assert not {name: constants for name, constants in found.items() if constants}


@pytest.mark.parametrize(
    ("text", "unexplained"),
    [
        ("A = 3\n", ["A"]),
        ('A = 3\n"""Metres."""\n', []),
        ("A = 3  # metres\n", []),
        ('A = 3\nB = 4\n"""Metres."""\n', []),
        ('A = 3\n\nB = 4\n"""Metres."""\n', ["A"]),
        ("A: dict[str, float] = {'x': -2.5}\n", ["A"]),
        ("A = PATHS[2]\nB = (0.0, -1.0, 1)\nc = 5\nD = True\n", []),
    ],
)
def test_what_counts_as_an_explained_constant(text: str, unexplained: list[str]) -> None:
    assert unexplained_constants(text) == unexplained


def pages() -> list[Path]:
    """Return what a reader is given."""
    places = ("README.md", "assets_procedural/README.md", "docs/**/*.md", "solver_backend/assets/*.md")
    return [page for place in places for page in sorted(ROOT.glob(place))]


@pytest.mark.parametrize("page", [pytest.param(page, id=page.name) for page in pages()])
def test_pages_link_to_pages_and_name_files_and_modules_that_are_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", text)
    assert not [link for link in links if not (page.parent / link).exists()]
    if page.parent.name == "decisions":
        return  # which name files as they were
    files = [path.as_posix() for path in (*product_files(), *files_of_tests())]
    named = re.findall(r"`([\w./]+\.py)`", text)
    assert not [name for name in named if not any(path.endswith(f"/{name}") for path in files)]
    modules = {dotted(Path(path)).removesuffix(".__main__") for path in files}
    assert not set(re.findall(r"python3? -m ([\w.]*\w)", text)) - modules
