"""Functions of the product that take bytes from outside, and those that the targets reach."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

from tests.fuzz.driver import scratch_folder
from tests.fuzz.target import Target

_ROOT = Path(__file__).resolve().parents[2]
_OPENING = frozenset(
    {
        "open_regular", "read_text", "read_bytes", "first_bytes", "read_npz", "read_arrays", "read_fields", "read_json",
        "read_json_file", "read_restricted_pickle",
    }
)  # fmt: skip
"""Functions that open a file of somebody else."""
Place = tuple[str, str]  # A file, from the root of the repository, and a function in it.


def opening_functions() -> set[Place]:
    """Return the functions of the product that open files of somebody else by one of ``_OPENING``."""
    found: set[Place] = set()
    for package in ("solver_backend", "blender_addon"):
        for path in sorted((_ROOT / package).rglob("*.py")):
            name = path.relative_to(_ROOT).as_posix()
            found |= {(name, function) for function in _opening_in(ast.parse(path.read_text(encoding="utf-8")))}
    return found


def registered_functions() -> set[Place]:
    """Return the readers that the tables of readers name."""
    from solver_backend.io.calibration import forms, read
    from solver_backend.io.detections import json_documents, search
    from solver_backend.io.markers.read import MARKERS

    items: list[Any] = [MARKERS, search._KINDS, json_documents._DOCUMENTS, read._WHOLE, forms._FORMS, forms._CAMERAS]
    return {(code[0], code[1]) for item in items for code in _functions_in(item)}


def _functions_in(item: Any) -> Iterator[Place]:
    """Yield the functions of ours in a table: in tuples, fields of rows, partial and closed over."""
    if callable(item) and hasattr(item, "__code__"):
        for cell in item.__closure__ or ():
            yield from _functions_in(cell.cell_contents)
        path = Path(item.__code__.co_filename)
        if item.__name__ != "<lambda>" and path.is_relative_to(_ROOT):
            yield path.relative_to(_ROOT).as_posix(), item.__name__
    elif isinstance(item, tuple | list):
        for part in item:
            yield from _functions_in(part)
    elif hasattr(item, "__dataclass_fields__"):
        yield from _functions_in([getattr(item, name) for name in item.__dataclass_fields__])


def reached_functions(targets: Iterable[Target]) -> set[Place]:
    """Return the product's functions that run while the targets read their files."""
    seen: set[Any] = set()

    def note(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call":
            seen.add(frame.f_code)

    with scratch_folder() as folder:
        for number, target in enumerate(targets):
            for dialect, write in enumerate(target.dialects):
                home = folder / f"{number} {dialect}"
                home.mkdir()
                write(home)
                sys.setprofile(note)
                try:
                    with suppress(Exception):
                        target.read(home)
                finally:
                    sys.setprofile(None)
    paths = {code: Path(code.co_filename) for code in seen}
    inside = {code: path for code, path in paths.items() if path.is_relative_to(_ROOT)}
    return {(path.relative_to(_ROOT).as_posix(), code.co_name) for code, path in inside.items()}


def _opening_in(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            inner = {p for f in ast.walk(node) if isinstance(f, ast.FunctionDef) and f is not node for p in ast.walk(f)}
            called = [part.func for part in ast.walk(node) if isinstance(part, ast.Call) and part not in inner]
            names = {getattr(func, "id", getattr(func, "attr", "")) for func in called}
            if names & _OPENING:
                yield node.name
