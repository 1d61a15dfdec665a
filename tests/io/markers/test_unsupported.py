"""Files of markers that are not read are named, with the way out."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.exchange.errors import CaptureNotRecognised
from solver_backend.io.load import load_capture

NUMBERS = "1,0,44.16,-276.86,675.70,32.57,-243.14,676.58\n2,0,44.16,-276.86,675.70,,,\n"


@pytest.mark.parametrize(
    ("name", "text", "what", "how"),
    [
        ("gait.trb", "\x01\x02", "Motion Analysis", "TRC"),
        ("gait.TDF", "\x01\x02", "BTS SMART", "C3D"),
        ("walk.tak", "\x01\x02", "OptiTrack Motive", "CSV"),
        ("walk.qtm", "\x01\x02", "Qualisys", "TSV"),
        ("walk.bvh", "HIERARCHY", "skeleton", "`motion convert`"),
        ("walk.mvnx", "<mvnx/>", "skeleton", "`motion convert`"),
        ("walk.vrma", "glTF", "skeleton", "`blender motion convert`"),
        ("result.pkl", "\x80", "network", "`motion convert`"),
        ("points.csv", NUMBERS, "without marker names or a frame rate", "header"),
        ("points.txt", NUMBERS.replace(",", "\t"), "without marker names or a frame rate", "header"),
        ("points.csv", NUMBERS.replace(",", ";").replace(".", ","), "without marker names", "header"),
    ],
)
def test_what_is_not_read_is_named_with_the_way_out(tmp_path: Path, name: str, text: str, what: str, how: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(CaptureNotRecognised) as found:
        load_capture(path)
    assert what in str(found.value) and how in str(found.value.hint)


def test_a_text_that_is_nothing_known_is_no_table(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("Nothing, here, is, a, number, nor, a, marker\n")
    with pytest.raises(CaptureNotRecognised, match="not a readable capture"):
        load_capture(path)
