"""Joints have names: their numbers, and how many there are, stand in the layouts alone."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from solver_backend.exchange.body_layout import SMPL, SMPL_H, SMPL_X
from solver_backend.exchange.errors import BodyInvalid

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("solver_backend", "blender_addon", "assets_procedural", "research", "supply")
OTHER_NUMBERS = {
    "solver_backend/synthesis/studio/write_pictures.py": "pairs of COCO's keypoints, as its annotations list them",
    "solver_backend/videos/detect/child/pose_workers/litert_pose.py": "points of a hand, in a Python of its own",
    "solver_backend/videos/detect/child/pose_workers/mediapipe_pose.py": "points of a hand, in a Python of its own",
    "solver_backend/synthesis/studio/contact_sheet.py": "a grey value",
    "solver_backend/io/markers/camera_systems.py": "lines of a file",
    "blender_addon/export/writers/blender_exporters.py": "bytes of a file",
    "blender_addon/studio/room.py": "corners of a box",
    "supply/method_diagrams.py": "frames of a picture",
}
"""Numbers that are no joints of a body."""
COUNTS = {n * k for n in (SMPL.num_joints, SMPL.num_solved, SMPL.num_solved + 1) for k in (1, 3)}
COUNTS |= {SMPL_H.num_joints, SMPL_X.num_joints, 30}
"""How many joints, or their rotation vectors' numbers, bodies of the SMPL family and their fingers have."""
SIZED = {"reshape", "zeros", "ones", "empty", "full", "broadcast_to", "tile", "arange", "range", "eye", "view"}
"""Functions that are given sizes."""


def whole_numbers(node: ast.AST) -> list[int] | None:
    """Return the numbers of a display of whole numbers alone, also nested."""
    if isinstance(node, ast.Constant):
        return [node.value] if type(node.value) is int else None
    if isinstance(node, ast.Dict):
        parts: list[ast.AST] = [*(key for key in node.keys if key), *node.values]
    elif isinstance(node, ast.Tuple | ast.List | ast.Set):
        parts = [*node.elts]
    else:
        return None
    inner = [whole_numbers(part) for part in parts]
    return None if None in inner else [n for numbers in inner for n in numbers or ()]


def joint_numbers(tree: ast.AST) -> Iterator[int]:
    """Yield lines that list joints of a body by number, or that shape or cut an array by how many there are."""
    for node in ast.walk(tree):
        numbers = None if isinstance(node, ast.Constant) else whole_numbers(node)
        if numbers and len(set(numbers)) >= 3 and min(numbers) >= 0 and 13 <= max(numbers) < SMPL.num_joints:
            yield node.lineno  # type: ignore[attr-defined]
        sizes: list[ast.AST] = []
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            sizes = [size for part in node.args for size in getattr(part, "elts", [part])] if name in SIZED else []
        elif isinstance(node, ast.Slice):
            sizes = [end.operand if isinstance(end, ast.UnaryOp) else end for end in (node.lower, node.upper) if end]
        counts = [s for s in sizes if isinstance(s, ast.Constant) and type(s.value) is int and s.value in COUNTS]
        yield from (size.lineno for size in counts)


def files() -> list[Path]:
    """Return the product's files."""
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


@pytest.mark.slow
def test_no_joint_numbers_outside_the_layouts() -> None:
    texts = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in files()}
    some = re.compile(rf"\b({'|'.join(map(str, {*COUNTS, *range(13, SMPL.num_joints)}))})\b")
    found = {
        name: lines
        for name, text in texts.items()
        if some.search(text) and (lines := sorted(set(joint_numbers(ast.parse(text)))))
    }
    assert len(files()) > 800
    assert found.keys() == OTHER_NUMBERS.keys(), found


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("LIMBS = ((13, 16, 18, 20), (14, 17, 19, 21))", 3),
        ("HANDS = {20: 22, 21: 23}", 1),
        ("x = pose.reshape(-1, 21, 3)", 1),
        ("x = np.zeros((frames, 24, 3))", 1),
        ("x = pose[:, :63]", 1),
        ("x = pose[:, -30:]", 1),
        ("A = (1, 2, 3)", 0),
        ("A = (0.1, 16, 18, 20)", 0),
        ("A = (100, 16, 18, 20)", 0),
        ("x = pose.reshape(-1, SMPL.num_solved, 3)", 0),
    ],
)
def test_what_counts_as_a_joint_number(text: str, count: int) -> None:
    assert len(list(joint_numbers(ast.parse(text)))) == count


def test_joints_are_found_by_name() -> None:
    assert SMPL.numbers("pelvis", "head") == (0, 15) and SMPL.both("hip", "wrist") == (1, 2, 20, 21)
    with pytest.raises(BodyInvalid, match="SMPL has no left_tail, right_tail"):
        SMPL.both("tail")
