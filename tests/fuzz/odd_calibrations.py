"""Calibrations that are odd or cannot be: each is read with a problem or refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from solver_backend.camera_calibration.formats import colmap_texts
from tests.fuzz.target import Write, file
from tests.support.calibration_files import json_text, qca_text, toml_text, yaml_camera
from tests.support.scenes import ring_of_cameras

_CAMERAS = ring_of_cameras(2)
_QCA = qca_text(_CAMERAS)
_YAML = yaml_camera(_CAMERAS, 0, "rt")


def _without_view(text: str) -> str:
    return "\n".join(line for line in text.splitlines() if "fov_video" not in line)


QUALISYS: tuple[Write, ...] = tuple(
    file("a.qca.txt", text)
    for text in (
        "<calibration><cameras/></calibration>",
        _QCA.replace('viewrotation="0"', 'viewrotation="90"'),
        _QCA.replace("fov_video", "fov_video_max"),
        _without_view(_QCA).replace("<intrinsic ", '<intrinsic sensorMaxU="122816" sensorMaxV="69056" '),
        _without_view(_QCA),
        _QCA.replace('skew="0" ', ""),
        _QCA.replace("Miqus Video", "Miqus M3").replace('active="1"', 'active="0"', 1),
        _QCA.replace("<transform", "<form"),
        _QCA.replace('r11="', 'r11="x'),
        '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "bbbbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>'
        "<calibration><cameras>&c;</cameras></calibration>",
        "<a>" * 5000,
    )
)
YAML: tuple[Write, ...] = tuple(
    file("a.yml", text)
    for text in (
        "",
        "%YAML:1.0\n---\n",
        f'{_YAML}"quoted": 1\n"a b" : 2\n',
        f"{_YAML}list:\n   - name: a\n     size: [ 1, 2 ]\n   - name: b\n",
        f"{_YAML}empty:\n",
        f"{_YAML}list:\n   -\n   - 1\n",
        f"{_YAML}a: &b 1\n",
        f"{_YAML}a: *b\n",
        f"{_YAML}a: [ 1, 2\n",
        f'{_YAML}a: [ "b ]\n',
        f"{_YAML}a: {{ b }}\n",
        f"{_YAML}a: {{ b: 1 ] }}\n",
        f"{_YAML}a: [ 1 2 ; ]\n",
        f"{_YAML}a: [ , ]\n",
        f"{_YAML}a: 1 ] 2\n",
        f'{_YAML}a: [ "b" c ]\n',
        f'{_YAML}a: {{ "b: 1 }}\n',
        f"{_YAML}  deeper: 1\n",
        f"{_YAML}words alone\n",
        f"{_YAML}a:\n   b: 1\n  c: 2\n",
        f"{_YAML}p: [${{PORT}}:80]\n",
        f"{_YAML}p: [{' ' * 5000}]\n",
        _YAML.replace("rows: 3", "rows: 4"),
        _YAML.replace("dt: d", "dt: z"),
        _YAML.replace("0.0", ".Nan"),
    )
)


def _both(first: str, second: str) -> Write:
    def write(folder: Path) -> None:
        (folder / "calib").mkdir()
        (folder / "calib" / "intri.yml").write_text(first)
        (folder / "calib" / "extri.yml").write_text(second)

    return write


PAIRS: tuple[Write, ...] = (
    _both("%YAML:1.0\n---\nnames:\n   - a\n", "%YAML:1.0\n---\nnames:\n   - a\n"),
    _both("a: [", "b: {"),
    _both(_YAML, _YAML),
)


def _colmap(change: Callable[[dict[str, str]], object]) -> Write:
    def write(folder: Path) -> None:
        texts = dict(colmap_texts(_CAMERAS))
        change(texts)
        for name, text in texts.items():
            (folder / name).write_text(text)

    return write


def _cameras_txt(*lines: str) -> Write:
    return _colmap(lambda texts: texts.update({"cameras.txt": "\n".join(lines) + "\n"}))


def _words(place: int, new: str) -> Callable[[dict[str, str]], object]:
    """Return what changes a word of every image."""

    def change(texts: dict[str, str]) -> None:
        lines = texts["images.txt"].split("\n")
        for i, line in enumerate(lines):
            words = line.split()
            if len(words) >= 10 and not line.startswith("#"):
                words[place] = new
                lines[i] = " ".join(words)
        texts["images.txt"] = "\n".join(lines)

    return change


COLMAP: tuple[Write, ...] = (
    _cameras_txt("1 PINHOLE 1280 720 900 640", "2 PINHOLE 1280 720 900 900 640 360"),
    _cameras_txt("1 PINHOLE 1280 720 nan 900 640 360", "2 PINHOLE 1280 720 900 900 640 360"),
    _cameras_txt("1 SIMPLE_RADIAL 1280 720 900 640 360 0.1", "2 OPENCV_FISHEYE 1280 720 900 900 640 360 0 0 0 0"),
    _cameras_txt("1 FOV 1280 720 900 900 640 360 0.1", "2"),
    _cameras_txt("# nothing"),
    _colmap(_words(1, "0 0")),
    _colmap(_words(8, "77")),
    _colmap(_words(2, "x")),
    _colmap(lambda texts: texts.update({"images.txt": "1 0 0 0\n\n"})),
)
_TWICE = json.loads(json_text(_CAMERAS, "list"))


def _named_alike(values: object) -> str:
    """Return the JSON with one name for every camera."""
    items = values if isinstance(values, list) else list(values.values())  # type: ignore[attr-defined]
    for item in items:
        if isinstance(item, dict):
            item.update({key: "a" for key in item if "name" in key.lower()})
    return json.dumps(values)


JSON: tuple[Write, ...] = (
    file("a.json", _named_alike(_TWICE)),
    file("a.json", "[]"),
    file("a.json", "[" * 5000),
    file("a.json", json_text(_CAMERAS, "dict").replace("]", ", 1]")),
)
TOML: tuple[Write, ...] = (
    file("a.toml", toml_text(_CAMERAS).replace("size = [", "size = [1.0, ")),
    file("a.toml", toml_text(_CAMERAS).replace('name = "cam02"', 'name = "cam01"').replace('["cam02"]', '["other"]')),
    file("a.toml", toml_text(_CAMERAS, matrices=True).replace("rotation = [[", "rotation = [[7.0, ")),
    file("a.toml", ".".join("a" * 40) + " = 1\n"),
)
