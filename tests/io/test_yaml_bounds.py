"""YAML that FileStorage never writes is refused by name, and any text takes time in proportion to its length."""

from __future__ import annotations

import time
from contextlib import suppress

import pytest

from solver_backend.io.calibration.yaml_storage import parse_yaml

SIZE = 200_000


@pytest.mark.parametrize(
    "text",
    [
        "p: [${PORT}:80]", "p: [}", "p: {a: ], b: 1}", "p: [1 ] 2]", "p: [a, {b: 1]]", "p: [,]", "p: [1,,2]", "p: {,}",
        "p: {a}", "p: ['a]", "p: [[1]", "p: &a 1", "p: *a", "p: |\n  text", "p: >\n  text", "- &a b", "'p", "'p' x: 1",
    ],
)  # fmt: skip
def test_what_file_storage_never_writes_is_refused_with_its_line(text: str) -> None:
    with pytest.raises(ValueError, match="line 1: "):
        parse_yaml(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("p: [1, 2, ]", [1, 2]),
        ("p: [ ]", []),
        ("p: { a: 1, b: [2, 'x'] }", {"a": 1, "b": [2, "x"]}),
        ("p: { }", {}),
        ('"p" : 1', 1),
        ("p: [1,\n  2,\n  3]", [1, 2, 3]),
    ],
)
def test_flow_lists_and_maps(text: str, value: object) -> None:
    assert parse_yaml(text) == {"p": value}


@pytest.mark.parametrize(
    "text",
    [
        "k" + " " * SIZE,
        "k: [" + " " * SIZE,
        "k: v" + " " * SIZE + "x",
        "k: [" + "\n1," * SIZE + "1]",
        "k: [" + "'a', " * (SIZE // 5) + "1]",
        "k: " + "[" * SIZE,
        "k: " + "'" * SIZE,
        "\t" * SIZE + "k",
        "- k:\n" * (SIZE // 5),
        "k: " + "{a: " * SIZE,
        "\n".join(" " * n + "k:" for n in range(600)),
        "k: [" + "#" * SIZE,
    ],
)
def test_hostile_texts_take_time_in_proportion_to_their_length(text: str) -> None:
    start = time.monotonic()
    with suppress(ValueError, RecursionError):
        parse_yaml(text)
    assert time.monotonic() - start < 5.0
