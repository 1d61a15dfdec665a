"""The pages of file formats and live streams name what the code writes and reads, each key of it and no other."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from blender_addon.export.formats import FORMATS
from solver_backend.body.marker_layouts import DEFAULT as LAYOUTS_FILE
from solver_backend.camera_calibration.formats import FORMATS as CALIBRATIONS
from solver_backend.exchange import motion_file
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.events import FrameLine
from solver_backend.exchange.reading_settings import ROWS as READING_ROWS
from solver_backend.io.native import capture_file
from solver_backend.io.native import motion_file as native_motion_file
from solver_backend.job import Job

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "docs" / "reference"
_FORMATS = "\n".join(page.read_text("utf-8") for page in sorted(REFERENCE.glob("file-formats*.md")))
_LIVE = (REFERENCE / "live-streams.md").read_text("utf-8")
_AMASS = {"mocap_frame_rate"}
"""The other spelling of AMASS; the page names ours."""
_STREAMS = [
    *(ROOT / "solver_backend" / "live").rglob("*.py"),
    *(ROOT / "solver_backend" / "cli").glob("*live*.py"),
    *(ROOT / "solver_backend" / "videos" / "streaming").rglob("*.py"),
]


def section(page: str, title: str) -> str:
    """Return what stands under a heading, up to the next of its level."""
    found = re.search(rf"^(#+) {re.escape(title)}$\n(.*?)(?=^\1 |\Z)", page, re.MULTILINE | re.DOTALL)
    assert found is not None, title
    return found[2]


def keys(text: str) -> set[str]:
    """Return what stands in code style in the first cells of its tables."""
    cells = re.findall(r"^\| ([^|]*) \|", text, re.MULTILINE)
    return {key for cell in cells for key in re.findall(r"`([^`]+)`", cell)}


def code(text: str) -> set[str]:
    return set(re.findall(r"`([^`]+)`", text))


def dictionaries(path: Path) -> Iterator[set[str]]:
    """Yield the text keys of each dictionary that a module writes out."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Dict):
            yield {k.value for k in node.keys if isinstance(k, ast.Constant) and isinstance(k.value, str)}


def test_the_motion_file_has_these_keys() -> None:
    text = section(_FORMATS, "The motion file")
    other_bodies = {*motion_file._LAYOUT, motion_file._PARENTS}
    assert keys(text) == {*motion_file.STORED, "gender", *other_bodies} - _AMASS - {"format", "version"}


def test_the_capture_file_has_these_keys() -> None:
    text = section(_FORMATS, "The capture file")
    stored = {*capture_file._STORED} - {"format", "version"}
    written = code(text)
    assert stored <= written | {"format", "version"}, stored - written
    assert keys(text) - {"truth_*"} <= stored


def test_the_subject_file_has_these_keys() -> None:
    stored = {*native_motion_file._TEXTS.values(), *native_motion_file._NUMBERS.values()}
    assert keys(section(_FORMATS, "Subject file")) == {"format", "version", "body", "provenance", *stored}


@pytest.mark.parametrize(
    ("title", "module"),
    [("Noise maps", "cameras/noise_map.py"), ("User-assigned names", "io/native/user_labels_file.py")],
)
def test_a_json_file_has_these_keys(title: str, module: str) -> None:
    source = (ROOT / "solver_backend" / module).read_text("utf-8")
    for key in keys(section(_FORMATS, title)):
        assert f'"{key}"' in source, key
    format_name = re.search(r'"(manifold_mocap_\w+)"', source)
    assert format_name is not None and f"`{format_name[1]}`" in section(_FORMATS, title)
    written = [found for found in dictionaries(ROOT / "solver_backend" / module) if "format" in found]
    for found in written:
        assert found <= keys(section(_FORMATS, title))


def test_the_layouts_have_these_keys() -> None:
    known = json.loads(LAYOUTS_FILE.read_text("utf-8"))
    text = (ROOT / "docs" / "how-to" / "extend.md").read_text("utf-8")
    assert keys(section(text, "Add marker names")) == known.keys()
    assert keys(section(_FORMATS, "Marker files and layouts")) == {"format", "version", "places"}


def test_every_export_format_has_its_row() -> None:
    text = section(_FORMATS, "Export formats")
    rows = re.findall(r"^\| [^|]+ \| `([\w-]+)` \| `(\.\w+)` \|", text, re.MULTILINE)
    assert dict(rows) == {name: item.suffix for name, item in FORMATS.items()}


def test_every_calibration_format_has_its_row() -> None:
    rows = re.findall(r"^\| [^|]+ \| `([\w-]+)` \|", section(_FORMATS, "Calibrations"), re.MULTILINE)
    assert rows == list(CALIBRATIONS)


def test_a_live_line_has_these_keys() -> None:
    text = section(_LIVE, "Output lines of `live stream`, `live cameras` and `sensors live --poses`")
    assert keys(text) == set(FrameLine.__annotations__) - {"coverage"}  # of a wand, in a section of its own


def test_every_live_event_is_named() -> None:
    events = set()
    for path in _STREAMS:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Name)
                and node.func.id in ("event", "event_line")
            ):
                [kind] = node.args[:1]
                choices = [kind.body, kind.orelse] if isinstance(kind, ast.IfExp) else [kind]
                events |= {c.value for c in choices if isinstance(c, ast.Constant)}
    assert len(events) > 10
    assert events <= code(_LIVE), sorted(events - code(_LIVE))


def test_the_job_page_has_each_key_that_a_job_takes() -> None:
    page = (REFERENCE / "job-file.md").read_text("utf-8")
    with pytest.raises(JobInvalid) as refused:
        Job.from_dict({"version": 1, "no such key": 1})
    known = set(refused.value.hint.removeprefix("Known keys: ").rstrip(".").split(", "))
    whole, resolve, contact, pin = page.split("\n## ")
    assert keys(whole) | {*READING_ROWS} == known
    example = json.loads(page.split("```json\n")[1].split("```")[0])
    assert Job.from_dict(example).settings.refine_window == 8
    assert keys(resolve) == {"motion", "first", "last", "pins", "contacts", "forgets"} and len(keys(pin)) == 4
    assert keys(contact) == {"part", "first", "last", "touches"}
