"""JSON, TOML and tables of arrays, studio and batches that are odd or cannot be: each is read or refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import Any

from solver_backend.body.marker_layouts import DEFAULT
from tests.fuzz.target import Write, file

_DEEP = "[" * 5000


def variants(values: dict[str, Any], changes: Iterable[dict[str, Any]], name: str = "a.json") -> tuple[Write, ...]:
    """Return what writes a JSON object with some of its values changed or (``...``) left out; and no object at all."""
    kept = [{k: v for k, v in (values | change).items() if v is not ...} for change in changes]
    return (*(file(name, json.dumps(item)) for item in kept), file(name, "[]"), file(name, _DEEP), file(name, "{"))


def _layout(change: Callable[[dict[str, Any]], object]) -> Write:
    values = json.loads(DEFAULT.read_text(encoding="utf-8"))
    change(values)
    return file("a.json", json.dumps(values))


def _double(values: dict[str, Any]) -> None:
    first, second = list(values["midline"])[:2]
    values["aliases"].setdefault(first, []).append("same")
    values["aliases"].setdefault(second, []).append("same")


LAYOUTS: tuple[Write, ...] = (
    _layout(_double),
    _layout(lambda values: values.update(format="other")),
    _layout(lambda values: values.update(virtual=["("])),
    _layout(lambda values: values.pop("kinds")),
)
TOLD_POINTS: tuple[dict[str, Any], ...] = (
    {"points": {}}, {"points": [1]}, {"points": [{"point": 0, "frame": 0, "marker": "none of ours"}]},
    {"points": [{"point": 99, "frame": 0, "marker": ""}]}, {"points": [{"point": 0, "frame": 10**9, "marker": ""}]},
    {"version": 9},
)  # fmt: skip
SHOTS: tuple[dict[str, Any], ...] = (
    {"version": 7}, {"version": "one"}, {"motions": []}, {"motions": "walk"}, {"motions": [""]},
    {"looks": ["suit", "suit"]}, {"camera_arrays": []}, {"camera_arrays": "azure_kinect_3"}, {"looks": {}},
    {"markers": None},
    {"markers": None, "write": ["coco"]}, {"film": ["depth"], "write": ["video"]}, {"write": ["none"]},
    {"looks": ["everyday"]}, {"looks": ["everyday"], "markers": ...}, {"looks": [{"clothes": "everyday"}]},
    {"looks": ["everyday"], "markers": ..., "write": []}, {"looks": ["everyday"], "markers": None, "write": []},
    {"fps": 0}, {"fps": "fast"}, {"frames": 1.5}, {"people": []}, {"people": {"strange": "yes"}}, {"name": ""},
    {"name": 3}, {"perturb": "heavy"}, {"perturb": {"px": 1.0}}, {"rgb": {"engine": "none"}}, {"film": "rgb"},
    {"joint_set": "NONE"}, {"unknown": 1},
)  # fmt: skip
_CAMERA = {"K": [900, 0, 320, 0, 900, 240, 0, 0, 1], "R": [1, 0, 0, 0, 0, -1, 0, 1, 0], "t": [0, 1, 3]}
_CAMERA |= {"image_size": [640, 480], "distortion": [0.01, 0.0]}
ARRAYS: tuple[dict[str, Any], ...] = (
    {}, {"preset": "none"}, {"preset": "azure_kinect_3", "size": [1, 2]}, {"preset": 5}, {"name": "x", "count": 3},
    {"layout": "corners"}, {"layout": "corners", "room_m": [0, 1]}, {"layout": "corners", "count": 2, "height_m": 1.2},
    {"layout": "capture", "capture": "c.npz"}, {"layout": "capture", "capture": "other.npz"},
    {"layout": "cameras", "cameras": []}, {"layout": "cameras", "cameras": [_CAMERA], "stand": "aim", "scale": 0.5},
    {"layout": "cameras", "cameras": [_CAMERA | {"K": "abc"}]},
    {"layout": "cameras", "cameras": [_CAMERA | {"t": [1]}]},
    {"layout": "cameras", "cameras": [_CAMERA | {"distortion": ["a"]}]}, {"layout": "cameras", "cameras": [5]},
    {"layout": "cameras", "cameras": [_CAMERA | {"K": [10**400] * 9}]}, {"range_m": [5, 1]}, {"leave_out": 4},
    {"target_m": [3, 0, 1.4], "turn_deg": 0}, {"distortion": [0.1, 0.01]}, {"distortion": 5},
    {"distortion": [0.1] * 12}, {"distortion": ["a"]}, {"size": [100000, 2]}, {"fov_deg": 1e9},
    {"stand": "nowhere"}, {"widest": 64},
    {"range_m": [float("nan"), 1]}, {"room_m": [1, 2]},
)  # fmt: skip
"""Rigs of a description of shots."""
RECORDS: tuple[dict[str, Any], ...] = (
    {"steps": []}, {"steps": {"solve": 1}}, {"steps": {"solve": {"outputs": [1]}}}, {"attempts": {}},
    {"attempts": [1]}, {"solve": []}, {"error": 1},
)  # fmt: skip
MAPS: tuple[dict[str, Any], ...] = (
    {"unknown": 1}, {"format": "other"}, {"map_pose": {"Hips": [1, 0, 0, 0]}}, {"map_pose": {"Hips": [9, 0, 0, 0]}},
    {"map_pose": {"Hips": [0.7, 0.7, 0]}}, {"map_pose": {"Hips": [1e300, 1, 1, 1]}}, {"bones": {"tail": "Tail"}},
    {"bones": {"spine": 5}}, {"switches": [{"bone": "hand.{side}", "property": "p", "fk": 0, "ik": "x"}]},
    {"sides": ["L"]}, {"sides": 5}, {"bones": None},
)  # fmt: skip
BOARD = {"kind": '"charuco"', "columns": "5", "rows": "7", "square_mm": "35.0", "marker_mm": "26.0"}


def board(**changes: str) -> Write:
    """Return what writes a board's TOML with some values changed."""
    lines = [f"{key} = {value}" for key, value in (BOARD | changes).items()]
    return file("a.toml", "\n".join(["[board]", *lines, ""]))


BOARDS: tuple[Write, ...] = (
    board(kind='"none"'), board(columns="2"), board(rows="51"), board(square_mm="0.1"), board(square_mm="1e9"),
    board(marker_mm="90"), board(marker_mm="1"), board(kind='"rings"', marker_mm="0.0"),
    board(kind='"chessboard"', marker_mm="0.0"), board(columns='"five"'), board(dictionary='"DICT_NONE"'),
    board(square_mm="nan"), board(more="1"),
)  # fmt: skip
NAMED_BOARDS: tuple[str, ...] = (
    "charuco:5x7:35mm", "charuco:5x7:35mm:20mm:DICT_4X4_50:inverted", "chessboard:9x6:2.5cm", "rings:4x11:0.05m",
    "charuco", "charuco:35mm", "charuco:5x7:35mm:words", "none:5x7:35mm", "charuco:2x2:1mm", "charuco:5x7:900m", "",
)  # fmt: skip
ANSWERS: tuple[Write, ...] = tuple(
    file("a.bin", content)
    for content in (
        b"", b"[1]\n", b"[" * 5000 + b"\n", b"{}\n", b'{"arrays": {"a": 5}}\n', b'{"arrays": {"a": [-1]}}\n',
        b'{"arrays": {"a": [100000, 100000]}}\n', b'{"arrays": {"a": [9]}}\nshort', b'{"arrays": {"a": [true]}}\n',
        b'{"arrays": {' + b", ".join(b'"%d": [0]' % i for i in range(40)) + b"}}\n", b"\xff\xfe\n",
    )
)  # fmt: skip
LINES: tuple[Write, ...] = tuple(
    file("a.txt", text)
    for text in (
        "1" * 3_000_000 + "\n0.1 1 2 3\n", "1" * 3_000_000, '{"t": NaN, "points": []}\n', "nan 1 2 3\n", "inf\n",
        "0.1" + " 1" * 3 * 500 + "\n", '{"t": 1e999, "points": [[1, 2, 3]]}\n', '{"points": [[1, 2]]}\n',
        '{"t": 1e300, "points": [[1e300, 0, 0], [-1e299, 1, 2]]}\n', "-9e18 1 2 3\n", b"\xff\xfe 1 2 3\n0.1 1 2 3\n",
        b"\x00" * 200_000 + b"\n0.1 1 2 3\n",
        '{"event": "x"}\n', '{"points": ' + _DEEP + "\n", "0.1 1 2\n", "one two\n", '{"t": 1}\n',
    )
)  # fmt: skip
EVENTS: tuple[Write, ...] = tuple(
    file("a.txt", "\n".join(json.dumps(event) for event in events))
    for events in (
        [{"event": "progress"}], [{"event": "progress", "done": "x", "total": None}], [{"event": "error"}],
        [{"event": "error", "code": 1, "message": [], "where": {}, "hint": None}], [{"event": []}],
        [{"event": "result", "motion": 5}], [{"event": "progress", "done": 1e400, "total": -1, "stage": "a\x1b[2J"}],
    )
)  # fmt: skip
